"""Smoothed residuals of fixes and closures by source, in stated sigmas, and systematic errors that a source may have.

A source is named `<kind>:<name>`, as in `position:gps` or `closure:loops`; its components and errors have `/<what>`
behind it. The colon tells them from those of odometry and observations.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from data import se2
from data.inputs import Inputs, IntArray
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, expected_closure, expected_fix
from data.se2 import Array
from eval.referee.consistency import squares
from eval.referee.residuals import Used, described, rate_of
from eval.referee.sources.scored import Source, sources_of

ENTRIES = ("x", "y", "theta")
UNUSUAL = 1e-5  # probability of a larger squared residual, from which a measurement is an outlier


def key_of(source: Source) -> str:
    """Its name among components."""
    return f"{source.kind}:{source.name}"


def source_in(component: str) -> str | None:
    """The name of the source of a component or error; None: it is of odometry or observations."""
    _, colon, rest = component.partition(":")
    return (rest.rpartition("/")[0] or rest) if colon else None


def entries_of(source: Source) -> tuple[int, ...]:
    """Entries of (x, y, theta) that it measures."""
    return (0, 1, 2) if source.of_closures else MEASURED[FixKind[source.kind.upper()]]


@dataclass(frozen=True, eq=False)
class OfSource:
    """Residuals of the used measurements (n) of a source."""

    source: Source
    rows: IntArray  # (n,) in the log's fixes or closures
    white: Array  # (n, d) each entry in its own stated sigma
    squared: Array  # (n,) squared distance under the stated covariance

    @property
    def dof(self) -> int:
        """Degrees of freedom of one."""
        return int(self.white.shape[1])

    @property
    def outlying(self) -> float:
        """Squared residual of an outlier."""
        return float(special.chdtri(self.dof, UNUSUAL))


def of_sources(inputs: Inputs, path: Array, used: Used) -> list[OfSource]:
    """Residuals of each source at a smoothed path (N, 3); sources of which nothing was used have none."""
    found = []
    for source in sources_of(inputs):
        mask = used.closures if source.of_closures else used.fixes
        rows = source.rows if mask is None else source.rows[mask[source.rows]]
        if mask is None or not len(rows):
            continue
        entries = list(entries_of(source))
        nu, C = _residuals(inputs, source, path, rows)
        nu, C = nu[:, entries], C[:, entries][:, :, entries]
        white = nu / np.sqrt(np.einsum("nii->ni", C))
        found.append(OfSource(source, rows, white, squares(nu, C)))
    return found


def _residuals(inputs: Inputs, source: Source, path: Array, rows: IntArray) -> tuple[Array, Array]:
    """Residuals (n, 3), zero where not measured, and covariances (n, 3, 3)."""
    nu = np.zeros((len(rows), 3))
    if source.of_closures:
        closures = inputs.closures
        assert closures is not None
        for at, i in enumerate(rows.tolist()):
            z_hat, _, _ = expected_closure(path[closures.frame1[i]], path[closures.frame2[i]])
            nu[at] = closures.relative[i] - z_hat
        covariance = closures.covariance[rows]
    else:
        fixes = inputs.fixes
        assert fixes is not None
        entries = list(entries_of(source))
        for at, i in enumerate(rows.tolist()):
            z_hat, _ = expected_fix(path[fixes.frame[i]], int(fixes.kind[i]), fixes.sources[int(fixes.source[i])])
            nu[at, entries] = fixes.z[i][entries] - z_hat
        covariance = fixes.covariance[rows]
    nu[:, 2] = se2.wrap_angle(nu[:, 2])
    return nu, covariance


def summaries(inputs: Inputs, path: Array, used: Used) -> dict[str, float]:
    """Mean, spread, correlation of successive ones and maximum of each component, by name of the statistic."""
    result: dict[str, float] = {}
    for of in of_sources(inputs, path, used):
        for entry, values in zip(entries_of(of.source), of.white.T, strict=True):
            name = f"{key_of(of.source)}/{ENTRIES[entry]}"
            result |= described(name, values, slice(None, -1), slice(1, None))
    return result


def columns(inputs: Inputs, path: Array) -> Iterator[tuple[str, Array | None, Array | None]]:
    """Systematic errors of sources: name, and derivatives of the fixes (F, 3) or of the closures (K, 3).

    Of fixes: a constant error of each entry [m, rad], the place of the source in the body frame (`lever_x`, `lever_y`
    [m]) and its delay (`latency` [s]). Of closures: a constant error of each entry, and of their distances (`scale`).
    """
    for source in sources_of(inputs):
        key = key_of(source)
        if source.of_closures:
            assert inputs.closures is not None
            yield from ((f"{key}/{n}", None, c) for n, c in _of_closures(inputs.closures, source, path).items())
        else:
            assert inputs.fixes is not None
            found = _of_fixes(inputs.fixes, source, path, rate_of(path, inputs.time))
            yield from ((f"{key}/{n}", c, None) for n, c in found.items())


def _constant(source: Source, count: int) -> dict[str, Array]:
    """A constant error of each measured entry, of `count` measurements."""
    found = {}
    for entry in entries_of(source):
        found[ENTRIES[entry]] = np.zeros((count, 3))
        found[ENTRIES[entry]][source.rows, entry] = 1.0
    return found


def _of_closures(closures: Closures, source: Source, path: Array) -> dict[str, Array]:
    """Derivatives (K, 3) of the closures by errors of a source."""
    found = _constant(source, len(closures)) | {"scale": np.zeros((len(closures), 3))}
    for i in source.rows.tolist():
        z_hat, _, _ = expected_closure(path[closures.frame1[i]], path[closures.frame2[i]])
        found["scale"][i, :2] = z_hat[:2]
    return found


def _of_fixes(fixes: Fixes, source: Source, path: Array, rate: Array) -> dict[str, Array]:
    """Derivatives (F, 3) of the fixes by errors of a source, at poses (N, 3) that change with `rate` (N, 3)."""
    entries, found = list(entries_of(source)), _constant(source, len(fixes))
    names = (["lever_x", "lever_y"] if 0 in entries else []) + ["latency"]
    found |= {name: np.zeros((len(fixes), 3)) for name in names}
    for i in source.rows.tolist():
        k = int(fixes.frame[i])
        _, H = expected_fix(path[k], int(fixes.kind[i]), fixes.sources[int(fixes.source[i])])
        found["latency"][i, entries] = -H @ rate[k]
        if 0 in entries:
            c, s = float(np.cos(path[k, 2])), float(np.sin(path[k, 2]))
            found["lever_x"][i, :2], found["lever_y"][i, :2] = (c, s), (-s, c)
    return found

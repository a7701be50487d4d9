"""The text of a frame's fixes and closures in a step: innovations, their covariances, NIS, gates and decisions.

Laid out as the decisions on observations are, a column for each measurement.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from association.expectation import gate_threshold
from data.inputs import IntArray
from data.log import Log
from data.pose_measurements import PoseUpdated
from data.result import Run
from data.se2 import Array

NAMES = ("x", "y", "θ")
UNITS = (("m", "m", "rad"), (("m²", "m²", "m rad"), ("m²", "m²", "m rad"), ("m rad", "m rad", "rad²")))
NOTHING = "-"

Rows = list[tuple[str, list[str]]]


@dataclass(frozen=True, eq=False)
class PoseStep:
    """A fix or closure of a frame, once it was tried.

    Attributes:
        name: as `fix 0`, counted within the frame.
        source: where it comes from.
        ends: frames of a closure; empty for a fix.
        nu: (3,) innovation x, y [m], theta [rad]; NaN: not measured, or not formed.
        S: (3, 3) its covariance.
        nis: normalized innovation squared; dof: its degrees of freedom.
        used: whether it was accepted.
        inlier: 1, 0, or -1 where that is not known.
    """

    name: str
    source: str
    ends: tuple[int, ...]
    nu: Array
    S: Array
    nis: float
    dof: int
    used: bool
    inlier: int

    @property
    def decided(self) -> str:
        """What became of it: accepted; rejected at the gate; or not used, since the estimator knows its frame no
        longer.
        """
        return "accepted" if self.used else "rejected" if math.isfinite(self.nis) else "not used"

    @property
    def right(self) -> bool:
        """Whether it was rightly accepted or left out."""
        return self.used == bool(self.inlier)


def of_frame(log: Log, k: int, fixed: PoseUpdated | None, closed: PoseUpdated | None) -> list[PoseStep]:
    """The fixes and closures of frame k with the results of their updates; none where those are None."""
    found: list[PoseStep] = []
    r, t = log.recorded, log.truth
    if fixed is not None and r.fixes is not None and (fixes := r.fixes.of(k)) is not None:
        names = [fixes.sources[s].name for s in fixes.source.tolist()]
        found += _steps("fix", names, [()] * len(fixes), fixed, t.fix_inlier, fixes.rows)
    if closed is not None and r.closures is not None and (closures := r.closures.of(k)) is not None:
        names = [closures.sources[s] for s in closures.source.tolist()]
        ends = list(zip(closures.frame1.tolist(), closures.frame2.tolist(), strict=True))
        found += _steps("closure", names, ends, closed, t.closure_inlier, closures.row)
    return found


def _steps(
    kind: str,
    names: Sequence[str],
    ends: Sequence[tuple[int, ...]],
    done: PoseUpdated,
    inlier: IntArray | None,
    rows: IntArray,
) -> Iterator[PoseStep]:
    known = np.full(len(rows), -1) if inlier is None else inlier[rows]
    for i, (name, of) in enumerate(zip(names, ends, strict=True)):
        nu, m = np.full(3, np.nan), np.flatnonzero(np.isfinite(np.diag(done.S[i])))
        if len(m):
            nu[m] = np.linalg.cholesky(done.S[i][np.ix_(m, m)]) @ done.white[i, m]
        number = f"{kind} {i}"
        of_it = done.S[i], float(done.nis[i]), int(done.dof[i]), bool(done.used[i]), int(known[i])
        yield PoseStep(number, name, of, nu, *of_it)


def of_run(log: Log, run: Run, k: int) -> tuple[list[PoseStep], float | None]:
    """The fixes and closures of frame k in a run, online, and the probability of their gate."""
    r = log.recorded
    fixes = None if r.fixes is None else r.fixes.of(k)
    closures = None if r.closures is None else r.closures.of(k)
    fixed = None if fixes is None or run.fixes is None else run.fixes.of(fixes.rows)
    closed = None if closures is None or run.closures is None else run.closures.of(closures.row)
    gate = next((each.gate for each in (run.fixes, run.closures) if each is not None), None)
    return of_frame(log, k, fixed, closed), gate


def rows_of(steps: Sequence[PoseStep], gate: float | None) -> Rows:
    """The rows of the table; those without any number are left out."""
    rows: Rows = [("measurement", [s.name for s in steps]), ("source", [s.source for s in steps])]
    rows.append(("frames", [" to ".join(map(str, s.ends)) for s in steps]))
    for i, name in enumerate(NAMES):
        rows.append((f"innovation {name} [{UNITS[0][i]}]", [_number(s.nu[i]) for s in steps]))
    for j, other in enumerate(NAMES):
        for i, name in enumerate(NAMES[: j + 1]):
            rows.append((f"covariance {name}{other} [{UNITS[1][i][j]}]", [_number(s.S[i, j]) for s in steps]))
    rows.append(("NIS", [_number(s.nis) for s in steps]))
    if gate is not None:
        rows.append((f"gate {gate:g}", [_number(gate_threshold(gate, s.dof)) for s in steps]))
    if any(s.inlier >= 0 for s in steps):
        rows.append(("ground truth", [("outlier", "inlier", NOTHING)[s.inlier] for s in steps]))
    rows.append(("hypothesis", [s.decided for s in steps]))
    if any(s.inlier >= 0 for s in steps):
        rows.append(("correct", [str(int(s.right)) if s.inlier >= 0 else NOTHING for s in steps]))
    return [row for row in rows if any(row[1])]


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ""

"""Fixes and closures by source: NIS against its law behind the gate, whiteness, and right and wrong decisions.

A filter takes fixes and closures one after another, so the NIS of each at its turn is a chi-square variable of its own
degrees of freedom, independent of the others (Bar-Shalom, Li, Kirubarajan 5.4.2); behind a gate it is truncated
(`association.truncated`). After all data each is chi-square by itself, too, against the estimate without it, but they
are correlated, so their mean has no verdict; outliers among them are told by Bonferroni's bound.

Smoothed residuals of each source are in stated sigmas, with systematic errors that it may have. A source is named
`<kind>:<name>`, as in `position:gps` or `closure:loops`; its components and errors have `/<what>` behind it. The colon
tells them from those of odometry and observations.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from association.expectation import gate_threshold
from association.truncated import truncated_square
from data import se2
from data.inputs import Inputs, IntArray
from data.log import Log
from data.notice import Code, Notice, Value, notice
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, expected_closure, expected_fix
from data.result import Run
from data.se2 import Array, BoolArray
from data.tails import least_of, log_tail
from data.truth import Truth
from eval.referee.confusion import OUTCOMES
from eval.referee.consistency import innovations_word, lag1_correlation, nis_bounds, squares
from eval.referee.residuals import Used, described, rate_of
from eval.referee.result_files import RUN

CLOSURE = "closure"
SURE = 1e-4  # probability below which a single log's NIS, or number of rejections, is worth a notice
FEWEST = 8  # fixes or closures of a source, below which their correlation says nothing


@dataclass(frozen=True, eq=False)
class Source:
    """Measurements of one kind from one source."""

    name: str
    kind: str  # `position`, `heading` or `pose` of fixes, else `CLOSURE`
    rows: IntArray  # of the log's fixes or closures

    @property
    def of_closures(self) -> bool:
        """Whether these are closures."""
        return self.kind == CLOSURE


def sources_of(inputs: Inputs) -> list[Source]:
    """The sources of a log that measured something, fixes first."""
    found: list[Source] = []
    if (fixes := inputs.fixes) is not None:
        for i, source in enumerate(fixes.sources):
            for kind in FixKind:
                rows = np.flatnonzero((fixes.source == i) & (fixes.kind == kind))
                found += [Source(source.name, kind.name.lower(), rows)] if len(rows) else []
    if (closures := inputs.closures) is not None:
        for i, name in enumerate(closures.sources):
            rows = np.flatnonzero(closures.source == i)
            found += [Source(name, CLOSURE, rows)] if len(rows) else []
    return found


def has_sources(inputs: Inputs) -> bool:
    """Whether a log has fixes or closures."""
    return inputs.fixes is not None or inputs.closures is not None


@dataclass(frozen=True)
class SourceScore:
    """What a run did with a source in a phase: a row of sources.csv, and why it may deserve a notice."""

    source: str
    kind: str
    phase: str
    count: int  # measurements of the source
    used: int  # accepted ones
    nis_mean: float = math.nan  # of the accepted ones per degree of freedom; NaN: none
    nis_dof: int = 0  # their degrees of freedom
    expected: float = 1.0  # of NIS per degree of freedom, behind the gate
    variance: float = 2.0  # the same
    nis_low: float = math.nan  # 95 % bounds; NaN: none, as after all data
    nis_high: float = math.nan
    verdict: str = ""  # a word on the innovations; empty: none
    lag1: float = math.nan  # correlation of successive innovations; NaN: too few
    lag1_se: float = math.nan  # its standard error
    gate: float | None = None  # chi-square probability of the gate; None: no gate
    formed: int = 0  # accepted and rejected ones at their turn; those not formed cannot be rejected
    # TP, TN, FP, FN: inliers accepted, outliers rejected, outliers accepted, inliers rejected; None: no truth, or none
    # was decided about
    outcomes: tuple[int, int, int, int] | None = None
    outlying: int = 0  # accepted ones that contradict all others, each surely (`SURE` for the source)
    dof: int = 0  # degrees of freedom of one
    largest: float = math.nan  # NIS of those formed
    log_chance: float = math.nan  # logarithm of the probability of a larger one among so many; NaN: none


def score_source(run: Run, source: Source, phase: str, truth: Truth | None = None) -> SourceScore:
    """The score of one source; without `truth` no outcomes."""
    online, final = (run.closures, run.closures_final) if source.of_closures else (run.fixes, run.fixes_final)
    found = online if phase == "online" or final is None else final
    if found is None:
        return SourceScore(source.name, source.kind, phase, len(source.rows), 0)
    used: BoolArray = found.used[source.rows]
    decided = used | np.isfinite(found.nis[source.rows])  # the frame of a closure may be no longer known
    inlier = None if truth is None else truth.closure_inlier if source.of_closures else truth.fix_inlier
    outcomes = None
    if inlier is not None and decided.any():
        outcomes = outcomes_of(used[decided], inlier[source.rows][decided])
    bare = SourceScore(source.name, source.kind, phase, len(source.rows), int(used.sum()), outcomes=outcomes)
    nis, dof, white = found.nis[source.rows], found.dof[source.rows], found.white[source.rows]
    formed = np.isfinite(nis)
    taken = used & formed
    total, count = int(dof[taken].sum()), int(formed.sum())
    if count:
        chance = float(least_of(min(float(log_tail(nis[formed], dof[formed]).min()), -1e-12), count))
        largest = float(nis[formed].max())
        bare = replace(bare, gate=found.gate, formed=count, dof=int(dof[0]), largest=largest, log_chance=chance)
    if not total:
        return bare
    moments = np.array([truncated_square(gate_threshold(found.gate, int(d)), int(d)) for d in dof[taken]]).sum(axis=0)
    mean, expected, variance = float(nis[taken].sum()) / total, float(moments[0]) / total, float(moments[1]) / total
    scored = replace(bare, nis_mean=mean, nis_dof=total, expected=expected, variance=variance)
    if phase != "online":
        return replace(scored, outlying=int((special.chdtrc(dof[taken], nis[taken]) < SURE / taken.sum()).sum()))
    low, high = nis_bounds(total, (expected, variance))
    lag1, error = math.nan, math.nan
    if taken.sum() >= FEWEST:
        measured = np.isfinite(white[taken]).all(axis=0)
        turn = np.arange(int(taken.sum()))
        lag1, error = lag1_correlation(white[taken][:, measured], turn, np.zeros_like(turn))
    word = innovations_word(mean, low, high, lag1, error)
    return replace(scored, nis_low=low, nis_high=high, verdict=word, lag1=lag1, lag1_se=error)


def outcomes_of(used: BoolArray, inlier: IntArray) -> tuple[int, int, int, int]:
    """TP, TN, FP, FN of accepted measurements (n,) against truth (n,): 1 inlier, 0 outlier, -1 unknown."""
    right, wrong = inlier == 1, inlier == 0
    tp, tn, fp, fn = (int(c.sum()) for c in (used & right, ~used & wrong, used & wrong, ~used & right))
    return tp, tn, fp, fn


def scores_of(run: Run, inputs: Inputs, truth: Truth | None = None) -> list[SourceScore]:
    """Scores of all sources in all phases; none of dead reckoning, of failed runs, and of results of other programs."""
    if run.association == "none" or run.failure is not None or run.handed_in:
        return []
    return [score_source(run, s, phase, truth) for phase in run.phases for s in sources_of(inputs)]


def source_rows(run: Run, log: Log) -> Iterator[dict[str, object]]:
    """The rows of sources.csv of a run."""
    for s in scores_of(run, log.recorded, log.truth):
        counts = (None,) * 4 if s.outcomes is None else s.outcomes
        who = (log.name, run.task, run.estimator, run.association, s.phase)
        row: dict[str, object] = dict(zip((*RUN, *OUTCOMES), (*who, *counts), strict=True))
        row |= {n: getattr(s, n) for n in ("source", "kind", "count", "used", "nis_mean", "nis_low", "nis_high")}
        yield row | {"nis_dof": s.nis_dof or None, "verdict": s.verdict or None}


def source_notices(run: Run, inputs: Inputs) -> list[Notice]:
    """Sources that a run did not use, with inconsistent NIS, rejected more often than expected, or with outliers. Each
    is tested at the level `SURE`: a log has many sources and estimators.
    """
    told = any(n.code is Code.POSES_UNUSED for n in run.notes)
    found = [n for s in scores_of(run, inputs) for n in _notices(s, unused=s.phase == run.phases[-1] and not told)]
    return [n.about(estimator=run.estimator, association=run.association) for n in found]


def _notices(s: SourceScore, *, unused: bool) -> Iterator[Notice]:
    def of(code: Code, **values: Value) -> Notice:
        return notice(code, None, source=s.source, kind=s.kind, **values)

    if unused and not s.formed and not s.used:
        yield of(Code.SOURCE_UNUSED, count=s.count)
    low, high = nis_bounds(s.nis_dof, (s.expected, s.variance), 1.0 - SURE)
    if s.phase == "online" and s.nis_dof and not low <= s.nis_mean <= high:
        yield of(Code.SOURCE_NIS, nis=s.nis_mean, expected=s.expected, low=s.nis_low, high=s.nis_high)
    rejected, beyond = s.formed - s.used, 0.0 if s.gate is None else 1.0 - s.gate
    asked = s.phase == "online" and s.gate is not None and rejected > 0
    if asked and float(special.bdtrc(rejected - 1, s.formed, beyond)) < SURE:
        yield of(Code.SOURCE_REJECTED, rejected=rejected, gate=s.gate, count=s.formed, expected=s.formed * beyond)
    if s.outlying:
        yield of(Code.SOURCE_OUTLIERS, outliers=s.outlying, count=s.used)


ENTRIES = ("x", "y", "theta")
PARTS = (*ENTRIES, "lever", "lever_x", "lever_y", "offset", "latency", "scale")  # behind a source's name
UNUSUAL = 1e-5  # probability of a larger squared residual, from which a measurement is an outlier


def key_of(source: Source) -> str:
    """Its name among components."""
    return f"{source.kind}:{source.name}"


def source_in(component: str) -> str | None:
    """The name of the source of a component or error; None: it is of odometry or observations."""
    _, colon, rest = component.partition(":")
    before, _, last = rest.rpartition("/")
    return None if not colon else before if last in PARTS else rest


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
        found.append(OfSource(source, rows, nu / np.sqrt(np.einsum("nii->ni", C)), squares(nu, C)))
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
            result |= described(f"{key_of(of.source)}/{ENTRIES[entry]}", values, slice(None, -1), slice(1, None))
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

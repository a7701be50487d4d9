"""What is known of one run in one phase, as its tables show it, and what objects to it."""

import math
from collections.abc import Mapping, Sequence, Set as AnySet
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from data.se2 import Array
from eval.referee import battery, consistency
from eval.referee.confusion import OUTCOMES
from eval.referee.result_files import Row, is_blank, value_of
from eval.replay.settings import BATCH, ESTIMATORS, FILTERS, INCREMENTAL, steps
from eval.studies.diagnosis import Trust

NEES_MARGIN = 1.25
"""Times the expectation, below which the lower bound of one log's interval is no objection: 95 % intervals of one log
cover 84 to 93 % (docs/notes/verdict-rules.md)."""
WRONG_LIMIT = 0.05  # share of wrong pairings. `jcbb` has 3 % on worlds that are as stated, and one in ten ruins a path
NIS_LIMIT = 4.6
"""NIS per degree of freedom over its expectation from which a path is not to be used: 9.21 / 2, the square at which a
gate of 99 % refuses a position. A typical observation is refused then; stated sigmas of half the true ones give 4."""


class Objection(StrEnum):
    """What speaks against an estimate, the strongest first."""

    MAP = "map"
    CONVENTION = "convention"
    STOPPED = "stopped"
    IMPLAUSIBLE = "implausible"
    IDLE = "idle"
    LOST = "lost"
    ASTRAY = "astray"
    NEES = "nees"
    ASSOCIATION = "association"
    NIS = "nis"
    CAUSE = "cause"


UNUSABLE = (Objection.STOPPED, Objection.IMPLAUSIBLE, Objection.IDLE, Objection.LOST, Objection.ASTRAY)


@dataclass(frozen=True)
class Objected:
    """An objection to an estimator, or to the log."""

    objection: Objection
    estimator: str  # blank: to the log, of `MAP`, `CONVENTION`, `CAUSE`
    value: float = math.nan  # frame, NEES, share of wrong pairings, NIS per dof; of `CAUSE` the least family-wise p
    dof: int = 3  # of a NEES

    @property
    def forbids(self) -> bool:
        """Whether the path is of no use, either, and not only its covariances."""
        if self.objection is Objection.NIS:
            return self.value > NIS_LIMIT
        return self.objection not in (Objection.NEES, Objection.CAUSE)


@dataclass(frozen=True)
class Counts:
    """Outcomes of a run's association decisions in one phase."""

    tp: int
    tn: int
    fp: int
    fn: int

    @property
    def decisions(self) -> int:
        """All of them."""
        return self.tp + self.tn + self.fp + self.fn

    @property
    def pairings(self) -> int:
        """Those that paired."""
        return self.tp + self.fp

    @property
    def wrong(self) -> float:
        """Share of wrong pairings; NaN where none was made."""
        return self.fp / self.pairings if self.pairings else math.nan

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); NaN: nothing was or should be paired."""
        wrong = self.fp + self.fn
        return 2.0 * self.tp / (2.0 * self.tp + wrong) if self.tp + wrong > 0 else math.nan

    @property
    def mostly_wrong(self) -> bool:
        """Whether more decisions about pairings are wrong than right."""
        return self.f1 < 0.5


@dataclass(frozen=True)
class RunJudgement:
    """A run in one phase: its numbers in metrics.csv and association.csv, and what objects to it. Unknown: NaN."""

    estimator: str
    association: str
    phase: str
    status: str = "ok"
    # rmse, aligned, from_batch: position RMSE [m] against the truth, after alignment, and against the batch solution;
    # related: mean translation error [m] of the reference relations
    rmse: float = math.nan
    aligned: float = math.nan
    from_batch: float = math.nan
    related: float = math.nan
    # nees, nees_median: of the pose, over the frames but `nees_left_out` of nearly singular covariance; nees_lower:
    # bound of the mean, unknown in SLAM, where the error of the frame is one draw. nis with its bounds and expectation:
    # per degree of freedom. lag1: of innovations; of a smoother that forms none the filter's
    nees: float = math.nan
    dof: int = 3  # 2: of the position, where the truth has no headings
    nees_median: float = math.nan
    nees_left_out: float = math.nan
    nees_lower: float = math.nan
    nis: float = math.nan
    nis_lower: float = math.nan
    nis_upper: float = math.nan
    nis_expected: float = math.nan
    lag1: float = math.nan
    lag1_se: float = math.nan
    rejected: float = math.nan  # observations left out
    landmarks: float = math.nan  # in its map
    lost_frame: float = math.nan
    lost_why: str = ""
    idle: bool = False  # it paired next to nothing
    counts: Counts | None = None  # None: no decisions, or no true ids
    twins: int = 0  # bootstrap replicates that bounds and expectation are of; 0: of the gated chi-square law
    objections: tuple[Objected, ...] = ()  # the strongest first

    @property
    def ok(self) -> bool:
        """Whether it reached the end, is plausible and not lost."""
        return self.status == "ok" and not self.lost_why

    @property
    def usable(self) -> bool:
        """Whether it reached the end, is plausible, not lost, and more than dead reckoning."""
        return not any(o.objection in UNUSABLE for o in self.objections)

    @property
    def foreign(self) -> bool:
        """Whether the estimator is none of ours."""
        return self.estimator not in ESTIMATORS

    @property
    def nis_verdict(self) -> str:
        """The word on the innovations (`innovations_word`); empty where none were formed."""
        return consistency.innovations_word(self.nis, self.nis_lower, self.nis_upper, self.lag1, self.lag1_se)

    @property
    def nis_ratio(self) -> float:
        """NIS over its expectation."""
        return self.nis / self.nis_expected if math.isfinite(self.nis_expected) else self.nis

    @property
    def verdict(self) -> str:
        """The word on one log: status, lost, overconfident by NEES, else on the innovations."""
        if self.status != "ok":
            return self.status
        found = {o.objection for o in self.objections}
        if Objection.LOST in found or Objection.IDLE in found:
            return "lost" if Objection.LOST in found else "dead reckoning"
        return consistency.OVERCONFIDENT if found & {Objection.NEES, Objection.ASTRAY} else self.nis_verdict


def overconfident(nees: float, lower: float = math.nan, dof: int = 3) -> bool:
    """Whether the mean NEES of one log is too large; `lower`: bound of its interval, unknown in SLAM."""
    return nees > consistency.NEES_LIMITS[dof] or lower > NEES_MARGIN * dof


def objections(run: RunJudgement, measured: bool) -> tuple[Objected, ...]:
    """What speaks against an estimate, the strongest first; `measured`: whether there is ground truth. With ground
    truth nobody is lost whose NEES says that it is where it claims to be, and NEES speaks before NIS.
    """
    known, name = measured and math.isfinite(run.nees), run.estimator
    found = []
    if run.status != "ok":
        kind = Objection.IMPLAUSIBLE if run.status == Objection.IMPLAUSIBLE.value else Objection.STOPPED
        found.append(Objected(kind, name))
    if run.lost_why and not (known and run.nees <= consistency.NEES_LIMITS[run.dof]):
        found.append(Objected(Objection.LOST, name, run.lost_frame if math.isfinite(run.lost_frame) else 0.0))
    elif run.idle:
        found.append(Objected(Objection.IDLE, name))
    if not found and known and run.nees > consistency.ASTRAY_NEES * run.dof / 3.0:
        found.append(Objected(Objection.ASTRAY, name, run.nees, run.dof))
    if found:  # its numbers are of no use then
        return tuple(found)
    if known and overconfident(run.nees, run.nees_lower, run.dof):
        found.append(Objected(Objection.NEES, name, run.nees, run.dof))
    if run.counts is not None and run.counts.wrong > WRONG_LIMIT:
        found.append(Objected(Objection.ASSOCIATION, name, run.counts.wrong))
    if not known and run.nis > run.nis_upper:
        found.append(Objected(Objection.NIS, name, run.nis_ratio))
    return tuple(found)


NUMBERS = {
    "rmse": "rmse_position_m", "aligned": "rmse_aligned_m", "from_batch": "rms_from_batch_m", "nees": "nees_pose",
    "nees_median": "nees_pose_median", "nees_lower": "nees_pose_lower", "lag1": "innovation_lag1",
    "lag1_se": "innovation_lag1_se",
} | {name: name for name in (
    "nees_left_out", "nis", "nis_lower", "nis_upper", "nis_expected", "rejected", "landmarks", "lost_frame",
)}  # fmt: skip
"""Fields that are numbers, and their columns in metrics.csv."""


def _typed(row: Row) -> RunJudgement:
    estimator, association, phase, status = (str(row[c]) for c in ("estimator", "association", "phase", "status"))
    numbers = {name: value_of(row, column) for name, column in NUMBERS.items()}
    lost_why = "" if is_blank(row.get("lost_why")) else str(row["lost_why"])
    place = value_of(row, "nees_position")
    if not math.isfinite(numbers["nees"]) and math.isfinite(place):
        numbers |= {"nees": place, "dof": 2}
    return RunJudgement(estimator, association, phase, status, lost_why=lost_why, **numbers)  # type: ignore[arg-type]


def judged_runs(
    metrics: Sequence[Row], outcomes: Sequence[Row] = (), *, measured: bool = True,
    related: Mapping[tuple[str, str, str], float] = {}, idle: AnySet[tuple[str, str]] = frozenset(),
    diagnoses: Sequence[Trust] = (),
) -> tuple[RunJudgement, ...]:  # fmt: skip
    """The runs of one log and task from its rows of metrics.csv and association.csv, in order.

    related: mean errors [m] by estimator, association and phase; idle: runs (estimator, association) that paired next
    to nothing; diagnoses: of this log and task; their bootstrap replicates give bounds and expectations.

    A smoother uses the filter's decisions and noise, so where its row has no innovations of its own, correlated ones of
    a filter that is right otherwise are its own, too.
    """
    counts = {
        (str(r["estimator"]), str(r["association"]), str(r["phase"])): Counts(*(int(value_of(r, c)) for c in OUTCOMES))
        for r in outcomes if not is_blank(r.get("fp"))
    }  # fmt: skip
    drawn = {t.association: t for t in diagnoses if t.twins}
    found = []
    for run in map(_typed, metrics):
        key = (run.estimator, run.association, run.phase)
        run = replace(run, counts=counts.get(key), related=related.get(key, math.nan), idle=key[:2] in idle)
        run = _beside(run, drawn[run.association]) if run.association in drawn else run
        found.append(replace(run, objections=objections(run, measured)))
    filters = filters_in(found)
    right = [r for r in found if r.estimator in filters and r.ok and r.verdict == consistency.CORRELATED]
    lags = {r.association: (r.lag1, r.lag1_se) for r in reversed(right)}
    for i, r in enumerate(found):
        if not math.isfinite(r.lag1) and r.association in lags:
            lag1, error = lags[r.association]
            found[i] = replace(r, lag1=lag1, lag1_se=error)
    return tuple(found)


def _beside(run: RunJudgement, trust: Trust) -> RunJudgement:
    """A run with what is expected of it by the replicates; a final cost is that of `batch`."""
    name = run.estimator if run.phase == "online" else "batch"

    def drawn(statistic: str) -> Array:
        values = [t.measured[name, statistic].value for t in trust.twins if (name, statistic) in t.measured]
        return np.array([v for v in values if math.isfinite(v)], float)

    nis, lag1 = drawn("nis"), drawn("innovation_lag1")
    lower, upper = battery.bounds(nis)
    if math.isfinite(lower):
        run = replace(run, nis_lower=lower, nis_upper=upper, nis_expected=float(np.median(nis)), twins=len(nis))
    if len(lag1) > 1 and math.isfinite(run.lag1):
        run = replace(run, lag1=run.lag1 - float(np.median(lag1)), lag1_se=max(run.lag1_se, float(lag1.std(ddof=1))))
    return run


def filters_in(runs: Sequence[RunJudgement]) -> tuple[str, ...]:
    """The estimators that do not revise their past: ours, and of others those that have no final row."""
    return (*FILTERS, *_others(runs, final=False))


def smoothers_in(runs: Sequence[RunJudgement]) -> tuple[str, ...]:
    """The estimators that do."""
    return (*BATCH, *INCREMENTAL, *_others(runs, final=True))


def _others(runs: Sequence[RunJudgement], *, final: bool) -> list[str]:
    finals = {r.estimator for r in runs if r.phase == "final"}
    return [name for name in dict.fromkeys(r.estimator for r in runs if r.foreign) if (name in finals) == final]


def pick(runs: Sequence[RunJudgement], names: Sequence[str], phase: str) -> RunJudgement | None:
    """The first of the named estimators with a row in the phase; one that reached the end is preferred."""
    found = [r for name in names for r in runs if r.estimator == name and r.phase == phase]
    return min(found, key=lambda r: r.status != "ok", default=None)


EQUAL = 0.02  # relative difference of two RMSE values below which they are called equal
USABLE = 0.9  # an association method is usable whose path has less than this share of dead reckoning's error


@dataclass(frozen=True)
class Methods:
    """How the association methods without labels did on one log and task: runs in their last phase, with counts."""

    first: RunJudgement  # first, worst: by their decisions alone, the same if there is one
    worst: RunJudgement
    best: RunJudgement  # by its decisions, of those with a usable path (of all, where none has one)
    usable: bool  # whether one has: a usable run, and nearer to the truth than dead reckoning
    nearest: RunJudgement | None  # of another method, whose path is clearly nearer to the truth than that of the best
    measured: bool  # whether errors of paths are known
    dead_reckoning: float  # its RMSE [m], or NaN
    labelled: int | None = None  # landmarks that the log's ids tell apart

    @property
    def decides(self) -> bool:
        """Whether one of them gives a usable path and pairs rightly more often than not."""
        return self.usable and self.best.counts is not None and not self.best.counts.mostly_wrong


def deciding(runs: Sequence[RunJudgement]) -> list[RunJudgement]:
    """The plausible runs that decided without labels, in their last phase."""
    filters = filters_in(runs)
    decided = (r for r in runs if r.association not in ("known", "none") and r.status == "ok")
    own = [r for r in decided if r.phase == ("online" if r.estimator in filters else "final")]
    # batch smoothers take the decisions of another run, which speaks for itself where it is there
    own = [r for r in own if steps(r.estimator)] or own
    return [r for r in own if r.counts is not None and math.isfinite(r.counts.f1)]


def methods_of(runs: Sequence[RunJudgement], labelled: int | None = None) -> Methods | None:
    """The best and the worst association method; None where nobody decided, or nothing is known of it."""
    own = deciding(runs)
    if not own:
        return None
    reckoned = next((r.rmse for r in runs if r.estimator == "dead-reckoning"), math.nan)
    usable = [r for r in own if r.usable and not r.rmse >= USABLE * reckoned]
    best = max(usable or own, key=_quality)
    nearest = min((r for r in usable if r.association != best.association), key=lambda r: r.rmse, default=best)
    return Methods(
        first=max(own, key=_quality), worst=min(own, key=_quality), best=best, usable=bool(usable),
        nearest=nearest if nearest.rmse < (1.0 - EQUAL) * best.rmse else None,
        measured=any(math.isfinite(r.rmse) for r in runs), dead_reckoning=reckoned, labelled=labelled,
    )  # fmt: skip


def _quality(run: RunJudgement) -> tuple[float, int]:
    """By which association methods are ordered: F1, then the number of wrong decisions."""
    return (-1.0, 0) if run.counts is None else (run.counts.f1, -run.counts.fp - run.counts.fn)

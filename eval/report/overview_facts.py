"""Facts of the first screen: which estimate to trust, and without truth which assumption is violated."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from data.notice import Notice
from data.questions import asked
from eval.referee import laser_faults
from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, LEAST_FACTOR, NOTHING, UNLISTED, UNTELLABLE, Finding
from eval.referee.diagnostics import unused
from eval.referee.errors import position_distance, rms
from eval.referee.headline import Claim, Headline, Objected, Objection, Preference, Verdict, headline, usable
from eval.referee.score import Scores, Trial
from eval.referee.sources.residuals import source_in
from eval.referee.sources.scored import has_sources
from eval.replay.settings import INCREMENTAL
from eval.report.answer import LINEARIZATION, chosen_association, pick
from eval.report.comparison import difference_of
from eval.report.deciding import SAME, Deciding, MethodOutcome, deciding_facts
from eval.report.rows import Row, Scored, filters_in, rows_of, scored_rows, smoothers_in, value_of
from eval.report.trust import LATE, STANDS_OUT, Explanation, Terms, main_findings, of_trial, terms_of
from eval.studies.trusted import Trust


class Online(StrEnum):
    """What a smoother that steps has at the same instants as the filter, with the same data."""

    UNKNOWN = "unknown"
    EQUAL = "equal"
    FAR_BETTER = "far better"
    OTHER = "other"


@dataclass(frozen=True)
class Gauge:
    """What of a SLAM error is the frame's: RMSE [m] of filter and smoother as they are and after alignment."""

    plain: tuple[float, float]
    aligned: tuple[float, float]
    mostly: bool  # the frame makes at least one of them what it is
    ratio_differs: bool  # of filter and smoother, once aligned


@dataclass(frozen=True)
class LogFacts:
    """Of one log and task."""

    log: str
    task: str
    association: str | None  # under which filter and smoother are compared, None: nothing decides
    filtered: Scored | None  # filtered, smoothed: their rows; None: none ran
    smoothed: Scored | None
    # trusted: which of these two reached the end, are plausible, not lost, and more than dead reckoning
    trusted: tuple[bool, bool]
    empty: bool  # whether the log has neither observations nor scans
    unused: tuple[str, ...]  # names of those that are no more than dead reckoning
    newest: Scored | None  # the online row of a smoother that steps, plausible
    online: Online  # what it says
    measured: bool  # whether errors are known at all
    # errors: position error [m] of both: RMSE, or with reference relations alone (`related`) the mean of theirs; NaN:
    # unknown
    errors: tuple[float, float]
    related: bool
    apart: float  # RMS distance [m] of the filter from the smoother
    best: MethodOutcome | None  # best, worst: association methods without labels, by their decisions
    worst: MethodOutcome | None
    nearest: MethodOutcome | None  # the one with a more accurate path than `best`, if one has
    decides: bool  # whether one of them gives a usable path and pairs rightly more often than not
    runs: int
    failed: tuple[tuple[str, str], ...]  # those that did not get to the end, are implausible, lost, or dead reckoning
    given: tuple[str, ...]  # results that were handed in
    given_best: Scored | None  # the one with the least RMSE
    cause: str | None  # the violated assumption by the diagnosis
    terms: Terms  # of the finding
    finding: Explanation | None  # behind the cause
    twins: int | None  # number of replicates; None: unknown
    verdict: Verdict
    objections: tuple[Objected, ...]
    map_rows: Notice | None  # rows of the map that look swapped or shifted
    gauge: Gauge | None
    # conventions: that the log follows otherwise than stated, or walls and wheels that forbid trust; use neither
    conventions: tuple[Notice, ...] = ()

    @property
    def name(self) -> str:
        """As headings have it."""
        return f"{self.log}, {self.task}"

    @property
    def sound(self) -> bool:
        """Whether nothing objects to the verdict, and both estimates are usable."""
        return Headline(self.verdict, self.objections).sound and all(self.trusted)

    @property
    def unreliable(self) -> bool:
        """Whether something objects to the estimator that is named, not to the other one or to the model alone."""
        other = self.filtered if self.verdict == Verdict.SMOOTHER else None
        spared = {"", other.estimator if other is not None else ""}
        return any(o.estimator not in spared for o in self.objections)

    @property
    def ratio(self) -> float:
        """The filter's error over the smoother's, where both are to be trusted."""
        a, b = self.errors
        return a / b if all(self.trusted) and b > 0.0 else math.nan


def facts_of(trial: Trial, scores: Scores, trust: Sequence[Trust]) -> LogFacts:
    """Everything the first screen needs of a log and task."""
    here = {"log": trial.log.name, "task": trial.task}
    metrics, outcomes = (
        [r for r in rows_of(table) if all(r[k] == v for k, v in here.items())]
        for table in (scores.metrics, scores.association)
    )
    rows = scored_rows(metrics, trust)
    return log_facts(
        trial,
        rows,
        relations=_relations(scores) if trial.log.truth.relations is not None else {},
        decided=deciding_facts(rows, metrics, outcomes),
        trust=next(iter(of_trial(trial, trust)), None),
        idle=frozenset((r.estimator, r.association) for r in trial.runs if unused(r, trial.log.recorded)),
        wrong={(str(r["estimator"]), str(r["association"]), str(r["phase"])): _wrong_share(r) for r in outcomes},
        p=_p_of_difference(scores, *_compared(rows), log=trial.log.name, task=trial.task),
    )


def _compared(rows: Sequence[Scored]) -> tuple[Scored | None, Scored | None]:
    """The rows of the filter and the smoother that are compared, under one association method."""
    own = [r for r in rows if r.association == chosen_association(rows)]
    return pick(own, filters_in(own), "online"), pick(own, smoothers_in(own), "final")


def _wrong_share(row: Row) -> float:
    """Share of a run's pairings that are wrong; NaN where none was made."""
    wrong, right = value_of(row, "fp"), value_of(row, "tp")
    return wrong / (wrong + right) if wrong + right > 0.0 else math.nan


def log_facts(
    trial: Trial,
    rows: Sequence[Scored],
    *,
    relations: Mapping[tuple[str, ...], float] = {},
    decided: Deciding | None = None,
    trust: Trust | None = None,
    idle: frozenset[tuple[str, str]] = frozenset(),
    wrong: Mapping[tuple[str, str, str], float] = {},
    p: float = math.nan,
) -> LogFacts:
    """The facts of a trial from its rows of metrics.csv.

    relations: mean errors [m], by log, estimator, association and phase; idle: runs that paired next to nothing.
    """
    log, truth = trial.log.name, trial.log.truth
    chosen = chosen_association(rows)
    own = [r for r in rows if r.association == chosen]
    filtered, smoothed = _compared(rows)
    newest = pick([r for r in own if r.ok], INCREMENTAL, "online")

    errors = [math.nan if r is None else r.rmse for r in (filtered, smoothed)]
    related = not any(map(math.isfinite, errors)) and truth.relations is not None
    if related:
        errors = [
            math.nan if r is None else relations.get((log, r.estimator, r.association, r.phase), math.nan)
            for r in (filtered, smoothed)
        ]
    last = {(r.estimator, r.association): r for r in rows}
    names = {r.estimator for r in trial.runs if r.handed_in}
    handed = [r for r in rows if r.estimator in names and math.isfinite(r.rmse)]
    apart = math.nan if trust is None or filtered is None else trust.real.apart.get(filtered.estimator, math.nan)
    if filtered is not None and not math.isfinite(apart):
        apart = filtered.from_batch
    if not math.isfinite(apart) and filtered is not None and smoothed is not None:
        apart = _apart(trial, filtered, smoothed)
    measured, slam = truth.known_poses > 0 or truth.relations is not None, trial.task == "slam"

    def claim(row: Scored | None) -> Claim | None:
        if row is None:
            return None
        unused = (row.estimator, row.association) in idle
        share = wrong.get((row.estimator, row.association, row.phase), math.nan)
        return _claim(row, share, idle=unused, slam=slam)

    a, b = claim(filtered), claim(smoothed)
    trusted = usable(a, measured), usable(b, measured)
    compared = errors
    if slam and not related and filtered is not None and smoothed is not None:
        aligned = [filtered.aligned, smoothed.aligned]
        compared = aligned if all(map(math.isfinite, aligned)) else errors
    preference = Preference(compared[0], compared[1], p)
    map_rows = None if slam else next(iter(asked.map_rows(trial.log)), None)
    blame = None if trust is None else trust.blame
    rejected = blame.p if blame is not None and blame.objected else math.nan
    decided_by = headline(a, b, preference, measured=measured, caused=trust is not None, rejected=rejected)
    terms = terms_of(trial.log.recorded)
    conventions = (*asked.conventions(trial.log), *laser_faults.serious(trial))
    return LogFacts(
        log=log,
        task=trial.task,
        association=chosen,
        filtered=filtered,
        smoothed=smoothed,
        trusted=trusted,
        empty=not len(trial.log.recorded.observations.frame)
        and trial.log.recorded.scans is None
        and not has_sources(trial.log.recorded),
        unused=tuple(
            r.estimator for r in (filtered, smoothed) if r is not None and (r.estimator, r.association) in idle and r.ok
        ),
        newest=newest,
        online=Online.UNKNOWN if related or newest is None else _online(errors[0], newest.rmse),
        measured=measured,
        errors=(errors[0], errors[1]),
        related=related,
        apart=apart,
        best=decided.best if decided else None,
        worst=decided.worst if decided else None,
        nearest=decided.nearest if decided else None,
        decides=decided is not None and decided.usable and not decided.best.mostly_wrong,
        runs=len(last),
        failed=tuple(key for key, r in last.items() if not usable(claim(r), measured)),
        given=tuple(sorted(names)),
        given_best=min(handed, key=lambda r: r.rmse, default=None),
        cause=None if trust is None else cause_word(trust),
        terms=terms,
        finding=None if trust is None else next(iter(main_findings(trust, terms)), None),
        twins=None if trust is None or trust.blame is None else len(trust.twins),
        verdict=Verdict.NEITHER if conventions else decided_by.verdict,
        objections=(*_of_map(map_rows), *_of_conventions(conventions), *decided_by.objections),
        map_rows=map_rows,
        gauge=_gauge(filtered, smoothed) if trial.task == "slam" else None,
        conventions=conventions,
    )


def _apart(trial: Trial, filtered: Scored, smoothed: Scored) -> float:
    """RMS distance [m] of the filter's path from the smoother's; NaN where a run has none."""
    runs = {(r.estimator, r.association): r for r in trial.runs}
    found = [runs.get((row.estimator, row.association)) for row in (filtered, smoothed)]
    if any(r is None or r.failure is not None for r in found):
        return math.nan
    one, other = (
        r.trajectory(row.phase).pose for r, row in zip(found, (filtered, smoothed), strict=True) if r is not None
    )
    return rms(position_distance(one, other))


def _of_map(rows: Notice | None) -> tuple[Objected, ...]:
    return () if rows is None else (Objected(Objection.MAP, "", math.nan),)


def _of_conventions(found: Sequence[Notice]) -> tuple[Objected, ...]:
    return (Objected(Objection.CONVENTION, "", math.nan),) * bool(found)


def _claim(row: Scored, wrong: float, *, idle: bool, slam: bool) -> Claim:
    """What a row of metrics.csv claims; in SLAM an interval of one log says nothing of the frame's error."""
    lost = row.lost_frame if row.lost_why else math.nan
    return Claim(
        row.estimator,
        row.status,
        0.0 if row.lost_why and not math.isfinite(lost) else lost,
        idle,
        row.nees,
        math.nan if slam else row.nees_lower,
        wrong,
        row.nis / row.nis_expected if math.isfinite(row.nis_expected) else row.nis,
        row.nis > row.nis_upper,
    )


def _p_of_difference(scores: Scores, filtered: Scored | None, smoothed: Scored | None, log: str, task: str) -> float:
    """P of no difference between the RMSEs of filter and smoother, in SLAM after alignment; NaN: not known."""
    if filtered is None or smoothed is None:
        return math.nan
    own = [r for r in rows_of(scores.differences) if (r["log"], r["task"]) == (log, task)]
    found = difference_of(own, filtered, smoothed)
    return math.nan if found is None else found.p


def _online(filtered: float, online: float) -> Online:
    if not math.isfinite(online):
        return Online.UNKNOWN
    if abs(online - filtered) <= SAME * filtered:
        return Online.EQUAL
    return Online.FAR_BETTER if filtered > LINEARIZATION * online else Online.OTHER


def _relations(scores: Scores) -> dict[tuple[str, ...], float]:
    """Mean errors [m] against all reference relations, tied by row."""
    keys = ("log", "estimator", "association", "phase")
    rows = [r for r in rows_of(scores.relations) if (r["tie"], r["subset"]) == ("row", "all")]
    return {tuple(str(r[k]) for k in keys): value_of(r, "trans_mean_m") for r in reversed(rows)}


MOSTLY = 1.5  # so many times the aligned RMSE, the plain one is half due to the frame in variance (1.5 squared is 2.25)
DIFFERENT = 0.1  # relative change of the ratio of filter and smoother that is worth a word


def _gauge(filtered: Scored | None, smoothed: Scored | None) -> Gauge | None:
    """None where no error is known; in localization the map fixes the frame."""
    if filtered is None or smoothed is None:
        return None
    (a, a_fit), (b, b_fit) = ((r.rmse, r.aligned) for r in (filtered, smoothed))
    if not all(math.isfinite(v) and v > 0.0 for v in (a, a_fit, b, b_fit)):
        return None
    mostly = a > MOSTLY * a_fit or b > MOSTLY * b_fit
    return Gauge((a, b), (a_fit, b_fit), mostly, abs(a_fit / b_fit / (a / b) - 1.0) > DIFFERENT)


ODOMETRY, SENSOR = "odometry", "sensor"


def cause_word(trust: Trust) -> str:
    """The violated assumption, of a noise the side whose component it is of; without replicates a hint."""
    blame = trust.blame
    if blame is None:
        return _hinted(trust)
    if blame.cause in (NOTHING, ASSOCIATIONS, ESTIMATOR, UNLISTED, UNTELLABLE):
        return blame.cause
    found = next((f for f in blame.findings if f.cause == blame.cause), None)
    if found is not None:
        return side_of(found)
    # no finding has a name: the side of the residuals furthest outside the range of the replicates
    sides = [side(name.split("_", 1)[1]) for _, name in blame.objected if name.startswith(("slope_", "residual_"))]
    return max(dict.fromkeys(sides), key=sides.count) if sides else _largest(_spreads(trust)) or SENSOR


def side_of(found: Finding) -> str:
    """What a finding is a fault of: odometry, sensor, map, time stamps, or a source of fixes or closures."""
    if found.name in LATE:
        return "time stamps"
    if found.kind in ("displaced", "landmark") or found.name == "map_scale":
        return "map"
    return side(found.name)


def side(component: str) -> str:
    """Whether a component belongs to odometry, to the sensor, or to a source of fixes or closures (its name)."""
    if (source := source_in(component)) is not None:
        return source
    return ODOMETRY if component.startswith("odometry") else SENSOR


def _hinted(trust: Trust) -> str:
    """Without replicates: the systematic error beyond `STANDS_OUT` standard errors, else a noise larger than stated."""
    slopes = {
        name.removeprefix("slope_"): abs(m.value) / m.se
        for (_, name), m in trust.real.measured.items()
        if name.startswith("slope_") and math.isfinite(m.value) and math.isfinite(m.se) and m.se > 0.0
    }
    if max(slopes.values(), default=0.0) > STANDS_OUT:
        return _largest(slopes)
    larger = {name: value for name, value in _spreads(trust).items() if value > LEAST_FACTOR}
    return _largest(larger) or NOTHING


def _spreads(trust: Trust) -> dict[str, float]:
    """Spread of the smoother's residuals in stated sigmas, by component."""
    return {
        name.removeprefix("residual_").removesuffix("_spread"): m.value
        for (_, name), m in trust.real.measured.items()
        if name.startswith("residual_") and name.endswith("_spread") and math.isfinite(m.value)
    }


def _largest(sizes: Mapping[str, float]) -> str:
    return side(max(sizes, key=lambda name: sizes[name])) if sizes else ""


@dataclass(frozen=True)
class Conclusion:
    """All logs and tasks together; logs are named with their task where several rows are on them."""

    logs: int
    filters: tuple[str, ...]  # filters, smoothers: names of those compared, three at most
    smoothers: tuple[str, ...]
    given: int  # results handed in
    smoother: tuple[str, ...]  # smoother to neither: logs with truth with this verdict
    either: tuple[str, ...]
    filter: tuple[str, ...]
    neither: tuple[str, ...]
    unreliable: tuple[str, ...]  # those where something objects to the estimator that is named
    everywhere: bool  # the first is all there are
    ratios: tuple[float, float] | None  # least and largest error of the filter over the smoother's, None: no pair
    filter_fails: int  # so many rows
    # blind: of the logs without truth those with one word, by the facts of the first of them
    blind: tuple[tuple[LogFacts, tuple[str, ...]], ...]


def conclusion(facts: Sequence[LogFacts]) -> Conclusion:
    """What was compared, and what follows."""
    tasks = Counter(f.log for f in facts)

    def named(found: Sequence[LogFacts]) -> tuple[str, ...]:
        return tuple(f"{f.log} ({f.task})" if tasks[f.log] > 1 else f.log for f in found)

    unreliable = [f for f in facts if f.measured and f.unreliable and f.verdict != Verdict.NEITHER]
    by_verdict = {v: [f for f in facts if f.measured and f.verdict == v and f not in unreliable] for v in Verdict}
    smoother = by_verdict[Verdict.SMOOTHER]
    both = [f for f in smoother if all(f.trusted)]
    ratios = [f.ratio for f in both if math.isfinite(f.ratio)]
    blind: dict[tuple[object, ...], list[LogFacts]] = {}
    for f in facts:
        if not f.measured:
            only = f.filtered if f.verdict == Verdict.ONLY else None
            blind.setdefault(
                (f.verdict, f.cause if f.verdict == Verdict.CAUSE else None, only and only.estimator), []
            ).append(f)
    sides = ([f.filtered for f in facts], [f.smoothed for f in facts])
    filters, smoothers = (tuple(dict.fromkeys(r.estimator for r in rows if r is not None))[:3] for rows in sides)
    return Conclusion(
        logs=len(tasks),
        filters=filters,
        smoothers=smoothers,
        given=len({name for f in facts for name in f.given}),
        smoother=named(smoother),
        either=named(by_verdict[Verdict.EITHER]),
        filter=named(by_verdict[Verdict.FILTER]),
        neither=named(by_verdict[Verdict.NEITHER]),
        unreliable=named(unreliable),
        everywhere=len(smoother) == len(facts),
        ratios=(min(ratios), max(ratios)) if ratios else None,
        filter_fails=len(smoother) - len(both),
        blind=tuple((found[0], named(found)) for found in blind.values()),
    )

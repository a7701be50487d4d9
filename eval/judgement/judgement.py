"""`judge`: filter against smoother on one log and task, whom to trust, and what speaks against it.

No tick stands where a number of the same result objects: NEES, NIS, wrong pairings, a lost or implausible estimate.
Ground truth speaks before anything that is inferred without it.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from association.names import SCAN
from data.notice import Code, Notice
from data.origin import Origins, assumed
from data.questions import asked
from data.truth import BadTruth
from eval.judgement import runs as of_runs
from eval.judgement.causes import Terms, cause_word, explanations, main_findings, of_trial, terms_of
from eval.judgement.runs import Methods, Objected, Objection, RunJudgement, judged_runs, methods_of
from eval.referee.attribution import CONTRADICTED, NOTHING, UNTELLABLE, Finding
from eval.referee.consistency import NEES_LIMITS, UNSUSPICIOUS
from eval.referee.diagnostics import of_wings
from eval.referee.errors import position_distance, rms
from eval.referee.lost import informed
from eval.referee.result_files import Row, is_blank, rows_of, value_of
from eval.referee.score import Scores, Trial, score
from eval.referee.sources import has_sources
from eval.replay.settings import INCREMENTAL
from eval.studies.diagnosis import Trust, contradicted

CHANCE = 0.05  # A larger p is called chance, as is a difference whose interval holds zero: near it they may differ
UNTRUSTED = (Code.AGAINST_WHEELS, Code.WHEELS_SCALE, Code.DOUBLED_WALLS, Code.WAY_UNOBSERVED)
"""What forbids to trust any path of a log: it leaves the wheels, or their way is wrong by a factor, its walls are
doubled, or nothing tells its way."""
CLEAR = 1.1  # ratio of two RMSEs that is a difference where no interval can be formed
FAR_NIS = 2.0  # NIS of a smoother over its expectation, beside a lost filter: its pairings are those of the filter
SAME = 0.02  # relative difference of an online smoother's RMSE and a filter's below which they are called equal
LINEARIZATION = 2.0  # So many times the RMSE of a smoother with the same data at the same instants: not luck
FAR = 20.0  # A filter's NIS so many times the smoother's is linearization: a wrong map, prior or a jump gives up to 10
STILL = 0.1  # m and rad that no path goes or turns in a log in which nothing moves
MOSTLY = 1.5  # so many times the aligned RMSE, the plain one is half due to the frame in variance (1.5 squared is 2.25)


class Verdict(StrEnum):
    """The estimator whose path to use, or why none is named."""

    SMOOTHER = "smoother"
    EITHER = "either"
    FILTER = "filter"
    NEITHER = "neither"
    ONLY = "only one ran"
    NOTHING = "nothing ran"
    CAUSE = "cause"
    UNKNOWN = "unknown"


class Tone(StrEnum):
    """How far a verdict may be relied on, as the colour of its mark."""

    GOOD = "good"
    FAIR = "fair"
    BAD = "bad"
    NONE = "none"


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


@dataclass(frozen=True)
class Difference:
    """RMSE of a filter minus that of a smoother on the same frames [m], with 95 % interval and p of no difference."""

    metres: float
    lower: float
    upper: float
    p: float
    block_frames: float  # over so many frames errors are correlated
    own_map: bool  # both have errors of a map that they made themselves
    why: str  # there is no interval (p is NaN then)

    @property
    def chance(self) -> bool:
        """Whether it may be."""
        return self.p > CHANCE or self.lower <= 0.0 <= self.upper


@dataclass(frozen=True)
class Comparison:
    """Filter and smoother under one association method."""

    association: str | None  # None: nothing decides
    several: bool  # whether other methods were run
    filtered: RunJudgement | None  # filtered, smoothed: of the online and the final phase; None: none ran
    smoothed: RunJudgement | None
    newest: RunJudgement | None  # the online phase of a smoother that steps, if it is plausible and not lost
    online: Online  # what that says
    # errors: position error [m] of both: RMSE, or with reference relations alone (`related`) the mean of theirs
    errors: tuple[float, float]
    related: bool
    apart: float  # RMS distance [m] of the filter from the smoother
    difference: Difference | None  # of their errors, with what chance makes of it
    nearer: Verdict  # SMOOTHER, EITHER, FILTER or UNKNOWN: to the truth
    gauge: Gauge | None = None  # in SLAM

    @property
    def pair(self) -> tuple[RunJudgement, ...]:
        """Those of the two that ran."""
        return tuple(r for r in (self.filtered, self.smoothed) if r is not None)

    @property
    def tested(self) -> bool:
        """False of matched scans that closed no loop: then nothing was predicted and then observed."""
        return self.association != SCAN or any(math.isfinite(r.nis) for r in self.pair)

    @property
    def lost_to_linearization(self) -> bool:
        """Whether the filter alone is lost, with observations that fit the smoother far better."""
        a, b = self.filtered, self.smoothed
        if a is None or b is None or not a.lost_why or b.lost_why:
            return False
        return b.nis <= b.nis_upper or FAR * b.nis < a.nis


@dataclass(frozen=True)
class Cause:
    """What a diagnosis without ground truth found; p: the least family-wise one where it rejects, else NaN."""

    word: str  # the violated assumption
    findings: tuple[Finding, ...]  # the weightiest, for a first page
    terms: Terms
    twins: int | None  # number of replicates; None: no diagnosis by them
    p: float = math.nan

    @property
    def finding(self) -> Finding | None:
        """The weightiest finding whose size is known, in a person's unit."""
        return next(iter(explanations(self.findings, self.terms)), None)


@dataclass(frozen=True)
class LogFaults:
    """What objects to a log: its map, its conventions, its contents."""

    map_rows: Notice | None = None  # rows of the map that look swapped or shifted
    # conventions: that the log follows otherwise than stated, or walls and wheels that forbid trust; use neither
    conventions: tuple[Notice, ...] = ()
    empty: bool = False  # neither observations nor scans
    idle_scans: int | None = None  # scans are all there is, so many, and one at most or the robot never moves
    left_out: tuple[BadTruth, ...] = ()  # windows of bad ground truth that are not scored


@dataclass(frozen=True)
class Judgement:
    """Of one log and task, from all its runs.

    Example:
        >>> [(o.objection, o.estimator) for o in slamref.judge(trial).objections]
    """

    log: str
    task: str
    measured: bool  # whether errors are known at all
    runs: tuple[RunJudgement, ...]  # every run in every phase, in the order of metrics.csv; `last`: in its last phase
    compared: Comparison
    verdict: Verdict  # whose path to use
    covariances: bool  # whether its covariances may be used, too
    objections: tuple[Objected, ...] = ()  # to the verdict, the strongest first
    methods: Methods | None = None  # how the association methods without labels did; None: no scored ones
    cause: Cause | None = None  # None without a diagnosis
    log_faults: LogFaults = field(default_factory=LogFaults)
    given: tuple[str, ...] = ()  # names of results that were handed in
    origins: Origins = field(default_factory=dict)  # of noise, prior and so on, unless the recording states them

    @property
    def assumed_noise(self) -> tuple[str, ...]:
        """Noises that covariances, NEES and NIS are relative to, as nobody stated them."""
        return assumed(self.origins)

    @property
    def name(self) -> str:
        """As headings have it."""
        return f"{self.log}, {self.task}"

    @property
    def last(self) -> tuple[RunJudgement, ...]:
        """Each run with what is known in the end."""
        return tuple({(r.estimator, r.association): r for r in self.runs}.values())

    @property
    def unusable(self) -> tuple[RunJudgement, ...]:
        """Runs that did not get to the end, are implausible, lost, astray, or dead reckoning."""
        return tuple(r for r in self.last if not r.usable)

    @property
    def others(self) -> tuple[RunJudgement, ...]:
        """Foreign estimators that something objects to, beside the two compared."""
        return tuple(r for r in self.last if r.foreign and r.objections and r not in self.compared.pair)

    @property
    def usable(self) -> tuple[bool, bool]:
        """Whether filter and smoother are."""
        a, b = self.compared.filtered, self.compared.smoothed
        return a is not None and a.usable, b is not None and b.usable

    @property
    def ratio(self) -> float:
        """The filter's error over the smoother's, where both are usable."""
        a, b = self.compared.errors
        return a / b if all(self.usable) and b > 0.0 else math.nan

    @property
    def misfit(self) -> RunJudgement | None:
        """The filter, else the smoother, whose innovations do not fit."""
        return next((r for r in self.compared.pair if r.nis_verdict not in UNSUSPICIOUS), None)

    @property
    def tone(self) -> Tone:
        """Good: nothing objects; fair: a path may be used; bad: none may."""
        if self.verdict in (Verdict.SMOOTHER, Verdict.EITHER) and not self.objections and all(self.usable):
            return Tone.GOOD
        if self.verdict is Verdict.CAUSE and self.cause is not None:
            if self.cause.word == NOTHING and self.misfit is None and not self.objections:
                return Tone.GOOD
            return Tone.BAD if self.cause.word == UNTELLABLE else Tone.FAIR
        if self.verdict in (Verdict.SMOOTHER, Verdict.EITHER, Verdict.FILTER):
            return Tone.FAIR
        return Tone.BAD if self.verdict is Verdict.NEITHER else Tone.NONE

    @property
    def given_best(self) -> RunJudgement | None:
        """The result that was handed in with the least RMSE."""
        handed = [r for r in self.runs if r.estimator in self.given and math.isfinite(r.rmse)]
        return min(handed, key=lambda r: r.rmse, default=None)


def judge(trial: Trial, scores: Scores | None = None, diagnoses: Sequence[Trust] = ()) -> Judgement:
    """The judgement of a trial.

    Args:
        trial: the runs, with the truth.
        scores: of these trials, if they are known already.
        diagnoses: without ground truth, of any logs.

    Example:
        >>> slamref.judge(trial).verdict
    """
    scores = score([trial]) if scores is None else scores
    of, tables = (trial.log.name, trial.task), (scores.metrics, scores.association, scores.differences)
    metrics, outcomes, differences = ([r for r in rows_of(t) if (r["log"], r["task"]) == of] for t in tables)
    own = [t for t in diagnoses if (t.log, t.task) == (trial.log.name, trial.task)]
    related: dict[tuple[str, str, str], float] = {}  # mean errors against all reference relations, tied by row
    for r in reversed(rows_of(scores.relations)) if trial.log.truth.relations is not None else ():
        if (r["log"], r["tie"], r["subset"]) == (trial.log.name, "row", "all"):
            related[str(r["estimator"]), str(r["association"]), str(r["phase"])] = value_of(r, "trans_mean_m")
    idle, measured = trial.unused.keys(), _measured(trial)
    runs = judged_runs(metrics, outcomes, measured=measured, related=related, idle=idle, diagnoses=own)
    return judgement_of(trial, runs, differences, next(iter(of_trial(trial, own)), None))


def judgement_of(
    trial: Trial, runs: tuple[RunJudgement, ...], differences: Sequence[Row] = (), trust: Trust | None = None
) -> Judgement:
    """The judgement of a trial whose runs are judged one by one; differences: rows of `Scores.differences`."""
    log, slam, measured = trial.log, trial.task == "slam", _measured(trial)
    compared = compared_of(trial, runs, differences, trust)
    contradictions = asked.conventions if trust is None else contradicted
    swapped = None if slam else next(iter(asked.map_rows(log)), None)
    broken = (*contradictions(log), *(n for n in of_wings(trial, ()) if n.code in UNTRUSTED))
    r = log.recorded
    others = len(r.observations.frame) or has_sources(r) or any(map(informed, trial.runs))
    scans = None if others or r.scans is None else len(r.scans.frame)
    paths = [run.trajectory(run.phases[-1]).pose for run in trial.runs if run.phases]
    ways = [np.abs(r.increments.mean).sum(axis=0), *(np.ptp(path, axis=0) for path in paths)]
    if scans is not None and scans > 1 and np.nanmax(ways) > STILL:
        scans = None
    log_faults = LogFaults(swapped, broken, not others and r.scans is None, scans, log.truth.left_out)
    terms, blame = terms_of(log.recorded), None if trust is None else trust.blame
    cause = None
    if trust is not None:
        p = blame.p if blame is not None and blame.objected else math.nan
        twins = None if blame is None else len(trust.twins)
        word = CONTRADICTED if log_faults.conventions else cause_word(trust)
        cause = Cause(word, tuple(main_findings(trust)), terms, twins, p)
    verdict, objections = decided(compared, cause, log_faults, measured=measured)
    true_id = log.truth.landmark_of
    labelled = None if true_id is None else len(np.unique(true_id[true_id >= 0]))
    return Judgement(
        log.name, trial.task, measured, runs, compared, verdict,
        _covariances(verdict, objections, compared, cause, measured=measured), objections, methods_of(runs, labelled),
        cause, log_faults, tuple(sorted({r.estimator for r in trial.runs if r.handed_in})), log.origins,
    )  # fmt: skip


def _measured(trial: Trial) -> bool:
    """Whether any error can be known."""
    return trial.log.truth.known_poses > 0 or trial.log.truth.relations is not None


def compared_of(
    trial: Trial, runs: Sequence[RunJudgement], differences: Sequence[Row] = (), trust: Trust | None = None
) -> Comparison:
    """Filter and smoother under the association method that is chosen for comparison."""
    # known association, or else the first that a filter and a smoother share, or else any
    both_kinds = of_runs.filters_in(runs), of_runs.smoothers_in(runs)
    filters, smoothers = ({r.association for r in runs if r.estimator in names} for names in both_kinds)
    given = dict.fromkeys(r.association for r in runs if r.association != "none")
    chosen = min(given, key=lambda a: (a != "known", a not in filters & smoothers), default=None)
    own = [r for r in runs if r.association == chosen]
    filtered = of_runs.pick(own, of_runs.filters_in(own), "online")
    smoothed = of_runs.pick(own, of_runs.smoothers_in(own), "final")
    newest = of_runs.pick([r for r in own if r.ok], INCREMENTAL, "online")
    both = None if filtered is None or smoothed is None else (filtered, smoothed)

    def each(field: str) -> tuple[float, float]:
        a, b = (math.nan if r is None else float(getattr(r, field)) for r in (filtered, smoothed))
        return a, b

    errors = each("rmse")
    related = not any(map(math.isfinite, errors)) and trial.log.truth.relations is not None
    errors = each("related") if related else errors
    apart = math.nan if trust is None or filtered is None else trust.real.apart.get(filtered.estimator, math.nan)
    if filtered is not None and not math.isfinite(apart):
        apart = filtered.from_batch
    if not math.isfinite(apart) and both is not None:
        own_runs = {(r.estimator, r.association): r for r in trial.runs}
        ends = [(own_runs.get((r.estimator, r.association)), r.phase) for r in both]
        paths = [run.trajectory(phase).pose for run, phase in ends if run is not None and run.failure is None]
        apart = rms(position_distance(paths[0], paths[1])) if len(paths) == 2 else math.nan
    aligned = each("aligned")
    fair = aligned if (trial.task == "slam" and not related and all(map(math.isfinite, aligned))) else errors
    difference = None if both is None else difference_of(differences, *both)
    online = Online.UNKNOWN
    if newest is not None and not related and math.isfinite(newest.rmse):
        far = Online.FAR_BETTER if errors[0] > LINEARIZATION * newest.rmse else Online.OTHER
        online = Online.EQUAL if abs(newest.rmse - errors[0]) <= SAME * errors[0] else far
    return Comparison(
        chosen, len({r.association for r in runs if r.association != "none"}) > 1, filtered, smoothed, newest, online,
        errors, related, apart, difference, nearer(*fair, difference),
        _gauge(*both) if both is not None and trial.task == "slam" else None,
    )  # fmt: skip


def nearer(filtered: float, smoothed: float, difference: Difference | None = None) -> Verdict:
    """The estimator whose path is nearer to the truth by its error [m]; either where the difference may be chance."""
    if not (math.isfinite(filtered) and math.isfinite(smoothed)):
        return Verdict.UNKNOWN
    if difference is not None and math.isfinite(difference.p):
        apart = not difference.chance
    else:
        apart = max(filtered, smoothed) > CLEAR * min(filtered, smoothed)
    if not apart or filtered == smoothed:
        return Verdict.EITHER
    return Verdict.SMOOTHER if smoothed < filtered else Verdict.FILTER


def decided(
    compared: Comparison, cause: Cause | None = None, log_faults: LogFaults = LogFaults(), *, measured: bool
) -> tuple[Verdict, tuple[Objected, ...]]:
    """Whose path to use, and what speaks against it, the strongest first."""
    filtered, smoothed = compared.filtered, compared.smoothed
    of_filter, of_smoother = (r is not None and r.usable for r in (filtered, smoothed))
    if not compared.pair:
        return Verdict.NOTHING, ()
    if of_smoother and not of_filter:
        follows = False  # whether it stands on the pairings of a lost filter: its own numbers are far out
        if filtered is not None and smoothed is not None:
            by_nees = measured and math.isfinite(smoothed.nees)
            follows = smoothed.nees > NEES_LIMITS[smoothed.dof] if by_nees else smoothed.nis_ratio > FAR_NIS
        verdict = Verdict.NEITHER if follows else Verdict.SMOOTHER
    elif of_filter and not of_smoother:
        verdict = Verdict.ONLY if smoothed is None else Verdict.FILTER
    elif not of_filter:
        verdict = Verdict.NEITHER
    elif not measured:
        told = cause is not None and log_faults.idle_scans is None and compared.tested
        verdict = Verdict.CAUSE if told else Verdict.UNKNOWN
    else:
        verdict = compared.nearer
    found = [o for r in _named(verdict, compared) for o in r.objections]
    if any(o.forbids for o in found):
        verdict = Verdict.NEITHER
    if verdict is Verdict.SMOOTHER and filtered is not None:  # a tick would stand for it, too
        found += [o for o in filtered.objections if o.objection is Objection.NEES]
    if measured and verdict in (Verdict.SMOOTHER, Verdict.EITHER, Verdict.FILTER):
        found += [Objected(Objection.CAUSE, "", cause.p)] if cause is not None and math.isfinite(cause.p) else []
    if log_faults.conventions:
        verdict = Verdict.NEITHER
        found.append(Objected(Objection.CONVENTION, ""))
    if log_faults.map_rows is not None:
        found.append(Objected(Objection.MAP, ""))
    return verdict, tuple(sorted(found, key=lambda o: list(Objection).index(o.objection)))


def _named(verdict: Verdict, compared: Comparison) -> tuple[RunJudgement, ...]:
    """The estimators that a verdict is about."""
    one = compared.smoothed if verdict is Verdict.SMOOTHER else compared.filtered
    alone = verdict in (Verdict.SMOOTHER, Verdict.FILTER, Verdict.ONLY)
    return (one,) if alone and one is not None else compared.pair


def _covariances(
    verdict: Verdict, objections: Sequence[Objected], compared: Comparison, cause: Cause | None, *, measured: bool
) -> bool:
    """Whether nothing objects to the model, or to the estimator that is named; the other one is spared."""
    if verdict is Verdict.NEITHER or (verdict is Verdict.CAUSE and cause is not None and cause.word != NOTHING):
        return False
    if not measured and any(r.nis_verdict not in UNSUSPICIOUS for r in compared.pair):
        return False
    named = {"", *(r.estimator for r in _named(verdict, compared))}
    return not any(o.estimator in named for o in objections)


def difference_of(rows: Sequence[Row], filtered: RunJudgement, smoothed: RunJudgement) -> Difference | None:
    """The difference between two runs; None if it was not taken."""
    pair = (filtered.estimator, smoothed.estimator, filtered.association)
    row = next((r for r in rows if (r["a"], r["b"], r["association"]) == pair), None)
    if row is None:
        return None
    size, lower, upper, p = (value_of(row, f"rmse_position_{c}") for c in ("m", "lower", "upper", "p"))
    why = "" if is_blank(row["rmse_position_why"]) else str(row["rmse_position_why"])
    return Difference(size, lower, upper, p, value_of(row, "block_frames"), row["task"] == "slam", why)


def _gauge(filtered: RunJudgement, smoothed: RunJudgement) -> Gauge | None:
    """None where no error is known; in localization the map fixes the frame."""
    (a, a_fit), (b, b_fit) = ((r.rmse, r.aligned) for r in (filtered, smoothed))
    if not all(math.isfinite(v) and v > 0.0 for v in (a, a_fit, b, b_fit)):
        return None
    return Gauge((a, b), (a_fit, b_fit), a > MOSTLY * a_fit or b > MOSTLY * b_fit)


def conclusion(found: Sequence[Judgement]) -> dict[str, Any]:
    """What was compared, and what follows; logs are named with their task where several rows are on them."""
    tasks = Counter(j.log for j in found)

    def named(some: Sequence[Judgement]) -> tuple[str, ...]:
        return tuple(f"{j.log} ({j.task})" if tasks[j.log] > 1 else j.log for j in some)

    by_verdict = {v: [j for j in found if j.measured and j.verdict == v] for v in Verdict}
    smoother = by_verdict[Verdict.SMOOTHER]
    both = [j for j in smoother if all(j.usable)]
    ratios = [j.ratio for j in both if math.isfinite(j.ratio)]
    blind: dict[tuple[object, ...], list[Judgement]] = {}
    for j in found:
        if not j.measured:
            only = j.compared.filtered if j.verdict == Verdict.ONLY else None
            cause = j.cause.word if j.cause is not None and j.verdict == Verdict.CAUSE else None
            blind.setdefault((j.verdict, j.covariances, cause, only and only.estimator), []).append(j)
    sides = ([j.compared.filtered for j in found], [j.compared.smoothed for j in found])
    filters, smoothers = (tuple(dict.fromkeys(r.estimator for r in runs if r is not None))[:3] for runs in sides)
    preferred_verdicts = (Verdict.SMOOTHER, Verdict.EITHER, Verdict.FILTER)
    preferred = [j for v in preferred_verdicts for j in by_verdict[v]]
    return {
        "logs": len(tasks),
        "filters": filters,  # of those compared, three at most
        "smoothers": smoothers,
        "given": len({name for j in found for name in j.given}),
        # logs with truth by verdict; of the first three those whose covariances are not to be used
        **{v.value: named(by_verdict[v]) for v in (*preferred_verdicts, Verdict.NEITHER)},
        "paths": named([j for j in preferred if not j.covariances]),
        "everywhere": len(smoother) == len(found),
        "ratios": (min(ratios), max(ratios)) if ratios else None,  # of the filter's error over the smoother's
        "filter_fails": len(smoother) - len(both),
        # of the logs without truth those with one word, by the judgement of the first of them
        "blind": tuple((some[0], named(some)) for some in blind.values()),
    }

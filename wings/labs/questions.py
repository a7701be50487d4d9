"""The facts of the corridor lab's six questions, and of motion from two scans; words: `templates/labs/corridor`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.special import logsumexp

from data.inputs import Increment, IntArray
from data.log import Log
from data.se2 import Array, between
from eval.referee.score import Scores
from eval.report.words import plus_minus
from wings.labs.corridor import (
    BLIND,
    NAMES,
    ODOMETRY,
    PEOPLE,
    THE_LABS,
    TURN,
    Judge,
    Judged,
    Lab,
    Motion,
    maintained_pair,
    reach,
    true_against_stated,
)

SEED_COLUMNS = ("FP", "FN", "RMSE [m]", "aligned RMSE [m]")
WORSE = 1.5  # an error this many times another one is called worse, below it comparable


@dataclass(frozen=True)
class Lack:
    """Why a question is not answered: the condition and the methods it needs, and whether such a log was run at all."""

    people: bool
    odometry: bool
    names: tuple[str, ...]
    maintained: bool
    is_there: bool


@dataclass(frozen=True)
class NearestNeighbour:
    """NN against known association, without people."""

    nn: Judged | None
    known: Judged | None
    lack: Lack | None

    @property
    def explained(self) -> bool:
        """Whether the error of the pose is large enough to make another landmark the nearest one."""
        return self.nn is not None and self.nn.p.off >= 0.5 * self.nn.p.apart

    @property
    def costly(self) -> bool:
        """Whether its path is worse than with known association."""
        return self.nn is not None and self.known is not None and self.nn.rmse > WORSE * self.known.rmse


@dataclass(frozen=True)
class Singles:
    """NN, SINGLES and JCBB without people; `lost`: names of those that did not get to their end."""

    nn: Judged | None
    singles: Judged | None
    jcbb: Judged | None
    lost: tuple[str, ...]

    @property
    def lack(self) -> None:
        """It is answered from what there is."""


@dataclass(frozen=True)
class People:
    """NN and SINGLES, each (without people, with them); `lost`: names of those that were not run on both logs."""

    pairs: tuple[tuple[Judged, Judged], ...]
    lost: tuple[str, ...]
    lack: Lack | None

    @property
    def broken(self) -> tuple[str, ...]:
        """Names of those whose path is worse with people."""
        return tuple(b.name for a, b in self.pairs if b.rmse > WORSE * a.rmse)

    @property
    def ghosts(self) -> int:
        """Pairings of people with landmarks initialized on people."""
        return sum(b.p.clutter_again for _, b in self.pairs)

    @property
    def points(self) -> int:
        """Pairings of people with landmarks of points."""
        return sum(b.p.clutter_paired for _, b in self.pairs) - self.ghosts


@dataclass(frozen=True)
class OverSeeds:
    """Mean and standard deviation over the seeds in which all methods reached their end, by method and column."""

    logs: tuple[str, ...]  # of these seeds; a single one: the lab's log, which has no generator
    mean: dict[str, tuple[float, ...]]
    deviation: dict[str, tuple[float, ...]]
    # seeds in which JCBB's path is nearer to the truth than the one with labels, as it is and after alignment
    nearer: int
    nearer_aligned: int

    def text(self, method: str, column: str) -> str:
        """Mean ± standard deviation."""
        i = SEED_COLUMNS.index(column)
        return plus_minus(self.mean[method][i], self.deviation[method][i])

    @property
    def labels_win(self) -> bool:
        """Whether right pairings give the smaller RMSE on average."""
        return self.mean["known"][2] < self.mean[THE_LABS["jcbb"][0]][2]


@dataclass(frozen=True)
class Joint:
    """JCBB against NN, SINGLES and known association on the same log: with people, or else without."""

    jcbb: Judged | None
    nn: Judged | None
    singles: Judged | None
    known: Judged | None
    lack: Lack | None
    repeated: OverSeeds | None = None  # over several seeds, in a lab that is handed in and answered by the filter

    @property
    def runs(self) -> tuple[Judged, ...]:
        """Those that are there."""
        return tuple(r for r in (self.jcbb, self.nn, self.singles, self.known) if r is not None)

    @property
    def better(self) -> bool:
        """Whether JCBB decides and estimates better than NN."""
        a, b = self.jcbb, self.nn
        return a is not None and b is not None and a.p.wrong < b.p.wrong and a.rmse < b.rmse

    @property
    def close(self) -> bool:
        """Whether JCBB's path is about as good as with known association."""
        return self.jcbb is not None and self.known is not None and self.jcbb.rmse <= WORSE * self.known.rmse


@dataclass(frozen=True)
class Blind:
    """What happens when the wheels are not read."""

    known: Judged | None  # known, jcbb: filters with these
    jcbb: Judged | None
    smoother: Judged | None  # batch with known association, if its result is plausible
    motion: Motion | None  # true against stated motions
    reach: float  # m from the start in truth, at most
    runs: tuple[Judged, ...]  # with each of `METHODS` that reached its end
    lack: Lack | None

    @property
    def usable(self) -> tuple[str, ...]:
        """Association methods with a usable path."""
        return tuple(r.association for r in self.runs if r.usable)

    @property
    def best(self) -> Judged | None:
        """The one with the least error."""
        return min(self.runs, key=lambda r: r.rmse, default=None)

    @property
    def others(self) -> tuple[Judged, ...]:
        """Those that the paragraph has not named yet."""
        return tuple(r for r in self.runs if r.association in ("nn", "singles", "jcbb-hindsight"))

    @property
    def suffices(self) -> bool:
        """Whether a smoother's path is usable where the filter with the same pairings is worse."""
        a, b = self.known, self.smoother
        return a is not None and b is not None and b.usable and b.errors["final"] < a.rmse / WORSE


@dataclass(frozen=True)
class Maintenance:
    """A run without and with map maintenance."""

    plain: Judged | None
    kept: Judged | None
    lack: Lack | None

    @property
    def better(self) -> bool:
        """Whether the path with it is clearly better."""
        return self.plain is not None and self.kept is not None and self.kept.rmse * WORSE < self.plain.rmse

    @property
    def worse(self) -> bool:
        """Whether it is clearly worse."""
        return self.plain is not None and self.kept is not None and self.kept.rmse > WORSE * self.plain.rmse


@dataclass(frozen=True)
class Answers:
    """The facts of all six questions, the logs they are from, and every run that was looked at."""

    logs: tuple[str, ...]
    runs: tuple[Judged, ...]
    nn: NearestNeighbour
    singles: Singles
    people: People
    jcbb: Joint
    blind: Blind
    maintenance: Maintenance

    def rows(self, condition: tuple[bool, bool, bool], methods: Iterable[str]) -> list[Judged]:
        """The runs of a condition (people, odometry, maintained) with some methods, in their order."""
        of = {r.association: r for r in self.runs if (r.people, r.odometry, r.maintained) == condition}
        return [of[m] for m in methods if m in of]


def answers(lab: Lab, scores: Scores) -> Answers:
    """All that the lab's questions need."""
    judge = Judge(scores)
    plain = {c: judge.runs(t) for c, t in lab.trials.items()}
    kept = {c: judge.runs(t) for c, t in lab.maintained.items()}

    def of(switches: tuple[bool, bool], method: str) -> Judged | None:
        runs = plain.get(switches, {})
        return next((runs[name] for name in THE_LABS.get(method, (method,)) if name in runs), None)

    def lack(switches: tuple[bool, bool], *methods: str, maintained: bool = False) -> Lack:
        return Lack(*switches, tuple(NAMES[m] for m in methods), maintained, switches in lab.trials)

    nn, known = of(ODOMETRY, "nn"), of(ODOMETRY, "known")
    three = {m: of(ODOMETRY, m) for m in ("nn", "singles", "jcbb")}
    both = {m: (of(ODOMETRY, m), of(PEOPLE, m)) for m in ("nn", "singles")}
    pairs = tuple((a, b) for a, b in both.values() if a is not None and b is not None)
    busy = next((s for s in (PEOPLE, ODOMETRY) if of(s, "jcbb") is not None), PEOPLE)
    jcbb, other = of(busy, "jcbb"), of(busy, "nn")
    unseen = {m: of(BLIND, m) for m in ("known", "jcbb")}
    blind, pair = lab.trials.get(BLIND), maintained_pair(lab)
    truth, smoother = (None, None) if blind is None else (blind.log.truth.pose, blind.find("batch"))
    a, b = (None, None) if pair is None else (judge.look(*pair[0]), judge.look(*pair[1]))
    return Answers(
        tuple(t.log.name for t in (*lab.trials.values(), *lab.maintained.values(), *lab.primed.values())),
        tuple(r for runs in (*plain.values(), *kept.values()) for r in runs.values()),
        NearestNeighbour(nn, known, lack(ODOMETRY, "nn", "known") if nn is None or known is None else None),
        Singles(**three, lost=tuple(NAMES[m] for m, r in three.items() if r is None)),
        People(
            pairs,
            tuple(NAMES[m] for m, found in both.items() if None in found),
            None if pairs else lack(PEOPLE if ODOMETRY in lab.trials else ODOMETRY, "nn", "singles"),
        ),
        Joint(
            jcbb,
            other,
            of(busy, "singles"),
            of(busy, "known"),
            lack(busy, "jcbb", "nn") if jcbb is None or other is None else None,
        ),
        Blind(
            **unseen,
            smoother=judge.look(blind, smoother) if blind and smoother and smoother.flaw is None else None,
            motion=None if blind is None else true_against_stated(blind.log),
            reach=math.nan if truth is None else reach(truth),
            runs=tuple(plain.get(BLIND, {}).values()),
            lack=None if any(unseen.values()) else lack(BLIND, "known", "jcbb"),
        ),
        Maintenance(a, b, lack(PEOPLE, "jcbb", maintained=True) if pair is None else None),
    )


STEPS = (-3, -2, -1, 0, 1, 2, 3)  # multiples of the true step that are looked at
NEAR = 0.15  # m. A peak of the likelihood is looked for so far about each of them: readings are noisy
FLAT = 0.01  # a peak that rises less above the middle, in log-likelihood, is none
GRID = 0.005  # m, between the step lengths tried there


@dataclass(frozen=True)
class Peak:
    """The best step length [m] near a multiple of the true one: how many readings fit, and the log-likelihood."""

    step: float
    fitting: int
    likelihood: float


@dataclass(frozen=True)
class Pair:
    """Two scans, of frames `frame` - 1 and `frame`, with a true move of `true` m between: peaks at all `STEPS`."""

    frame: int
    true: float
    readings: int
    peaks: tuple[Peak, ...]

    def at(self, multiple: int) -> Peak:
        """The peak near a multiple of the true step."""
        return self.peaks[STEPS.index(multiple)]


def fit(log: Log, frame: int, steps: Array) -> tuple[Array, IntArray]:
    """Log-likelihood (K,) of a scan given the scan before, for straight moves of `steps` (K,) m, and number that fit.

    Without labels: each shows one of the points seen before, or with the same probability something else. It fits
    if one of those points is within 99 % by the noise of both.
    """
    sensor, o, start = log.recorded.sensor, log.recorded.observations, log.recorded.start
    before, now = (slice(start[k], start[k + 1]) for k in (frame - 1, frame))
    (known, P), (seen, Q) = (sensor.body_points(o.z[rows], o.R[rows]) for rows in (before, now))
    S = P[None] + Q[:, None]
    weights = np.linalg.inv(S)
    constant = -0.5 * np.linalg.slogdet(2.0 * math.pi * S)[1] - math.log(len(known))
    reach = max(float(sensor.polar(o.z[rows])[:, 0].max()) for rows in (before, now))
    elsewhere = -math.log(0.5 * (sensor.max_angle - sensor.min_angle) * reach**2)
    ahead = np.column_stack([steps, np.zeros(len(steps))])
    off = (seen[:, None] - known[None])[None] + ahead[:, None, None]
    d2 = (off[..., 0] * weights[..., 0, 0] + 2.0 * off[..., 1] * weights[..., 0, 1]) * off[..., 0]
    d2 += off[..., 1] ** 2 * weights[..., 1, 1]
    each = np.logaddexp(logsumexp(constant - 0.5 * d2, axis=2), elsewhere) - math.log(2.0)
    return each.sum(axis=1), (d2.min(axis=2) < scipy.stats.chi2.ppf(0.99, 2)).sum(axis=1)


def straight_pairs(log: Log) -> list[Pair]:
    """All pairs of scans with a straight move between, each with the likelihood of other moves."""
    truth = log.truth.pose
    assert truth is not None
    start = log.recorded.start
    found = []
    for k, move in enumerate(between(truth[:-1], truth[1:]), 1):
        readings = int(start[k + 1] - start[k])
        straight = abs(move[2]) <= TURN and abs(move[0]) >= 4.0 * NEAR  # neither where the truth is not scored
        if not straight or not readings or start[k] == start[k - 1]:
            continue
        peaks = []
        for multiple in STEPS:
            tried = multiple * move[0] + np.arange(-NEAR, NEAR + 0.5 * GRID, GRID)
            likelihood, fitting = fit(log, k, tried)
            best = int(np.argmax(likelihood))
            if likelihood[best] - likelihood[len(tried) // 2] < FLAT:
                best = len(tried) // 2
            peaks.append(Peak(float(tried[best]), int(fitting[best]), float(likelihood[best])))
        found.append(Pair(k, float(move[0]), readings, tuple(peaks)))
    return found


def prior_likelihood(stated: Increment, step: float) -> float:
    """Log of the density that a stated motion gives to a straight move [m]."""
    off = np.array([step, 0.0, 0.0]) - stated.mean
    P = stated.covariance
    return float(-0.5 * (off @ np.linalg.solve(P, off) + np.linalg.slogdet(2.0 * math.pi * P)[1]))


@dataclass(frozen=True)
class Ambiguity:
    """What two scans in a row leave open on a log without odometry."""

    log: str
    moves: int  # straight moves
    # both: of them, those that could as well have been one of the same length backwards (just as many readings fit)
    both: int
    likelier: int  # of these, backwards is even the likelier one
    pair: Pair | None  # of these the one whose two likelihoods are nearest to each other, None if there is none
    # stated: how many times as likely the log's own motion makes the true move there (NaN: it is `primed` itself)
    stated: float
    primed: str  # the log with a motion prior, blank if none was run
    prior: float  # as `stated`, by it
    posterior: tuple[float, ...]  # of each peak, its log-likelihood and the prior's

    @property
    def decides(self) -> bool:
        """Whether the log's own motion makes one of the two much likelier."""
        return not 1.0 / math.e < self.stated < math.e


def ambiguity(lab: Lab) -> Ambiguity | None:
    """What the readings alone leave open, where a log without odometry with straight moves was run."""
    primed = None if lab.primed.get(False) is None else lab.primed[False].log
    log = lab.trials[BLIND].log if BLIND in lab.trials else primed
    pairs = [] if log is None else straight_pairs(log)
    if log is None or not pairs:
        return None
    both = [p for p in pairs if p.at(-1).fitting >= p.at(1).fitting > 0]
    pair = min(both, key=lambda p: abs(p.at(-1).likelihood - p.at(1).likelihood), default=None)
    stated = prior = math.nan
    posterior: tuple[float, ...] = ()
    if pair is not None and log is not primed:
        stated = _factor(log, pair)
    if pair is not None and primed is not None:
        given = primed.recorded.increment(pair.frame)
        prior = _factor(primed, pair)
        posterior = tuple(p.likelihood + prior_likelihood(given, p.step) for p in pair.peaks)
    likelier = sum(p.at(-1).likelihood >= p.at(1).likelihood for p in both)
    name = "" if primed is None else primed.name
    return Ambiguity(log.name, len(pairs), len(both), likelier, pair, stated, name, prior, posterior)


def _factor(log: Log, pair: Pair) -> float:
    """How many times as dense the motion stated with a log is at the true move as at the one backwards."""
    stated = log.recorded.increment(pair.frame)
    ahead, back = (prior_likelihood(stated, pair.at(m).step) for m in (1, -1))
    return math.exp(ahead - back)


@dataclass(frozen=True)
class Primed:
    """Runs on a log with a motion prior, each with the same on the log without, if it reached its end there."""

    log: str
    notes: tuple[str, ...]  # the log's own
    rows: tuple[tuple[Judged, Judged | None], ...]
    # relinearized: how many times as large the filter's error is as the iterated one's with the same pairings; NaN: not
    # known, or no larger
    relinearized: float


def primed(lab: Lab, scores: Scores) -> Primed | None:
    """What a motion prior changes, where anything was run to the end on a log with one."""
    judge, trial, bare = Judge(scores), lab.primed.get(False), lab.trials.get(BLIND)
    if trial is None:
        return None
    rows = []
    for run in trial.runs:
        if run.failure is None and run.association != "none":
            without = None if bare is None else bare.find(run.estimator, run.association)
            kept = judge.look(bare, without) if bare and without and without.failure is None else None
            rows.append((judge.look(trial, run), kept))
    fine = {r.estimator: r for r, _ in rows if r.association == "known" and r.usable}
    factor = math.nan
    if {"ekf", "ekf-iterated"} <= set(fine):
        factor = fine["ekf"].rmse / fine["ekf-iterated"].rmse
    return Primed(trial.log.name, trial.log.notes, tuple(rows), factor if factor > 1.0 else math.nan) if rows else None

"""The end of a log: path and map are smoothed, and every observation is re-associated.

Online decisions do not change. Final decisions use the whole log, and `batch` smooths them.

Two landmarks of a smoothed map are one if they are at one place and hardly ever observed together. A landmark that was
initialized twice is observed as one of both or as the other. Two landmarks that are each detected with probability r
are observed together in a share r / (2 - r) of the frames in which one of them is. Online their places are too
uncertain for this test (`duplicates.py`); in the smoothed map they agree within the noise of a single observation.

The final decisions may not be less likely than those of plain `jcbb`. `jcbb` decides frame by frame in a filter of its
own, with all as stated. Its decisions are smoothed and re-associated like those in hindsight, in the same graph. The
likelihood of a set of decisions is that of all observations, clutter included, and of the odometry, at the optimum. An
observation of no landmark has the density of clutter, uniform in the field of view. A landmark with n observations has
an unknown position, which is integrated out (Laplace), and the likelihood of its detections and missed detections: a
duplicate is missed where the landmark is. Where a landmark is less likely than n observations of clutter, it counts as
these. So does one that would not stay in the map.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from association.appearance import Looks, evidence
from association.candidates import narrower
from association.expectation import SingularInnovationError, gate_threshold
from data.appearance import joined
from data.blocks import squared_norms
from data.errors import DataError
from data.inputs import Frame, FrameObservations, Increments, Inputs, IntArray, LandmarkMap, Observations, Systematic
from data.motion.systematic import sensor_frame
from data.notice import Code, Notice, notice
from data.result import DISCARD, MapState
from data.se2 import Array, BoolArray
from data.sensors import RELATIVE_POINT, Sensor
from ekf.filter import FilterDivergedError
from eval.replay.frontend import FrontEnd, PoseRecords
from eval.replay.hindsight import constants, opportunities
from eval.replay.hindsight.final_association import Reassociation, distances, nis_left, noise_share, reassociate
from eval.replay.hindsight.ledger import Record
from eval.replay.hindsight.noise import Restated, with_shares
from eval.replay.hindsight.opportunities import Detections, Kept, recounted, remaining
from eval.replay.settings import Beginning, Given, Setup
from graph.batch import end_of, smooth
from graph.factors import UnderConstrained
from graph.problem import Start


@dataclass(frozen=True)
class Smoothed:
    """Decisions after smoothing and re-association.

    sensor: without its systematic errors; pose (N, 3), known: path and map; seen: observations (M) with the noise as
    stated or estimated before the log; found: final decisions; share: variance of observations over that noise;
    motion: chi-square of prior and odometry; detections: of each landmark, by number; start: all estimates, to
    smooth again from; gated: mean and variance of NIS per degree of freedom to expect (`final_association.nis_left`).
    """

    sensor: Sensor
    pose: Array
    known: LandmarkMap
    seen: Observations
    found: Reassociation
    share: float
    motion: float
    detections: dict[int, Detections]
    start: Start
    gated: tuple[float, float]

    @cached_property
    def times(self) -> tuple[IntArray, IntArray]:
        """Numbers (n,) of the observed landmarks, and of their observations."""
        return np.unique(self.found.number[self.found.number >= 0], return_counts=True)

    @cached_property
    def kept(self) -> Kept:
        """Which of the observed landmarks (n,) stay in the map."""
        numbers, times = self.times
        rows = [np.flatnonzero(self.found.number == n)[[0, -1]] for n in numbers.tolist()]
        return remaining([self.detections[n] for n in numbers.tolist()], times, np.array(rows, np.int64).reshape(-1, 2))

    @cached_property
    def certain(self) -> tuple[IntArray, Array]:
        """Landmark (M,) of each observation, if it stays and was seen again; log-likelihood (n,) of opportunities."""
        stays = np.isin(self.found.number, self.times[0][self.kept.stays])
        number = observed_again(np.where(stays, self.found.number, DISCARD))
        return number, opportunities.evidence([self.detections[n] for n in np.unique(number[number >= 0]).tolist()])

    @property
    def consistent(self) -> bool:
        """Whether all often observed landmarks stay in the map, and few left: what bends it makes some be missed."""
        kept = self.kept
        dropped = (self.times[1] >= constants.CONFIRMED) & ~kept.stays
        return not dropped.any() and bool(kept.left.sum() <= constants.PLAIN_LEFT * kept.stays.sum())


def plain(given: Given, setup: Setup, frames: Sequence[Frame], most: int) -> tuple[IntArray, Array, LandmarkMap] | None:
    """`jcbb` over all frames of a log, in an EKF-SLAM with all as stated: landmark (M,) of every observation, path
    (N, 3) and map. None: with more than `most` landmarks. It is lost then, and takes long.
    """
    beginning = Beginning(given.prior, given.sensor, fixes=given.fixes, closures=given.closures, looks=given.looks)
    gates = Setup(gate=setup.gate, new_gate=setup.new_gate, gate_poses=setup.gate_poses)
    front, numbers, path = FrontEnd("ekf", "jcbb", beginning, gates), [np.empty(0, np.int64)], []
    for frame in frames:
        front.move(frame)
        front.use_poses(frame)
        if len(frame.observations.z):
            pairing = front.associate(frame)
            done = front.update(frame, pairing._replace(S=None))  # nobody asks how large its innovations should be
            if done.created.max(initial=-1) >= most:
                return None
            numbers.append(np.where(done.created >= 0, done.created, np.where(done.used, pairing.decisions, DISCARD)))
        front.tidy()
        path.append(front.estimator.estimate().mean)
    landmarks = front.landmarks()
    return np.concatenate(numbers), np.array(path), LandmarkMap(landmarks.number, landmarks.xy)


def observed_again(number: IntArray) -> IntArray:
    """Landmarks (M,) of observations, `DISCARD` for those of landmarks observed once."""
    times = np.bincount(number[number >= 0], minlength=1)
    return np.where((number >= 0) & (times[np.maximum(number, 0)] > 1), number, DISCARD)


def log_likelihood(s: Smoothed, share: float, view: Sensor) -> float:
    """Log-likelihood of all observations and of the odometry, up to a constant of the log. share: variance of
    observations over the noise of `seen`; view: sensor with the field of view of all observations.
    """
    clutter, (number, seen) = math.log(_clutter_density(view)), s.certain
    rows = np.flatnonzero(number >= 0)
    size = math.log(2.0 * math.pi) + 0.5 * np.linalg.slogdet(share * s.seen.R[rows])[1]
    # over clutter, and never far below: an outlier is one
    gain = -0.5 * distances(s.sensor, s.pose, s.known, s.seen, number) / share - size - clutter
    _, of, times = np.unique(number[rows], return_inverse=True, return_counts=True)
    place = np.bincount(of, size, minlength=len(times)) / times + clutter - np.log(times)
    landmarks = np.bincount(of, np.maximum(gain, 0.0), minlength=len(times)) + place + seen
    return float(np.maximum(landmarks, 0.0).sum()) - 0.5 * s.motion


def _clutter_density(view: Sensor) -> float:
    """Density of an observation that is uniform in the field of view, per unit of both coordinates."""
    angle, reach = max(view.max_angle - view.min_angle, 1e-3), max(view.max_range, 1e-3)
    return 2.0 / (angle * reach**2) if view.kind == RELATIVE_POINT else 1.0 / (angle * reach)


def renumbered(found: Reassociation, held: IntArray) -> Reassociation:
    """Decisions with the numbers (M,) of another set that names the same observations, one for each landmark. The pairs
    with most observations in common come first. A landmark without any is left out.
    """
    both = np.flatnonzero((found.number >= 0) & (held >= 0))
    pairs, times = np.unique(np.stack([found.number[both], held[both]], axis=1), axis=0, return_counts=True)
    other: dict[int, int] = {}
    for here, there in pairs[np.argsort(-times, kind="stable")].tolist():
        if here not in other and there not in other.values():
            other[here] = there
    return Reassociation(np.array([other.get(n, -1) for n in found.number.tolist()], np.int64), found.misfit)


def likelier(ours: Smoothed, theirs: Smoothed, view: Sensor) -> float:
    """Log odds of their decisions against ours, under the smaller of both noises."""
    share = max(min(ours.share, theirs.share), constants.LEAST_SCALE)
    return log_likelihood(theirs, share, view) - log_likelihood(ours, share, view)


Pairs = list[tuple[int, int]]  # landmarks to remove, each with the one that it equals


def same_landmarks(sensor: Sensor, path: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> Pairs:
    """Landmarks of a map that equal one with a lower number; each is in one pair at most, the surest pairs come first.
    The sensor's range is that in which observations (M,) of landmarks `number` (M,), -1 for none, were made.
    """
    order = np.argsort(number, kind="stable")
    numbers, begin = np.unique(number[order], return_index=True)
    rows = dict(zip(numbers.tolist(), np.split(order, begin[1:]), strict=True))
    often = [n for n in rows if n >= 0 and len(rows[n]) >= constants.WINDOW_OBSERVATIONS]
    xy, apart = known.positions(np.array(often, np.int64)), constants.SAME_PLACE * sensor.max_range
    # each with the nearest others, as pairs of rows in ascending order
    nearest = [np.argsort(np.hypot(*(xy - here).T), kind="stable")[: 1 + constants.SAME_NEAREST] for here in xy]
    near = sorted({(min(i, j), max(i, j)) for i, row in enumerate(nearest) for j in row.tolist() if i != j})
    # whether a landmark's observations, most of them, could be of something at the other's place
    tests = [(often[i], j) for pair in near for i, j in (pair, pair[::-1])]
    k = np.concatenate([rows[n] for n, _ in tests]) if tests else rows[-1][:0]
    of = np.repeat(np.arange(len(tests)), [len(rows[n]) for n, _ in tests])
    nu = sensor.residual(seen.z[k], sensor.predict(path[seen.frame[k]], xy[[j for _, j in tests]][of]))
    agree: BoolArray = medians(squared_norms(nu, seen.R[k]), of) < gate_threshold(constants.SAME_GATE)
    found = []
    for (i, j), both in zip(near, agree.reshape(-1, 2), strict=True):
        if both.all():
            a, b = often[i], often[j]
            odds = log_odds(seen.frame[rows[a]], seen.frame[rows[b]], path, apart)
            if odds > constants.SAME_ODDS:
                found.append((-odds, b, a))
    pairs: Pairs = []
    taken: set[int] = set()
    for _, away, kept in sorted(found):
        if not {away, kept} & taken:
            pairs.append((away, kept))
            taken |= {away, kept}
    return pairs


def medians(values: Array, of: IntArray) -> Array:
    """Median (n,) of each group of values (m,), whose number is of (m,), 0 to n - 1."""
    count = np.bincount(of)
    begin, ascending = np.cumsum(count) - count, values[np.lexsort((values, of))]
    return np.asarray(0.5 * (ascending[begin + (count - 1) // 2] + ascending[begin + count // 2]))


def log_odds(one: IntArray, other: IntArray, path: Array, apart: float) -> float:
    """Log odds of one landmark against two, by frames at least `apart` [m] from the one counted before."""
    r = constants.SAME_DETECTED
    alone = -math.log(1.0 - r / (2.0 - r))
    together = math.log(constants.SAME_CHANCE * (2.0 - r) / r)
    odds, place = 0.0, np.full(2, np.inf)
    both = np.intersect1d(one, other)
    for k in np.setxor1d(one, other).tolist():
        if np.hypot(*(path[k, :2] - place)) >= apart:
            odds, place = odds + alone, path[k, :2]
    return odds + together * len(both)


class Assumed(NamedTuple):
    """What the end assumes: field of view of the observations, noise, estimated odometry errors (None: none)."""

    view: Sensor
    restated: Restated
    systematic: Systematic | None


class WholeLog:
    """All frames of a log with their online poses."""

    def __init__(self, given: Given, gate: float | None) -> None:
        """`gate`: of the online decisions."""
        self.forgets = False  # whether landmarks were forgotten, so that their observations are unknown
        self.poses = PoseRecords(given.fixes, given.closures)  # which of them the mapper's filter used
        self._given, self._gate = given, gate
        self._frames: list[Frame] = []
        self._loosened: dict[int, Array] = {}
        self._path: list[Array] = []

    def move(self, frame: Frame) -> None:
        """The next frame, as stated."""
        self._frames.append(frame)

    def loosen(self, covariance: Array) -> None:
        """Add covariance (3, 3) to the motion into this frame."""
        self._loosened[len(self._frames) - 1] = covariance

    def end_frame(self, pose: Array) -> None:
        """The pose (3,) of the frame, at its end."""
        self._path.append(pose)

    def reassociate(self, records: dict[int, Record], landmarks: MapState, by: Assumed) -> Smoothed | Notice | None:
        """All observations for the recorded landmarks; a notice where the path cannot be smoothed, None without any."""
        if self.forgets or not records:
            return None
        number = _numbers(records, len(self._seen().frame))
        try:
            return self._smooth(number, np.array(self._path), LandmarkMap(landmarks.number, landmarks.xy), by)
        except (DataError, UnderConstrained) as stop:  # what a filter can use may be singular for a smoother
            return notice(Code.NO_REASSOCIATION, text=str(stop))

    def plain(self, ours: Smoothed, setup: Setup, most: int, by: Assumed) -> tuple[Smoothed, float] | None:
        """The decisions of `jcbb`, smoothed, with the numbers of recorded landmarks, and log odds, if high enough.

        They are not asked for where the map does not contradict itself: every often observed landmark stays.
        `ours`: of `reassociate`; `most`: as of `plain`.
        """
        if ours.consistent:
            return None
        try:
            found = plain(self._given, setup, self._frames, most)
            if found is None or not ((number := observed_again(found[0])) >= 0).any():
                return None
            other = self._smooth(number, *found[1:], by)
        except (DataError, UnderConstrained, FilterDivergedError, SingularInnovationError):
            return None  # it comes to no end
        odds = likelier(ours, other, by.view)
        return None if odds < constants.PLAIN_ODDS else (_renamed(other, ours), odds)

    def _smooth(self, number: IntArray, path: Array, known: LandmarkMap, by: Assumed) -> Smoothed:
        """Smooth and re-associate from a path (N, 3) and a map, with merges, while observations become likelier."""
        places = np.full((int(known.id.max()) + 1, 2), np.nan)
        places[known.id] = known.xy
        best = self._smooth_once(number, Start(path, places), by)
        for _ in range(constants.SAME_ROUNDS):
            scaled = Observations(best.seen.frame, best.seen.z, best.share * best.seen.R)
            pairs = same_landmarks(narrower(best.sensor, by.view), best.pose, best.known, scaled, best.found.number)
            looks, limit = _looks(best.seen, best.found.number), gate_threshold(constants.SAME_GATE, 1)
            pairs = [p for p in pairs if looks is None or not looks.differ(np.array(p[:1]), np.array(p[1:]), limit)]
            if not pairs:
                break
            found, to = best.found.number, np.arange(len(places))
            to[[away for away, _ in pairs]] = [kept for _, kept in pairs]
            number = np.where(found >= 0, to[np.maximum(found, 0)], DISCARD)
            try:
                merged = self._smooth_once(number, best.start, by)
            except UnderConstrained:  # no minimum was reached
                break
            if likelier(best, merged, by.view) <= 0.0:
                break
            best = merged
        return best

    def _smooth_once(self, number: IntArray, start: Start, by: Assumed) -> Smoothed:
        """Smooth and re-associate, with the landmarks as they are."""
        log = self._inputs(by)
        out = ~np.concatenate([self.poses.fixes.used, self.poses.closures.used])
        none = np.full(len(number), -1)
        found = smooth(log, number, none, start, rejected=out, with_shares=True, enough=constants.SMOOTHED)
        assert found.map is not None
        assert found.residual_share is not None
        again = end_of(found, start.landmark, None)
        pose, xy, sensor = found.trajectory.pose, found.map.xy, by.restated.widened(log.sensor)
        if by.systematic is not None and found.systematic is not None:
            frame = sensor_frame(by.systematic, log.sensor, log.prior)
            xy = frame.points_in(xy, found.systematic.mean[-1])[0]
            pose, sensor = frame.poses_in(pose, found.systematic.mean), frame.sensor(sensor)
        known, seen = LandmarkMap(found.map.number, xy), log.observations
        share = noise_share(sensor, pose, known, seen, number)
        motion = max(found.cost - float(distances(sensor, pose, known, seen, number).sum()), 0.0)
        # tails are paired, too: those of a noise that was stated too large are no clutter
        wide, view = max(share, 1.0), narrower(sensor, by.view)
        scaled = Observations(seen.frame, seen.z, wide * seen.R, appearance=seen.appearance)
        paired = reassociate(sensor, pose, known, scaled, _looks(seen, number), share / wide)
        looks = recounted(view, pose, known, scaled, paired.number)
        chances = _chances(view, pose, known, scaled, paired.number)
        detections = {n: Detections(each, chances[n]) for n, each in looks.items()}
        gated = nis_left(found.residual_share, number, found.dof, self._gate, evidence(seen.appearance))
        return Smoothed(sensor, pose, known, seen, paired, share, motion, detections, again, gated)

    def settled(self, records: dict[int, Record]) -> tuple[IntArray, FrameObservations, IntArray]:
        """Frames (m,), observations, and landmarks (m,), where the recorded ones are final."""
        seen = self._seen()
        return seen.frame, FrameObservations(seen.z, seen.R), _numbers(records, len(seen.frame))

    def _seen(self) -> Observations:
        each = [f.observations for f in self._frames]
        of = np.repeat(np.arange(len(each)), [len(s.z) for s in each])
        looks = [f.appearance for f in self._frames if f.appearance is not None]
        return Observations(
            of, np.concatenate([s.z for s in each]), np.concatenate([s.R for s in each]),
            appearance=joined(looks) if looks else None,
        )  # fmt: skip

    def _inputs(self, by: Assumed) -> Inputs:
        n, seen = len(self._frames), self._seen()
        mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
        for k, frame in enumerate(self._frames[1:], 1):
            assert frame.increment is not None
            mean[k], covariance[k] = frame.increment.mean, by.restated.shares.motion * frame.increment.covariance
            covariance[k] += self._loosened.get(k, 0.0)
        R = with_shares(self._given.sensor, FrameObservations(seen.z, seen.R), by.restated.shares).R
        return Inputs(
            self._given.prior, np.arange(n, dtype=float), Increments(mean, covariance),
            Observations(seen.frame, seen.z, R, appearance=seen.appearance), self._given.sensor,
            systematic=by.systematic, fixes=self._given.fixes, closures=self._given.closures,
        )  # fmt: skip


def _chances(view: Sensor, pose: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> dict[int, float]:
    """Detection probability of each landmark after it has vanished, by clutter and neighbours in its gate."""
    single = np.bincount(number[number >= 0], minlength=1) == 1
    gate = math.pi * gate_threshold(constants.REASSOCIATION_GATE) * np.median(np.sqrt(np.linalg.det(seen.R)))
    clutter = gate * _clutter_density(view) * ((number < 0).sum() + single.sum()) / len(np.unique(seen.frame))
    rows, confused = np.flatnonzero(known.rows(number) >= 0), np.zeros(len(known.id))
    if len(known.id) > 1 and len(rows):
        closest = np.empty_like(known.xy)
        for i, xy in enumerate(known.xy):
            distance = np.hypot(*(known.xy - xy).T)
            distance[i] = math.inf
            closest[i] = known.xy[distance.argmin()]
        observed, of = np.unique(known.rows(number[rows]), return_inverse=True)
        own, other = (view.predict(pose[seen.frame[rows]], at[observed[of]]) for at in (known.xy, closest))
        apart = medians(squared_norms(view.residual(own, other), seen.R[rows]), of)
        confused[observed] = scipy.special.ndtr(-0.5 * np.sqrt(apart))
    chance = np.clip(clutter + confused, constants.CHANCE_LEAST, constants.CHANCE_MOST)
    return dict(zip(known.id.tolist(), chance.tolist(), strict=True))


def _renamed(s: Smoothed, like: Smoothed) -> Smoothed:
    """With the landmarks' numbers of another one; those without are no part of the map."""
    named = renumbered(s.found, like.found.number)
    both = np.flatnonzero(named.number >= 0)
    number, first = np.unique(named.number[both], return_index=True)
    former = s.found.number[both[first]]
    looks = {n: s.detections[old] for n, old in zip(number.tolist(), former.tolist(), strict=True)}
    return replace(s, known=LandmarkMap(number, s.known.positions(former)), found=named, detections=looks)


def _looks(seen: Observations, number: IntArray) -> Looks | None:
    """What landmarks look like, by the number (m,) of each observation; None: observations have no appearance."""
    if seen.appearance is None:
        return None
    looks = Looks()
    looks.see(number, seen.appearance)
    return looks


def _numbers(records: dict[int, Record], observations: int) -> IntArray:
    """Landmark (m,) of each observation, `DISCARD` for none."""
    number = np.full(observations, DISCARD, np.int64)
    for n, record in records.items():
        number[[row for row, _ in record.observations]] = n
    return number

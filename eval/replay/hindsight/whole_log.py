"""The end of a log: path and map are smoothed, and every observation is re-associated.

Online decisions do not change. Final decisions use the whole log, and `batch` smooths them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from association.appearance import Looks, evidence
from association.candidates import narrower
from association.expectation import SingularInnovationError, gate_threshold
from data.appearance import joined
from data.errors import DataError
from data.inputs import Frame, FrameObservations, Increments, Inputs, IntArray, LandmarkMap, Observations, Systematic
from data.motion.systematic import sensor_frame
from data.notice import Code, Notice, notice
from data.result import DISCARD, MapState
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import FilterDivergedError
from eval.replay.hindsight import constants
from eval.replay.hindsight.final_association import nis_left, noise_share, reassociate, squares
from eval.replay.hindsight.floor import Smoothed, likelier, observed_again, plain, renumbered
from eval.replay.hindsight.noise import Restated, with_shares
from eval.replay.hindsight.opportunities import recounted
from eval.replay.hindsight.record import Record
from eval.replay.hindsight.same_place import same_landmarks
from eval.replay.poses import PoseRecords
from eval.replay.settings import Given, Setup
from graph.batch import Rejected, Start, smooth
from graph.factors import UnderConstrained


class Assumed(NamedTuple):
    """What the end assumes: the sensor with the field of view in which observations were made, the noise, and odometry
    errors that are estimated (None: none).
    """

    view: Sensor
    restated: Restated
    systematic: Systematic | None


class Likelier(NamedTuple):
    """The decisions of `jcbb`, smoothed, with the numbers of recorded landmarks, and their log odds against others."""

    smoothed: Smoothed
    odds: float


class WholeLog:
    """All frames of a log with their online poses."""

    def __init__(self, given: Given, gate: float | None) -> None:
        """`gate`: of the online decisions."""
        self.managed = False  # landmarks left the map by rules of the setup, so their observations are unknown
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
        if self.managed or not records:
            return None
        number = _numbers(records, len(self._seen().frame))
        try:
            return self._smooth(number, np.array(self._path), LandmarkMap(landmarks.number, landmarks.xy), by)
        except (DataError, UnderConstrained) as stop:  # what a filter can use may be singular for a smoother
            return notice(Code.NO_REASSOCIATION, text=str(stop))

    def plain(self, ours: Smoothed, setup: Setup, most: int, by: Assumed) -> Likelier | None:
        """The decisions of `jcbb` with the numbers of recorded landmarks, None where there are none to be compared.

        They are not asked for where the map does not contradict itself: every often observed landmark stays.
        `ours`: of `reassociate`; `most`: as of `floor.plain`.
        """
        if ours.consistent:
            return None
        try:
            found = plain(self._given, setup, self._frames, most)
            if found is None or not ((number := observed_again(found.number)) >= 0).any():
                return None
            other = self._smooth(number, found.path, found.known, by)
        except (DataError, UnderConstrained, FilterDivergedError, SingularInnovationError):
            return None  # it comes to no end
        theirs = other.kept.left.sum()
        if theirs > max(ours.kept.left.sum(), constants.PLAIN_LEFT * other.kept.stays.sum()):  # no world explains it
            return None
        odds = likelier(ours, other, by.view)
        return None if odds < constants.PLAIN_ODDS else Likelier(_renamed(other, ours), odds)

    def _smooth(self, number: IntArray, path: Array, known: LandmarkMap, by: Assumed) -> Smoothed:
        """Smooth observations of the landmarks (M,), from a path (N, 3) and a map, and re-associate them all.

        Landmarks that are one are merged then, and all is smoothed again, while this makes the observations likelier.
        """
        places = np.full((int(known.id.max()) + 1, 2), np.nan)
        places[known.id] = known.xy
        best = self._smooth_once(number, Start(path, places), by)
        for _ in range(constants.SAME_ROUNDS):
            scaled = Observations(best.seen.frame, best.seen.z, best.share * best.seen.R)
            view = narrower(best.sensor, by.view)
            pairs = same_landmarks(view, best.pose, best.known, scaled, best.found.number)
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
        out = Rejected(self.poses.fixes.rejected, self.poses.closures.rejected)
        found = smooth(log, number, np.full(len(number), -1), start, rejected=out, with_shares=True)
        assert found.map is not None
        assert found.residual_share is not None
        places = start.landmark.copy()
        places[found.map.number] = found.map.xy
        again = Start(found.trajectory.pose, places, None if found.systematic is None else found.systematic.mean)
        pose, xy, sensor = found.trajectory.pose, found.map.xy, by.restated.widened(log.sensor)
        if by.systematic is not None and found.systematic is not None:
            frame = sensor_frame(by.systematic, log.sensor, log.prior)
            xy = frame.points_in(xy, found.systematic.mean[-1])[0]
            pose, sensor = frame.poses_in(pose, found.systematic.mean), frame.sensor(sensor)
        known, seen = LandmarkMap(found.map.number, xy), log.observations
        share = noise_share(sensor, pose, known, seen, number)
        motion = max(found.cost - squares(sensor, pose, known, seen, number), 0.0)
        scaled = Observations(seen.frame, seen.z, share * seen.R, appearance=seen.appearance)
        paired = reassociate(sensor, pose, known, scaled, _looks(seen, number))
        looks = recounted(narrower(sensor, by.view), pose, known, scaled, paired.number)
        gated = nis_left(found.residual_share, number, found.dof, self._gate, evidence(seen.appearance))
        return Smoothed(sensor, pose, known, seen, paired, share, motion, looks, again, gated)

    def frame_of(self, row: int) -> int:
        """The frame of an observation."""
        return int(self._seen().frame[row])

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


def _renamed(s: Smoothed, like: Smoothed) -> Smoothed:
    """With the landmarks' numbers of another one; those without are no part of the map."""
    named = renumbered(s.found, like.found.number)
    both = np.flatnonzero(named.number >= 0)
    number, first = np.unique(named.number[both], return_index=True)
    former = s.found.number[both[first]]
    looks = {n: s.opportunities[old] for n, old in zip(number.tolist(), former.tolist(), strict=True)}
    return s._replace(known=LandmarkMap(number, s.known.positions(former)), found=named, opportunities=looks)


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

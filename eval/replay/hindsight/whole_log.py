"""The end of a log: path and map are smoothed, and every reading is paired anew with what comes out.

Online decisions stay what they were; they are what the estimators of a comparison got. Final ones are made with what
the whole log tells, and so `batch` smooths better ones.
"""

from __future__ import annotations

import numpy as np

from association.anew import Anew, noise_share, pair_anew
from association.evidence.differences import with_shares
from data.inputs import Frame, Increments, Inputs, IntArray, LandmarkMap, Observations, Sightings, Systematic
from data.motion.sensor_frame import sensor_frame
from data.result import DISCARD, MapState
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.given import Given
from eval.replay.hindsight.record import Record
from eval.replay.hindsight.restated import Restated
from graph.batch import Start, smooth
from graph.factors import UnderConstrained


class WholeLog:
    """All frames of a log, and where each was taken, as was thought then.

    Attributes:
        managed: landmarks left the map by rules of the setup: what was read of them is no longer known.
        why: why nothing was paired anew, if nothing was.
    """

    def __init__(self, given: Given) -> None:
        """Before the first frame."""
        self.managed, self.why = False, ""
        self._given = given
        self._frames: list[Frame] = []
        self._doubt: dict[int, Array] = {}
        self._path: list[Array] = []

    def move(self, frame: Frame) -> None:
        """The next frame comes, as it is stated."""
        self._frames.append(frame)

    def doubt(self, covariance: Array) -> None:
        """The motion into this frame turned out to be unknown: (3, 3) more of it."""
        self._doubt[len(self._frames) - 1] = covariance

    def end_frame(self, pose: Array) -> None:
        """Where (3,) it was taken, by all that is known at its end."""
        self._path.append(pose)

    def pair_anew(
        self, records: dict[int, Record], landmarks: MapState, restated: Restated, systematic: Systematic | None
    ) -> Anew | None:
        """All readings of the log for the landmarks that there are records of; None where the path cannot be smoothed.

        Noise as `restated`; `systematic`: errors of odometry that are believed in.
        """
        log, rows = self._inputs(restated, systematic), [(row, n) for n, r in records.items() for row, _ in r.sightings]
        if self.managed or not rows:
            return None
        number = np.full(len(log.observations.frame), DISCARD)
        number[[row for row, _ in rows]] = [n for _, n in rows]
        places = np.full((int(landmarks.number.max()) + 1, 2), np.nan)
        places[landmarks.number] = landmarks.xy
        try:
            found = smooth(log, number, np.full(len(number), -1), Start(np.array(self._path), places))
        except UnderConstrained as stop:
            self.why = f"nothing was paired anew at the end: {stop}"
            return None
        assert found.map is not None
        pose, xy, sensor = found.trajectory.pose, found.map.xy, restated.widened(log.sensor)
        if systematic is not None and found.systematic is not None:
            frame = sensor_frame(systematic, log.sensor, log.prior)
            xy = frame.points_in(xy, found.systematic.mean[-1])[0]
            pose, sensor = frame.poses_in(pose, found.systematic.mean), frame.sensor(sensor)
        return _paired(sensor, pose, LandmarkMap(found.map.number, xy), log.observations, number)

    def _inputs(self, restated: Restated, systematic: Systematic | None) -> Inputs:
        first, rest = self._frames[0], self._frames[1:]
        n = len(self._frames)
        mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
        for k, frame in enumerate(rest, 1):
            assert frame.increment is not None
            mean[k], covariance[k] = frame.increment.mean, restated.shares.motion * frame.increment.covariance
            covariance[k] += self._doubt.get(k, 0.0)
        of = np.repeat(np.arange(n), [len(f.sightings.z) for f in self._frames])
        z = np.concatenate([first.sightings.z, *(f.sightings.z for f in rest)])
        R = np.concatenate([first.sightings.R, *(f.sightings.R for f in rest)])
        R = with_shares(self._given.sensor, Sightings(z, R), restated.shares).R
        return Inputs(
            self._given.prior, np.arange(n, dtype=float), Increments(mean, covariance), Observations(of, z, R),
            self._given.sensor, systematic=systematic,
        )  # fmt: skip


def _paired(sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> Anew:
    share = noise_share(sensor, pose, known, seen, number)
    return pair_anew(sensor, pose, known, Observations(seen.frame, seen.z, share * seen.R))

"""A floor for the end of a log: the final decisions may not be less likely than those of plain `jcbb`.

`jcbb` decides frame by frame in a filter of its own, with all as stated. Its decisions are smoothed and re-associated
like those in hindsight, in the same graph. The likelihood of a set of decisions is that of all observations, clutter
included, and of the odometry, at the optimum. An observation of no landmark has the density of clutter, uniform in the
field of view. A landmark with n observations has an unknown position, which is integrated out (Laplace), and the
likelihood of its detections and missed detections: a duplicate is missed where the landmark is. Where a landmark is
less likely than n observations of clutter, it counts as these. So does one that would not stay in the map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from association.appearance import Looks
from association.decide import decide
from data.inputs import Frame, IntArray, LandmarkMap, Observations
from data.result import DISCARD
from data.se2 import Array
from data.sensors import RELATIVE_POINT, Sensor
from ekf.slam import EkfSlam
from eval.replay.hindsight import constants
from eval.replay.hindsight.final_association import Reassociation
from eval.replay.hindsight.persistence import Kept, evidence, kept_at_end
from eval.replay.poses import PoseMeasurements
from eval.replay.settings import Given, Setup
from graph.batch import Start


class Plain(NamedTuple):
    """Landmark (M,) of every observation by `jcbb`, path (N, 3) and map."""

    number: IntArray
    path: Array
    known: LandmarkMap


class Smoothed(NamedTuple):
    """Decisions after smoothing and re-association.

    sensor: without its systematic errors; pose (N, 3), known: path and map; seen: observations (M) with the noise as
    stated or estimated before the log; found: final decisions; share: variance of observations over that noise;
    motion: chi-square of prior and odometry; opportunities: of each landmark, by number; start: all estimates, to
    smooth again from; gated: mean and variance of NIS per degree of freedom to expect (`final_association.nis_left`).
    """

    sensor: Sensor
    pose: Array
    known: LandmarkMap
    seen: Observations
    found: Reassociation
    share: float
    motion: float
    opportunities: dict[int, bytes]
    start: Start
    gated: tuple[float, float]

    @property
    def times(self) -> tuple[IntArray, IntArray]:
        """Numbers (n,) of the observed landmarks, and of their observations."""
        return np.unique(self.found.number[self.found.number >= 0], return_counts=True)

    @property
    def kept(self) -> Kept:
        """Which of the observed landmarks (n,) stay in the map."""
        numbers, times = self.times
        rows = [np.flatnonzero(self.found.number == n)[[0, -1]] for n in numbers.tolist()]
        spans = np.array(rows, np.int64).reshape(-1, 2)
        return kept_at_end([self.opportunities[n] for n in numbers.tolist()], times, spans)

    @property
    def consistent(self) -> bool:
        """Whether all often observed landmarks stay in the map: what bends it makes some be missed."""
        return not ((self.times[1] >= constants.CONFIRMED) & ~self.kept.stays).any()


def plain(given: Given, setup: Setup, frames: Sequence[Frame], most: int) -> Plain | None:
    """`jcbb` over all frames of a log, in an EKF-SLAM with all as stated; None: with more than `most` landmarks.

    It is lost then, and takes long.
    """
    held, looks = EkfSlam(given.prior, given.sensor), Looks()
    poses = PoseMeasurements(given, held, held, setup.gate_poses)
    numbers, path = [], []
    for frame in frames:
        if frame.increment is not None:
            held.predict(frame.increment)
        poses.use(frame)
        if len(frame.observations.z):
            e, seen = held.expect(frame.observations), frame.appearance
            if seen is not None:
                e = e.with_appearance(looks.unlike(e.number, seen))
            decisions = decide("jcbb", e, setup.gate, setup.new_gate).decisions
            done = held.update(frame.observations, decisions)
            if done.created.max(initial=-1) >= most:
                return None
            numbers.append(np.where(done.created >= 0, done.created, np.where(done.used, decisions, DISCARD)))
            if seen is not None:
                looks.see(numbers[-1], seen)
        path.append(held.estimate().mean)
    number = np.concatenate([np.empty(0, np.int64), *numbers])
    landmarks = held.landmarks()
    return Plain(number, np.array(path), LandmarkMap(landmarks.number, landmarks.xy))


def observed_again(number: IntArray) -> IntArray:
    """Landmarks (M,) of observations, `DISCARD` for those of landmarks observed once."""
    times = np.bincount(number[number >= 0], minlength=1)
    return np.where((number >= 0) & (times[np.maximum(number, 0)] > 1), number, DISCARD)


def log_likelihood(s: Smoothed, share: float, view: Sensor) -> float:
    """Log-likelihood of all observations and of the odometry, up to a constant of the log.

    share: variance of observations over the noise of `seen`; view: sensor with the field of view of all observations.
    """
    clutter, kept = math.log(_clutter_density(view)), s.times[0][s.kept.stays]
    number = observed_again(np.where(np.isin(s.found.number, kept), s.found.number, DISCARD))
    rows = np.flatnonzero(number >= 0)
    R = share * s.seen.R[rows]
    z_hat = s.sensor.predict(s.pose[s.seen.frame[rows]], s.known.positions(number[rows]))
    nu = s.sensor.residual(s.seen.z[rows], z_hat)
    size = math.log(2.0 * math.pi) + 0.5 * np.linalg.slogdet(R)[1]
    # over clutter, and never far below: an outlier is one
    gain = -0.5 * (nu * np.linalg.solve(R, nu[..., None])[..., 0]).sum(axis=1) - size - clutter
    numbers, of, times = np.unique(number[rows], return_inverse=True, return_counts=True)
    seen = evidence([s.opportunities[n] for n in numbers.tolist()])
    place = np.bincount(of, size, minlength=len(times)) / times + clutter - np.log(times)
    landmarks = np.bincount(of, np.maximum(gain, 0.0), minlength=len(times)) + place + seen
    return float(np.maximum(landmarks, 0.0).sum()) - 0.5 * s.motion


def _clutter_density(view: Sensor) -> float:
    """Density of an observation that is uniform in the field of view, per unit of both coordinates."""
    angle, reach = max(view.max_angle - view.min_angle, 1e-3), max(view.max_range, 1e-3)
    return 2.0 / (angle * reach**2) if view.kind == RELATIVE_POINT else 1.0 / (angle * reach)


def renumbered(found: Reassociation, held: IntArray) -> Reassociation:
    """Decisions with the numbers (M,) of another set that names the same observations, one for each landmark.

    The pairs with most observations in common come first. A landmark without any is left out.
    """
    both = np.flatnonzero((found.number >= 0) & (held >= 0))
    pairs, times = np.unique(np.stack([found.number[both], held[both]], axis=1), axis=0, return_counts=True)
    other: dict[int, int] = {}
    taken: set[int] = set()
    for here, there in pairs[np.argsort(-times, kind="stable")].tolist():
        if here not in other and there not in taken:
            other[here] = there
            taken.add(there)
    to = np.full(int(found.number.max(initial=-1)) + 1, -1, np.int64)
    to[list(other)] = list(other.values())
    number = np.where(found.number >= 0, to[np.maximum(found.number, 0)] if len(to) else -1, -1)
    return Reassociation(number, found.alone & (number >= 0))


def likelier(ours: Smoothed, theirs: Smoothed, view: Sensor) -> float:
    """Log odds of their decisions against ours, under the smaller of both noises."""
    share = max(min(ours.share, theirs.share), constants.LEAST_SCALE)
    return log_likelihood(theirs, share, view) - log_likelihood(ours, share, view)

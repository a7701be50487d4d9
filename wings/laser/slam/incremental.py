"""Graph SLAM by scan matching, frame by frame: the front end of a laser log, and of a robot that drives.

Its odometry matches each scan against the last key scans, with the wheels' odometry as a robust prior. The wheels'
error has two modes: noise, and rare slips (or a robot that backs while its odometry says forward), which may be large
per metre and per second. Their mixture is replaced by the likelier mode (E. Olson, P. Agarwal, "Inference on networks
of mixtures for robust robot mapping", IJRR 32, 2013, max-mixtures).
"""

import math
from typing import NamedTuple

import numpy as np

from data.inputs import Increment, IntArray, Prior, Scanner
from data.se2 import Array, between, compose, pose_error, wrap_angle
from wings.laser.pose_graph import PoseGraph
from wings.laser.scans.matching import FIXED, Match, MotionPrior, NearestGrid, Pyramid, best_pose, match, pyramid
from wings.laser.scans.points import FEWEST_BEAMS, Points, beams_of, joined, scan_points
from wings.laser.scans.uncertainty import compose_covariances
from wings.laser.slam.closures import LoopCloser
from wings.laser.slam.parameters import LaserParameters

OTHER_START = np.array([0.03, 0.03, 0.01])
"""m, m, rad: a prediction by the last motion that differs from odometry by more is a second start."""
MOST_SIGMAS = 3.0  # of a slip, up to which poses are starts
SURPRISE = 25.0
"""Chi-square (3 dof) from which a match contradicts odometry: the wheels slipped, or the scan was matched to the wrong
surface. A match that keeps to odometry is then tried, too."""
FIRM = 1e3  # scale of a prior that does not yield, in standard deviations
UNUSUAL = 0.1  # of cost above that of the scan before: from then on a match is searched for around odometry
SEARCHED, FARTHEST = 90, 10.0  # points of a search, and their distance [m]
LEAST_CORRELATION = 0.4  # score of a search
WIDEST = np.array([2.0, 2.0, 0.5 * math.pi])  # m, m, rad of a search to either side
FEWEST_POINTS, SURE = 50, 0.7  # points of a scan, and share that fits, of a match that contradicts odometry
POINTS = 150  # Points of a scan that are evidence, at most: neighbouring beams have one surface in common


TURNED_WAY = 0.25  # m per rad: the way of a wheel in a turn
PER_METRE = np.array([1.0, 1.0, 0.5])  # m, m, rad per metre of the wheels: backing instead of forward is two sigma
PER_RADIAN = np.array([0.0, 0.0, 0.5])  # and per radian of their turn
PER_SECOND = np.array([0.3, 0.3, 0.5])  # pushed, or sliding, with wheels at rest
LONGEST = 2.0  # s: in a longer time between two scans nothing more is expected
LEAST = np.array([0.02, 0.02, 0.02])  # m, m, rad
RARE = 15.0
"""Log odds of noise against a slip, before the data. It is the fit of a tenth of the points, which a moving door or
people can have."""
NARROW, NARROW_GATE = 0.5 * math.pi, 7.81
"""rad of a view, which a wall or a person can fill: matched at key poses alone, and not against odometry, to a
chi-square of 95 % (3 dof). People before a depth camera carry a path 1.8 m away otherwise, 0.03 m with it."""
AGAIN, STEADY = 3.0, 0.2  # Log odds of noise against a slip that goes on, and its sigma as a share of a slip's


class Travel(NamedTuple):
    """What the wheels report between two scans: distance [m], turn [rad], both summed, and the time [s]."""

    distance: float = 0.0
    turn: float = 0.0
    seconds: float = 0.0

    def plus(self, motion: Array, seconds: float) -> "Travel":
        """With one more motion (3,)."""
        distance, turn = math.hypot(motion[0], motion[1]), abs(float(motion[2]))
        return Travel(self.distance + distance, self.turn + turn, self.seconds + seconds)

    @property
    def way(self) -> float:
        """Of a wheel [m]."""
        return self.distance + TURNED_WAY * self.turn


def repeated(motion: Array, then: Travel, now: Travel) -> Array | None:
    """The last motion (3,) at the same rate: per metre of the wheels, or per second where they stand still."""
    if then.way > 0.0 and now.way > 0.0:
        return motion * (now.way / then.way)
    return motion * (now.seconds / then.seconds) if then.seconds > 0.0 and now.seconds > 0.0 else None


class Tracker:
    """The robot's pose relative to the newest key pose, frame by frame."""

    def __init__(self, parameters: LaserParameters, sigma: float, *, steady: bool = False) -> None:
        """`steady`: odometry is unknown, and the last motion goes on, with the covariances of `predict`."""
        self.parameters, self.steady, self.narrow = parameters, steady, False
        self.sigma = parameters.distance_sigma(sigma)
        self.pose, self.covariance = np.zeros(3), np.zeros((3, 3))
        self.surprise = 0.0  # chi-square (3 dof) of the last match against odometry
        self.loose = False  # whether the frame's scan does not fix a direction, as along bare walls, or does not fit
        self._grid = NearestGrid(parameters.max_range + 2.0)
        self._keys: list[Points] = []
        self._matched = np.zeros(3)
        self._motion = np.zeros(3)
        self._travelled = self._travel = Travel()
        self._cost = 0.0
        self._slipped = False
        self._pyramid: Pyramid | None = None

    def predict(self, motion: Array, covariance: Array, seconds: float = 0.0) -> None:
        """Add the odometry of one frame; `seconds` since the frame before, 0 where unknown."""
        self.covariance = compose_covariances(self.pose, self.covariance, motion, covariance)
        self.pose = compose(self.pose, motion)
        self.pose[2] = wrap_angle(float(self.pose[2]))
        self._travel = self._travel.plus(motion, seconds)
        self.loose = False

    def correct(self, points: Points) -> bool:
        """Match the frame's scan; returns False if it does not fit and the prediction is kept. Of the matches from
        several starts the one is kept whose cost and contradiction of odometry are least.
        """
        self.surprise, self.loose = 0.0, len(self._keys) > 0
        if not self._keys or len(points.xy) == 0:
            return False
        again = repeated(self._motion, self._travelled, self._travel)
        if self.steady and again is not None:
            self.pose = compose(self._matched, again)
            self.pose[2] = wrap_angle(float(self.pose[2]))
        prior = MotionPrior(self.pose, np.asarray(np.linalg.inv(self.covariance + 1e-10 * np.eye(3)), float))
        if self.narrow:
            best = self._match(points, self.pose, prior, FIRM)
            fits = best.share >= self.parameters.loop_share and self._chi2(best, prior) < NARROW_GATE
            if fits:
                self.pose, self.covariance = best.pose, best.covariance
                self.loose = best.least < FIXED
            return fits
        way = self._travel  # slip: standard deviation (3,) [m, m, rad] of odometry's error if the wheels slip
        slip = LEAST + PER_METRE * way.distance + PER_RADIAN * way.turn + PER_SECOND * min(way.seconds, LONGEST)
        slip = np.maximum(slip, np.sqrt(np.diag(self.covariance)))
        tried = [self._match(points, self.pose, prior)]
        going_on = None
        if again is not None and not self.steady:
            start = compose(self._matched, again)
            apart = pose_error(start, self.pose)
            if (np.abs(apart) > OTHER_START).any() and (np.abs(apart) <= MOST_SIGMAS * slip).all():
                tried.append(self._match(points, start, prior))
                going_on = start if self._slipped else None
        if self.steady or min(m.cost for m in tried) > self._cost + UNUSUAL:
            tried += self._searched(points, slip, self.pose, prior)
        if self.steady and max(m.share for m in tried) < SURE:  # carried, or scans are missing
            slip = np.maximum(slip, WIDEST / MOST_SIGMAS)
            tried += self._searched(points, slip, self._matched, prior)
        if any(self._chi2(m, prior) > SURPRISE for m in tried):
            held = self._match(points, self.pose, prior, FIRM)
            plenty = len(points.xy) >= FEWEST_POINTS  # where little is seen, or the reference ends, a few fit anywhere
            tried = [*(m for m in tried if self._chi2(m, prior) <= SURPRISE or (plenty and m.share >= SURE)), held]
        evidence = min(len(points.xy), POINTS)
        best = min(tried, key=lambda m: evidence * m.cost + self._penalty(m, prior, slip, going_on))
        if best.share < self.parameters.least_share:
            return False
        self.surprise = self._chi2(best, prior)
        self._slipped = self.surprise > SURPRISE
        self._motion = between(self._matched, best.pose)
        self.pose, self.covariance, self.loose = best.pose, best.covariance, best.least < FIXED
        self._matched, self._cost = best.pose, best.cost
        self._travelled, self._travel = self._travel, Travel()
        return True

    def _match(self, points: Points, start: Array, prior: MotionPrior, scale: float | None = None) -> Match:
        """Without odometry what little crosses the walls is all that tells the way along them."""
        least, scale = 0.0 if self.steady else FIXED, scale or self.parameters.prior_scale
        return match(points, self._reference, start, prior, self.sigma, scale, least)

    def _chi2(self, found: Match, prior: MotionPrior) -> float:
        error = pose_error(found.pose, prior.mean)
        return float(error @ prior.information @ error)

    def _penalty(self, found: Match, prior: MotionPrior, slip: Array, going_on: Array | None) -> float:
        """Negative log likelihood of a match: by odometry, or as a slip with sigmas (3,) from the last motion."""
        error = pose_error(found.pose, prior.mean)
        penalty = min(0.5 * self._chi2(found, prior), RARE + 0.5 * float(((error / slip) ** 2).sum()))
        if going_on is not None:
            further = pose_error(found.pose, going_on)
            penalty = min(penalty, AGAIN + 0.5 * float(((further / (STEADY * slip)) ** 2).sum()))
        return penalty

    def _searched(self, points: Points, slip: Array, about: Array, prior: MotionPrior) -> list[Match]:
        """A match from the pose about another, as far as the wheels may slip, where the scan fits best; or none."""
        window = np.minimum(MOST_SIGMAS * slip, WIDEST)
        if self._pyramid is None:
            self._pyramid = pyramid(self._reference.xy, FARTHEST + 2.0)
        near = points.xy[np.hypot(points.xy[:, 0], points.xy[:, 1]) < FARTHEST]
        some = near[:: max(len(near) // SEARCHED, 1)]
        pose, score = best_pose(some, self._pyramid, about, window, LEAST_CORRELATION)
        return [self._match(points, pose, prior)] if score > 0.0 else []

    @property
    def is_due(self) -> bool:
        """Whether the next key pose is due: the newest one is far, or nothing has been seen yet."""
        p = self.parameters
        if not any(len(k.xy) for k in self._keys):
            return True
        far = math.hypot(self.pose[0], self.pose[1]) >= p.keyframe_distance
        return far or abs(float(self.pose[2])) >= p.keyframe_angle

    def make_key(self, points: Points) -> None:
        """Make the current pose the key pose; its scan joins the reference."""
        back = between(self.pose, np.zeros(3))
        self._keys = [*(k.seen_from(back) for k in self._keys), points][-self.parameters.window :]
        self._reference = self._grid.reference(*joined(self._keys))
        self._pyramid = None
        self._matched = between(self.pose, self._matched)
        self.pose, self.covariance = np.zeros(3), np.zeros((3, 3))


LARGE, AMORTIZED = 1500, 300
"""Key poses from which on loop closures wait for others, and how many more make them wait for one more key pose."""
FAR = np.array([0.1, 0.1, 0.03])  # m, m, rad: loop closures that disagree so much with the estimate do not wait


class ScanSlam:
    """The robot's pose, key poses and loop closures after each frame."""

    def __init__(
        self, prior: Prior, scanner: Scanner, beams: int, parameters: LaserParameters, *, steady: bool = False,
        with_covariance: bool = False,
    ) -> None:  # fmt: skip
        """`steady`: odometry is unknown (`Tracker`). `with_covariance`: `covariance` is asked for."""
        self.parameters, self.scanner = parameters, scanner
        self.frames: list[int] = []  # of the key poses so far
        self.motions: list[Array] = []  # (3,), (3, 3) of each key pose in the frame before; of the first unused
        self.covariances: list[Array] = []
        self.poses = np.zeros((0, 3))  # of all key poses, world frame
        self.closer = LoopCloser(parameters, scanner)  # with all loop closures
        self.tracker = Tracker(parameters, scanner.sigma, steady=steady)
        self._prior, self._graph = prior, PoseGraph(prior)
        self._beams, self._nothing = beams_of(scanner, beams), np.zeros(beams)
        self.seen_by(np.arange(beams))
        self.waits, self._far, self._updated, self._count = False, False, 0, 0
        self._covariance = prior.covariance if with_covariance else None

    def seen_by(self, beams: IntArray) -> None:
        """The beams (B,) that ever return, ascending: whether their scans are matched, and how."""
        self.matched = len(beams) >= FEWEST_BEAMS
        view = abs(self.scanner.angle_step) * float(np.ptp(beams) + 1) if len(beams) else 0.0
        self.tracker.narrow = view < NARROW and not self.tracker.steady

    def step(self, increment: Increment | None, ranges: Array | None, seconds: float = 0.0) -> Array:
        """The next frame's pose (3,), world frame: `increment` since the frame before, None of the first; `ranges` (B,)
        [m], None without a scan; `seconds` since the frame before, 0 where unknown.
        """
        frame, self._count = self._count, self._count + 1
        tracker = self.tracker
        if increment is not None:
            tracker.predict(*increment, seconds)
        seen = scan_points(self._nothing if ranges is None else ranges, self._beams, self.parameters.max_range)
        if ranges is not None and self.matched and (not tracker.narrow or tracker.is_due):
            tracker.correct(seen)
        if frame == 0 or (ranges is not None and tracker.is_due):
            self._key(frame, self._nothing if ranges is None else ranges, seen)
        return compose(self.poses[-1], tracker.pose)

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) of the newest pose, world frame, additive; as scan matching claims, times its scale."""
        if self._covariance is None:
            raise ValueError("made without covariances")
        if not self.tracker.pose.any():
            return self._covariance
        return compose_covariances(self.poses[-1], self._covariance, self.tracker.pose, self.tracker.covariance)

    def _key(self, frame: int, ranges: Array, seen: Points) -> None:
        motion, covariance = self.tracker.pose, self.parameters.chain_factor * self.tracker.covariance
        if frame:
            self._graph.add_key(motion, covariance)
            if self._covariance is not None:
                self._covariance = compose_covariances(self.poses[-1], self._covariance, motion, covariance)
            self.poses = np.concatenate([self.poses, compose(self.poses[-1], motion)[None]])
        else:
            self.poses = self._prior.mean[None].copy()
        self.frames.append(frame)
        self.motions.append(motion)
        self.covariances.append(covariance)
        self.closer.add_key(ranges, seen, motion, covariance)
        self.tracker.make_key(seen)
        believed = self.closer.find(self.poses) if self.matched else []
        if believed:
            self._graph.add_loops(
                np.array([c.key1 for c in believed]), np.array([c.key2 for c in believed]),
                np.array([c.relative for c in believed]), np.array([c.covariance for c in believed]),
            )  # fmt: skip
            off = [pose_error(between(self.poses[c.key1], self.poses[c.key2]), c.relative) for c in believed]
            self.waits, self._far = True, self._far or bool((np.abs(off) > FAR).any())
        keys = len(self.frames)  # an update costs time with the graph's size: in large ones key poses share one
        if self.waits and (self._far or keys - self._updated > (keys - LARGE) // AMORTIZED):
            self.update()

    def update(self) -> None:
        """Estimate all key poses anew."""
        self._graph.update()
        self.poses, self.waits, self._far, self._updated = self._graph.poses(), False, False, len(self.frames)
        self.closer.moved(self.poses)
        if self._covariance is not None:
            self._covariance = self._graph.newest()[1]

"""Graph SLAM by scan matching, frame by frame: the front end of a laser log, and of a robot that drives."""

import numpy as np

from data.inputs import Increment, Prior, Scanner
from data.se2 import Array, between, compose, pose_error
from wings.laser.pose_graph import PoseGraph
from wings.laser.scans.points import Points, beams_of, scan_points
from wings.laser.scans.uncertainty import compose_covariances
from wings.laser.slam.closures import Closure, LoopCloser
from wings.laser.slam.parameters import LaserParameters
from wings.laser.slam.tracker import Tracker

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
        # (3,), (3, 3) of each key pose in the frame of the one before; of the first unused
        self.motions: list[Array] = []
        self.covariances: list[Array] = []
        self.poses = np.zeros((0, 3))  # of all key poses, world frame
        self.closer = LoopCloser(parameters, scanner)  # with all loop closures
        self.tracker = Tracker(parameters, scanner.sigma, steady=steady)
        self._prior, self._graph = prior, PoseGraph(prior)
        self._beams, self._nothing = beams_of(scanner, beams), np.zeros(beams)
        self._waiting, self._far, self._updated, self._count = False, False, 0, 0
        self._covariance = prior.covariance if with_covariance else None

    def step(self, increment: Increment | None, ranges: Array | None, seconds: float = 0.0) -> Array:
        """The next frame's pose (3,), world frame: `increment` since the frame before, None of the first; `ranges` (B,)
        [m], None without a scan; `seconds` since the frame before, 0 where unknown.
        """
        frame, self._count = self._count, self._count + 1
        tracker = self.tracker
        if increment is not None:
            tracker.predict(*increment, seconds)
        seen = scan_points(self._nothing if ranges is None else ranges, self._beams, self.parameters.max_range)
        if ranges is not None:
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
        believed = self.closer.find(self.poses)
        if believed:
            self._graph.add_loops(
                np.array([c.key1 for c in believed]), np.array([c.key2 for c in believed]),
                np.array([c.relative for c in believed]), np.array([c.covariance for c in believed]),
            )  # fmt: skip
            self._waiting, self._far = True, self._far or any(is_far(c, self.poses) for c in believed)
        # an update costs time with the size of the graph: in large ones key poses have one in common
        keys = len(self.frames)
        if self._waiting and (self._far or keys - self._updated > (keys - LARGE) // AMORTIZED):
            self.update()

    def update(self) -> None:
        """Estimate all key poses anew."""
        self._graph.update()
        self.poses, self._waiting, self._far, self._updated = self._graph.poses(), False, False, len(self.frames)
        self.closer.moved(self.poses)
        if self._covariance is not None:
            self._covariance = self._graph.newest()[1]

    @property
    def waits(self) -> bool:
        """Whether loop closures wait for an update."""
        return self._waiting


def is_far(closure: Closure, poses: Array) -> bool:
    """Whether a loop closure disagrees with the estimate of the key poses (K, 3)."""
    error = pose_error(between(poses[closure.key1], poses[closure.key2]), closure.relative)
    return bool((np.abs(error) > FAR).any())

"""Graph SLAM by scan matching while the robot drives: the front end of laser logs, a frame at a time.

Without `--least-information`, `wings.laser.slam.front_end` gives a recording the same online poses, to the bit.
"""

from __future__ import annotations

import math

import numpy as np

from data.inputs import Frame, FrameObservations, Increment, Scanner
from data.result import DISCARD, MapState
from data.se2 import Array, between, compose
from eval.replay.settings import Setup
from graph.factors import UnderConstrained
from wings.laser.scans.matching import best_pose, pyramid
from wings.laser.slam.incremental import ScanSlam
from wings.laser.slam.parameters import LaserParameters
from wings.robot.live.grid import GridPainter
from wings.robot.live.session import Step
from wings.robot.log import prior
from wings.robot.packets import PERIOD
from wings.robot.scan_packets import Scan
from wings.robot.simulated.lidar import Lidar
from wings.robot.simulated.room import room

BACK_END, METHOD = "isam2", "scan"
"""The names of this estimator and of its association in a replay."""


class ScanEstimating:
    """The online estimator of scans; as `wings.robot.live.session.Estimating`."""

    name, association, smooths = BACK_END, METHOD, True

    def __init__(self, setup: Setup, sigma: float) -> None:
        """`sigma` [m]: standard deviation of a range."""
        self.title, self.failure = f"{BACK_END} {METHOD}", ""
        self.slam: ScanSlam | None = None  # from the first scan on, which tells what the scanner is
        self._parameters = LaserParameters(keyframe_distance=setup.keyframe_distance)
        self._least, self._sigma = setup.least_information, sigma
        self._before: list[tuple[Increment | None, float]] = []  # frames until then
        self._time = 0.0

    def take(self, frame: Frame, scan: Scan | None = None) -> Step | None:
        """Process the next frame; None before the first scan, and after the estimator has ended."""
        if self.failure:
            return None
        seconds = frame.time - self._time if frame.number else 0.0
        self._time = frame.time
        if self.slam is None and scan is None:
            self._before.append((frame.increment, seconds))
            return None
        try:
            mean, covariance = self._stepped(frame.increment, scan, seconds)
        except UnderConstrained as stop:
            self.failure = f"at frame {frame.number}: {stop}"
            return None
        nothing = len(frame.observations.z)
        return Step(mean, covariance, np.full(nothing, DISCARD), np.full(nothing, -1), np.nan)

    def _stepped(self, increment: Increment | None, scan: Scan | None, seconds: float) -> tuple[Array, Array]:
        if self.slam is None:
            assert scan is not None
            scanner, beams = scan.beams.scanner(self._sigma), scan.beams.number
            self.slam = ScanSlam(prior(), scanner, beams, self._parameters, least=self._least, with_covariance=True)
            for earlier, passed in self._before:
                self.slam.step(earlier, None, passed)
            self._before = []
        mean = self.slam.step(increment, None if scan is None else scan.metres, seconds)
        return mean, self.slam.covariance

    def map(self) -> MapState | None:
        """None: its map is a grid."""
        return None

    def keys(self) -> tuple[Array, Array, Scanner] | None:
        """Poses (n, 3) and scans (n, B) [m] of the key poses in the graph; None before the first scan."""
        if self.slam is None:
            return None
        number, poses = self.slam.keys()
        return poses, np.array([self.slam.closer.ranges(k) for k in number.tolist()]), self.slam.scanner

    def counted(self) -> str:
        """Its size in words."""
        return "" if self.slam is None else f"key poses {self.slam.size}"


RADIUS, STEPS, SPREAD = 1.0, 120, 0.5
"""m, and scans on a circle, driven three times; m and rad of the stated odometry, so that loops are searched for."""


def rehearse_scans(setup: Setup, sigma: float) -> None:
    """Scans on a circle, so that nothing is compiled or loaded while the robot moves."""
    lidar, place, rng = Lidar(), room(0), np.random.default_rng(0)
    turn = 6.0 * math.pi / STEPS
    circle = np.array(
        [[RADIUS * math.sin(turn * k), RADIUS * (1 - math.cos(turn * k)), turn * k] for k in range(STEPS)]
    )
    poses = compose(np.array([2.0, 1.5, 0.0]), circle)
    estimating = ScanEstimating(setup, sigma)
    first = 0
    for k, pose in enumerate(poses):
        motion = between(poses[k - 1], pose) if k else None
        increment = None if motion is None else Increment(motion, np.diag([SPREAD, SPREAD, SPREAD]) ** 2 / STEPS)
        nothing = FrameObservations(np.zeros((0, 2)), np.zeros((0, 2, 2)))
        frame = Frame(k, PERIOD * k, increment, nothing, None, first)
        estimating.take(frame, lidar.scan(place, pose, PERIOD * k, (0, 0, 0), rng))
    xy = lidar.scan(place, poses[0], 0.0, (0, 0, 0), rng).metres[:90, None] * [1.0, 0.0]
    best_pose(xy, pyramid(xy, 12.0), np.zeros(3), np.array([0.3, 0.3, 0.2]), 0.4)
    painter = GridPainter(estimating.keys, lambda grid: None)
    painter.finish(0.0)

"""Constants of the laser front end, set on the Intel log's exact relations and on simulated plans, nowhere else."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class LaserParameters:
    """Constants of the front end; lengths in m, angles in rad.

    Attributes:
        keyframe_distance, keyframe_angle: a key pose is made when either is reached.
        max_range: returns beyond it are not used: far surfaces are hit by few beams.
        window: key scans that the newest scans are matched against.
        sigma: standard deviation of a range; the scanner's own where that is larger.
        variance_scale: of every scan-matching covariance: 1 is honest in simulation (chain and closures against the
            truth 0.9 to 1.2); on Intel 5 is safe for gates, residuals
            say 3.4 (`scale.learned_scale`).
        prior_scale: standard deviations at which the odometry prior begins to yield (Cauchy).
        least_share: share of a scan's points that must fit for its match to be used.
        loop_gap: key poses between the two of a loop closure, at least.
        loop_distance: of the middles of what two key scans see, to be candidates (and twice the uncertainty).
        loop_apart: key poses between two candidates of one key pose.
        loops_per_key: candidates looked at per key pose.
        loop_around: key scans on either side of a candidate that are matched against with it.
        direct_distance, direct_angle: three standard deviations up to which a match starts from the expected pose;
            beyond it a correlative search covers them, up to `widest` either way.
        least_correlation, loop_share, most_contradiction: of a loop closure: score of the search, share of points that
            fit, share of beams that contradict.
        loosest: largest standard deviation of a closure's place in its worst direction, before scaling.
        gate: chi-square of three degrees of freedom, closure against the graph.
        pair_gate: the same of the circle through two closures.
        wait: key poses after which a closure that found no second one is given up.
    """

    keyframe_distance: float = 0.4
    keyframe_angle: float = 0.5
    max_range: float = 20.0
    window: int = 8
    sigma: float = 0.01
    variance_scale: float = 5.0
    prior_scale: float = 2.0
    least_share: float = 0.3
    loop_gap: int = 12
    loop_distance: float = 2.0
    loop_apart: int = 8
    loops_per_key: int = 2
    loop_around: int = 2
    direct_distance: float = 0.2
    direct_angle: float = 0.1
    widest: float = 8.0
    least_correlation: float = 0.4
    loop_share: float = 0.5
    most_contradiction: float = 0.1
    loosest: float = 0.02
    gate: float = 16.27
    pair_gate: float = 11.34
    wait: int = 15

    def distance_sigma(self, range_sigma: float) -> float:
        """Standard deviation [m] of a point's distance from a line of another scan, scaled: both scans are noisy."""
        return math.sqrt(2.0 * self.variance_scale) * max(self.sigma, range_sigma)

"""Constants of the laser front end, chosen on the Intel log's exact relations and on simulated plans."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class LaserParameters:
    """Constants of the front end; lengths in m, angles in rad."""

    keyframe_distance: float = 0.4  # a key pose is made when this or the angle is reached
    keyframe_angle: float = 0.5
    max_range: float = 20.0  # farther returns are not used: far surfaces are hit by few beams
    window: int = 8  # number of key scans that the newest scans are matched against
    sigma: float = 0.01  # standard deviation of a range; the scanner's own if larger
    # of every scan-matching covariance. 1 is consistent in simulation (0.9 to 1.2); on Intel 5 is safe for gates,
    # residuals give 3.4 (`scale.learned_scale`)
    variance_scale: float = 5.0
    prior_scale: float = 2.0  # standard deviations at which the odometry prior begins to yield (Cauchy)
    least_share: float = 0.3  # least share of a scan's points that must fit
    loop_gap: int = 12  # least number of key poses between the two of a loop closure
    loop_distance: float = 2.0  # largest distance of the centres of two key scans (plus twice the uncertainty)
    loop_apart: int = 8  # key poses between two candidates of one key pose
    loops_per_key: int = 2  # number of candidates per key pose
    loop_around: int = 2  # key scans on either side of a candidate that are matched with it
    direct_distance: float = 0.2  # three standard deviations up to which a match starts from the expected pose
    direct_angle: float = 0.1  # the same; beyond them a correlative search covers them
    widest: float = 8.0  # up to which it does
    least_correlation: float = 0.4  # of a loop closure: score of the search
    loop_share: float = 0.5  # share of points that fit
    most_contradiction: float = 0.1  # share of beams that contradict
    loosest: float = 0.02  # largest standard deviation of a closure's position in its worst direction, before scaling
    gate: float = 16.27  # chi-square (3 dof) of a closure against the graph
    pair_gate: float = 11.34  # chi-square (3 dof) of the circle through two closures
    chain_factor: float = 1.0  # factor on variances of the chain where loop closures are sought
    wait: int = 15  # key poses after which a closure without a second one is dropped

    def distance_sigma(self, range_sigma: float) -> float:
        """Standard deviation [m] of a point's distance from a line of another scan, scaled: both scans are noisy."""
        return math.sqrt(2.0 * self.variance_scale) * max(self.sigma, range_sigma)

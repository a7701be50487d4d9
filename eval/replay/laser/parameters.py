"""Constants of the laser front end, set on the Intel log's exact relations and on simulated plans, nowhere else."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LaserParameters:
    """Constants of the front end; lengths in m, angles in rad.

    Attributes:
        keyframe_distance, keyframe_angle: a key pose is made when either is reached.
        max_range: returns beyond it are not used: far surfaces are hit by few beams.
        window: key scans that the newest scans are matched against.
        sigma: standard deviation of a point's distance from a line; the scanner's own where that is larger.
        variance_scale: of every scan-matching covariance; 1 is honest in simulation, 10 on the Intel log.
        prior_scale: standard deviations at which the odometry prior begins to yield (Cauchy).
        least_share: share of a scan's points that must fit for its match to be used.
    """

    keyframe_distance: float = 0.4
    keyframe_angle: float = 0.5
    max_range: float = 20.0
    window: int = 8
    sigma: float = 0.01
    variance_scale: float = 10.0
    prior_scale: float = 2.0
    least_share: float = 0.3

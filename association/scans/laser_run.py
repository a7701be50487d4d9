"""A run over a laser log: what every run has, and the pose graph behind it."""

from __future__ import annotations

from dataclasses import dataclass

from association.scans.constraints import Chain, Loops
from data.result import Run
from data.se2 import Array

SCAN = "scan"
"""The way of association: scans matched to each other, loop closures found in them."""


@dataclass(frozen=True, eq=False)
class LaserRun(Run):
    """A run over a laser log, and what only such a log has; all of it there but in dead reckoning.

    Attributes:
        chain, loops: the constraints that every back end was given.
        frame_seconds: (N,) s, of the front end at each frame, matching, loop closures and graph.
        key_pose: (K, 3) of all key poses in the end, a filter's last state, too.
        weight: (L,) of each loop closure in the end; 0: left out, NaN: never believed.
        last: (N, 3) the path that belongs to `key_pose`; a smoother's final one.
        scale: factor on the variances that scan matching claims, learned from how loop closures fit, and its standard
            error; None: not learned.
        with_gate: of a filter without a gate, the same with one, and with one and covariances as scan matching claims.
    """

    chain: Chain | None = None
    loops: Loops | None = None
    frame_seconds: Array | None = None
    key_pose: Array | None = None
    weight: Array | None = None
    last: Array | None = None
    scale: tuple[float, float] | None = None
    with_gate: tuple[LaserRun, LaserRun] | None = None

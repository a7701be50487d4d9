"""What a laser front end hands to every back end alike, key poses in a chain and loop closures; and a run over them."""

from __future__ import annotations

from dataclasses import dataclass

from data.inputs import IntArray, read_only
from data.result import Run
from data.se2 import Array


@dataclass(frozen=True, eq=False)
class Chain:
    """Key poses, and the way from each to the next; all other frames hang on the key pose before them.

    Covariances are of the additive error [m, m, rad] of the relative pose, in the body frame of the pose it starts at.

    Attributes:
        frame: (K,) frame of each key pose, ascending; the first is frame 0.
        motion: (K, 3) pose of key k in the frame of key k - 1; row 0 is zero.
        covariance: (K, 3, 3) of it.
        key: (N,) the newest key pose at each frame.
        since: (N, 3) pose of each frame in its key pose's frame; zero at a key pose.
        since_covariance: (N, 3, 3) of it.
    """

    frame: IntArray
    motion: Array
    covariance: Array
    key: IntArray
    since: Array
    since_covariance: Array

    def __post_init__(self) -> None:
        read_only(self)


@dataclass(frozen=True, eq=False)
class Loops:
    """Loop closures that were looked at, in the order of their finding, believed or not.

    Attributes:
        key1, key2: (L,) key poses, key1 < key2; key2 was the newest when the loop was found.
        relative: (L, 3) pose of key2 in the frame of key1.
        covariance: (L, 3, 3) of its additive error.
        score: (L,) share of the points of one scan that fit the other.
        believed: (L,) the newest key pose when it joined the graph, -1 if it never did.
    """

    key1: IntArray
    key2: IntArray
    relative: Array
    covariance: Array
    score: Array
    believed: IntArray

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.key1)


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

    @property
    def decides(self) -> bool:
        """It decides about loop closures, or corners of walls, and about no observation of its log."""
        return False

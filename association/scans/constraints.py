"""Constraints that a laser front end gives every back end: key poses in a chain and loop closures; and a laser run."""

from __future__ import annotations

from dataclasses import dataclass

from data.inputs import IntArray, read_only
from data.result import Run
from data.se2 import Array


@dataclass(frozen=True, eq=False)
class Chain:
    """Key poses and the relative pose from each to the next; all other frames are relative to the key pose before them.

    Covariances are of the additive error [m, m, rad] of the relative pose, in the body frame where it starts.

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
    """Loop-closure candidates in the order in which they were found, accepted or not.

    Attributes:
        key1, key2: (L,) key poses, key1 < key2; key2 was the newest when the loop was found.
        relative: (L, 3) pose of key2 in the frame of key1.
        covariance: (L, 3, 3) of its additive error.
        score: (L,) share of the points of one scan that fit the other.
        believed: (L,) the newest key pose when it joined the graph, -1 if it was rejected.
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
"""Name of the association method of laser logs: scan matching with loop closures."""


@dataclass(frozen=True, eq=False)
class LaserRun(Run):
    """A run over a laser log; dead reckoning has none of the attributes.

    Attributes:
        chain, loops: the constraints that every back end was given.
        frame_seconds: (N,) s, computing time of the front end at each frame.
        key_pose: (K, 3) final estimate of all key poses; of a filter its last state.
        weight: (L,) final weight of each loop closure; 0: left out, NaN: never accepted.
        last: (N, 3) the path that belongs to `key_pose`; a smoother's final one.
        scale: variance scale of scan matching and its standard error, from the residuals of loop closures, or None.
        with_gate: of a filter without a gate, the same with one, and with one and unscaled covariances.
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
        """False: it decides about loop closures, not about observations of its log."""
        return False

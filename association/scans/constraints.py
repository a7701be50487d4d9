"""Constraints that a laser front end gives every back end: key poses in a chain and loop closures; and a laser run."""

from __future__ import annotations

from dataclasses import dataclass

from data.inputs import IntArray
from data.locked import read_only
from data.result import Run
from data.se2 import Array


@dataclass(frozen=True, eq=False)
class Chain:
    """Key poses and the relative pose from each to the next; all other frames are relative to the key pose before them.

    Covariances are of the additive error [m, m, rad] of the relative pose, in the body frame where it starts.
    """

    frame: IntArray  # (K,) frame of each key pose, ascending; the first is frame 0
    motion: Array  # (K, 3) pose of key k in the frame of key k - 1; row 0 is zero
    covariance: Array  # (K, 3, 3) of it
    key: IntArray  # (N,) the newest key pose at each frame
    since: Array  # (N, 3) pose of each frame in its key pose's frame; zero at a key pose
    since_covariance: Array  # (N, 3, 3) of it

    def __post_init__(self) -> None:
        read_only(self)


@dataclass(frozen=True, eq=False)
class Loops:
    """Loop-closure candidates in the order in which they were found, accepted or not."""

    key1: IntArray  # (L,) key poses, key1 < key2
    key2: IntArray  # (L,) the newest key pose when the loop was found
    relative: Array  # (L, 3) pose of key2 in the frame of key1
    covariance: Array  # (L, 3, 3) of its additive error
    score: Array  # (L,) share of the points of one scan that fit the other
    believed: IntArray  # (L,) the newest key pose when it joined the graph, -1 if it was rejected

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.key1)


SCAN = "scan"  # name of the association method of laser logs: scan matching with loop closures


@dataclass(frozen=True, eq=False)
class LaserRun(Run):
    """A run over a laser log; dead reckoning has none of the attributes."""

    chain: Chain | None = None  # the constraints that every back end was given, with `loops`
    loops: Loops | None = None
    frame_seconds: Array | None = None  # (N,) s, computing time of the front end at each frame
    key_pose: Array | None = None  # (K, 3) final estimate of all key poses; of a filter its last state
    weight: Array | None = None  # (L,) final weight of each loop closure; 0: left out, NaN: never accepted
    last: Array | None = None  # (N, 3) the path that belongs to `key_pose`; a smoother's final one
    scale: tuple[float, float] | None = None  # variance scale of scan matching and its standard error
    with_gate: tuple[LaserRun, LaserRun] | None = None  # of a filter without a gate: with one; with one, unscaled

    @property
    def decides(self) -> bool:
        """False: it decides about loop closures, not about observations of its log."""
        return False

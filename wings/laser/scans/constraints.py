"""Constraints that a laser front end gives every back end: key poses in a chain and loop closures; and a laser run. A
map draws walls once if scans of revisited places contradict each other no more than neighbouring ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.inputs import IntArray, Scans
from data.locked import Locked
from data.result import Run
from data.se2 import Array, BoolArray, between
from wings.laser.scans.occupancy import contradiction

NEAR, APART, BESIDE = 3.0, 12, 3
"""m between two key poses whose scans are compared; key poses between them: revisits, and neighbours at most."""
MOST_PAIRS, LEAST_PAIRS = 300, 10
MAX_RANGE = 20.0  # m, of beams that are compared
TOLERANCE = (0.15, 0.03)  # m, share of the range: a doubled wall is farther off, a grazing wall by a right heading not
DOUBLED = 0.03
"""Share of beams by which revisits contradict more than neighbours do: at most 0.008 on recorded logs and on simulated
ones with people and glass; 0.12 where the path of a simulated one drifts by half a metre."""


class Consistency(NamedTuple):
    """Shares of beams of one key scan that pass a surface of another: among revisits, among neighbours (its noise, with
    people and glass), and the number of revisits compared.
    """

    revisits: float
    neighbours: float
    pairs: int

    @property
    def excess(self) -> float:
        """What revisits contradict more."""
        return self.revisits - self.neighbours

    @property
    def is_doubled(self) -> bool:
        """Whether walls are drawn twice."""
        return self.excess > DOUBLED


def consistency(scans: Scans, frames: IntArray, pose: Array) -> Consistency | None:
    """Of the scans at key poses (K, 3), which are these frames (K,); None without revisits."""
    pairs: list[tuple[int, int]] = []
    for k in range(len(pose)):
        before = pose[: max(k - APART + 1, 0), :2]
        old = np.flatnonzero(np.hypot(before[:, 0] - pose[k, 0], before[:, 1] - pose[k, 1]) < NEAR)  # NaN is far
        if len(old):
            pairs.append((int(old[len(old) // 2]), k))
    if len(pairs) < LEAST_PAIRS:
        return None
    pairs = pairs[:: max(len(pairs) // MOST_PAIRS, 1)]
    row = dict(zip(scans.frame.tolist(), scans.ranges, strict=True))

    def share(some: Sequence[tuple[int, int]]) -> float:
        pairs = [(i, j) for i, j in some if int(frames[i]) in row and int(frames[j]) in row]
        rows = [(row[int(frames[i])], row[int(frames[j])], between(pose[i], pose[j])) for i, j in pairs]
        shares = [contradiction(*each, scans.scanner, MAX_RANGE, TOLERANCE) for each in rows]
        return float(np.mean(shares)) if shares else 0.0

    return Consistency(share(pairs), share([(max(j - BESIDE, 0), j) for _, j in pairs]), len(pairs))


@dataclass(frozen=True, eq=False)
class Chain(Locked):
    """Key poses and the relative pose from each to the next; all other frames are relative to the key pose before them.
    Covariances are of the additive error [m, m, rad] of the relative pose, in the body frame where it starts.
    """

    frame: IntArray  # (K,) frame of each key pose, ascending; the first is frame 0
    motion: Array  # (K, 3) pose of key k in the frame of key k - 1; row 0 is zero
    covariance: Array  # (K, 3, 3) of it
    key: IntArray  # (N,) the newest key pose at each frame
    since: Array  # (N, 3) pose of each frame in its key pose's frame; zero at a key pose
    since_covariance: Array  # (N, 3, 3) of it


@dataclass(frozen=True, eq=False)
class Loops(Locked):
    """Loop-closure candidates in the order in which they were found, accepted or not."""

    key1: IntArray  # (L,) key poses, key1 < key2
    key2: IntArray  # (L,) the newest key pose when the loop was found
    relative: Array  # (L, 3) pose of key2 in the frame of key1
    covariance: Array  # (L, 3, 3) of its additive error
    score: Array  # (L,) share of the points of one scan that fit the other
    believed: IntArray  # (L,) the newest key pose when it joined the graph, -1 if it was rejected

    def __len__(self) -> int:
        return len(self.key1)


KEPT = 0.05  # weight below which a loop closure is rejected: Cauchy's at 4.4 sigma; GNC's weights are 0 or 1


@dataclass(frozen=True, eq=False)
class LaserRun(Run):
    """A run over a laser log; dead reckoning has none of the attributes."""

    chain: Chain | None = None  # the constraints that every back end was given, with `loops`
    loops: Loops | None = None
    frame_seconds: Array | None = None  # (N,) s, computing time of the front end at each frame
    key_pose: Array | None = None  # (K, 3) final estimate of all key poses; of a filter its last state
    weight: Array | None = None  # (L,) final weight of each loop closure; 0: left out, NaN: never accepted
    last: Array | None = None  # (N, 3) the path that belongs to `key_pose`; a smoother's final one
    loose: BoolArray | None = None  # (N,) frames whose scan did not fix a direction, or did not fit
    scale: tuple[float, float] | None = None  # variance scale of scan matching and its standard error

    @property
    def decides(self) -> bool:
        """False: it decides about loop closures, not about observations of its log."""
        return False

    @property
    def parts(self) -> tuple[Chain, Loops, Array, Array]:
        """Chain, loop closures, key poses, and the path that belongs to them; AssertionError of dead reckoning."""
        assert self.chain is not None
        assert self.loops is not None
        assert self.key_pose is not None
        assert self.last is not None
        return self.chain, self.loops, self.key_pose, self.last

    def counts(self, phase: str) -> dict[str, int]:
        """Numbers of loop closures that were tested, believed and not."""
        if self.loops is None:
            return {}
        believed = self.kept(phase)
        accepted = int(believed.sum())
        return {"observations": len(believed), "accepted": accepted, "rejected": len(believed) - accepted}

    def kept(self, phase: str) -> BoolArray:
        """Which loop closures (L,) are believed: online those that joined the graph, finally those that kept weight."""
        if self.loops is None:
            return np.zeros(0, np.bool_)
        believed: BoolArray = self.loops.believed >= 0
        return believed & ~(self.weight < KEPT) if phase == "final" and self.weight is not None else believed

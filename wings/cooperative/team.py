"""A team: the inputs of all its robots on one clock, and their observations of each other.

Each robot has frames of its own. The instants of the team are all their times; at an instant at which a robot observes
another one, every robot that is under way has a frame. Nothing here contains ground truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from data.inputs import Inputs, IntArray
from data.locked import Locked, read_only
from data.se2 import Array

EXCHANGES = ("joint", "naive", "intersection", "alone")
"""How robots share estimates: one estimate of all; each its own, and that of another one taken as independent, or fused
by covariance intersection; not at all."""


@dataclass(frozen=True, eq=False)
class Encounters(Locked):
    """Observations of robots by robots, ascending by instant and observer."""

    instant: IntArray  # (S,) of the team
    observer: IntArray  # (S,) rows of the team
    z: Array  # (S, 2), as of the observer's sensor
    R: Array  # (S, 2, 2)
    label: IntArray  # (S,) number of the observed robot as read, `CLUTTER` or `UNLABELLED`; for known association alone

    def __len__(self) -> int:
        return len(self.instant)


@dataclass(frozen=True, eq=False)
class Team:
    """All robots of one world."""

    number: tuple[int, ...]  # (n,) of the robots, ascending
    members: tuple[Inputs, ...]  # (n,) inputs of each, with one sensor and one map
    labels: tuple[IntArray, ...]  # (n,) labels of the observations of landmarks of each, for known association alone
    time: Array  # (T,) s of the instants, ascending
    instant: tuple[IntArray, ...]  # (n,) the instant of each frame of each robot
    encounters: Encounters  # of robots by robots
    sensed: bool = False  # the labels come from a sensor
    frame: IntArray = field(init=False, repr=False)  # (n, T) the frame of each robot at each instant, -1: none

    def __post_init__(self) -> None:
        frame = np.full((len(self.members), len(self.time)), -1, np.int64)
        for row, at in enumerate(self.instant):
            frame[row, at] = np.arange(len(at))
        object.__setattr__(self, "frame", frame)
        read_only(self)

    def __len__(self) -> int:
        return len(self.members)

    def row(self, number: int) -> int:
        """Row of a robot by its number, -1 for none."""
        return self.number.index(number) if number in self.number else -1

    def of(self, observer: int) -> IntArray:
        """Encounters (s,) by a robot, by its row."""
        return np.flatnonzero(self.encounters.observer == observer)


def team_of(
    number: Sequence[int], members: Sequence[Inputs], labels: Sequence[IntArray], clocks: Sequence[float],
    seen: Sequence[tuple[IntArray, Array, Array, IntArray]], *, sensed: bool = False,
) -> Team:  # fmt: skip
    """A team from robots whose times begin at `clocks` (n,) [s]; `seen`: of each its frames with encounters (s,), z
    (s, 2), R (s, 2, 2) and labels (s,). Times that agree to a microsecond are one instant.
    """
    ticks = [np.rint((m.time + clock) * 1e6).astype(np.int64) for m, clock in zip(members, clocks, strict=True)]
    every = np.unique(np.concatenate(ticks))
    instant = tuple(np.searchsorted(every, t) for t in ticks)
    at = np.concatenate([i[f] for i, (f, *_) in zip(instant, seen, strict=True)])
    who = np.repeat(np.arange(len(seen)), [len(f) for f, *_ in seen])
    order = np.lexsort((who, at))
    z, R, label = (np.concatenate(each)[order] for each in zip(*(s[1:] for s in seen), strict=True))
    encounters = Encounters(at[order], who[order], z, R, label)
    return Team(tuple(number), tuple(members), tuple(labels), every / 1e6, instant, encounters, sensed)


@dataclass(frozen=True, eq=False)
class TeamInputs(Inputs):
    """The inputs of one robot of a team, whose runs are those of all of them."""

    team: Team | None = field(default=None, kw_only=True)  # all robots
    robot: int = field(default=0, kw_only=True)  # row of this one
    exchange: str = field(default="joint", kw_only=True)  # one of `EXCHANGES`

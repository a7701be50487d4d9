"""Robots in the arena that observe each other: loops about one centre, of several sizes, in both directions."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np

from data.errors import UsageError
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations
from data.log import Log
from data.se2 import Array
from data.truth import Truth
from data.worlds.arena import Arena, observe
from data.worlds.parameters import NAMES, drawn_prior, driven, streams, told
from wings.cooperative.team import EXCHANGES, TeamInputs, team_of


@dataclass(frozen=True)
class Team(Arena):
    """Parameters of the world; those of the arena hold for each robot."""

    landmarks: int = told(2, "number of point landmarks; few, so that the robots need each other")
    robots: int = told(5, "their number")
    robot: int = told(1, "whose log it is, from 1")
    exchange: str = told("joint", "how they share estimates: joint, naive, intersection or alone")
    encounter: float = told(1.0, "probability that a robot in view is reported", most="probability")

    positive: ClassVar[tuple[str, ...]] = (*Arena.positive, "robots", "robot")
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {**Arena.choices, "exchange": EXCHANGES}
    alone: ClassVar[tuple[str, ...]] = (*NAMES, "sensor", "sigma_map")

    def __post_init__(self) -> None:
        for f in fields(self):
            if f.name in self.alone and getattr(self, f.name) != f.default:
                raise UsageError(f"team: {f.name} is of the arena with one robot, arena:0:{f.name}={f.default}")
        super().__post_init__()
        if self.robot > self.robots:
            raise UsageError(f"team: robot = {self.robot}; there are {self.robots}")


def simulate(world: Team, seed: int, name: str | None = None) -> Log:
    """The log of one robot of a team. Same parameters and seed: same bytes."""
    return simulate_all(world, seed, name)[world.robot - 1]


def simulate_all(world: Team, seed: int, name: str | None = None) -> list[Log]:
    """The logs of all robots, each under the name of the team."""
    map_rng, *rngs = streams(seed, 1 + 4 * world.robots)
    centre, sensor = np.array([0.0, world.radius]), world.model()
    xy = centre + map_rng.uniform(-0.5 * world.side, 0.5 * world.side, (world.landmarks, 2))
    known = LandmarkMap(np.arange(world.landmarks), xy)
    time = world.period * np.arange(world.frames, dtype=np.float64)
    driving = [_drive(world, k, time, rngs[4 * k]) for k in range(world.robots)]
    paths = np.stack([pose for pose, _, _ in driving])
    members, labels, seen = [], [], []
    for k, (pose, increments, floored) in enumerate(driving):
        frame, z, label = observe(world, sensor, pose, xy, rngs[4 * k + 1])
        R = np.tile(np.diag(np.square(world.sigma())), (len(z), 1, 1))
        prior = drawn_prior(pose[0], world.prior_sigma, world.prior_sigma_heading, rngs[4 * k + 2])
        members.append(Inputs(prior, time, increments, Observations(frame, z, R), sensor, known, floored=floored))
        labels.append(label)
        seen.append(_encounters(world, k, paths, rngs[4 * k + 3]))
    team = team_of(range(1, world.robots + 1), members, labels, [0.0] * world.robots, seen)
    logs = []
    for k, member in enumerate(members):
        values = {f.name: getattr(member, f.name) for f in fields(Inputs) if f.init}
        inputs = TeamInputs(**values, team=team, robot=k, exchange=world.exchange)
        truth = Truth(paths[k], known, labels[k])
        logs.append(Log(name or f"team:{seed}", inputs, truth, source={"kind": "team", "seed": seed, "robot": k + 1}))
    return logs


def _drive(world: Team, k: int, time: Array, rng: np.random.Generator) -> tuple[Array, Increments, int]:
    """True poses (N, 3) of robot k, noisy odometry, how many got the floor; every other robot drives clockwise."""
    dt, way = 1.0 / world.odometry_rate, 1.0 if k % 2 == 0 else -1.0
    radius, angle = world.radius * (1.0 - 0.5 * k / world.robots), 2.0 * math.pi * k / world.robots - 0.5 * math.pi
    at = dt * np.arange(math.ceil(time[-1] / dt) + 1)
    omega = way * world.speed / radius + world.swing * np.sin(2.0 * math.pi * at / 15.0)
    x, y = radius * math.cos(angle), world.radius + radius * math.sin(angle)
    start = np.array([x, y, angle + 0.5 * math.pi * way])
    return driven(dt, np.full(len(at), world.speed), omega, time, start, (world.sigma_v, world.sigma_omega), rng)


def _encounters(world: Team, k: int, paths: Array, rng: np.random.Generator) -> tuple[IntArray, Array, Array, IntArray]:
    """Frames (s,), observations (s, 2), R (s, 2, 2) and numbers (s,) of the robots that robot k observes."""
    others = np.array([j for j in range(len(paths)) if j != k], np.int64)
    only = replace(world, clutter=0.0, detection=world.encounter, landmarks=max(len(others), 1))
    frame, z, which = [], [], []
    for f in range(paths.shape[1]):
        _, seen, row = observe(only, world.model(), paths[k, f : f + 1], paths[others, f, :2], rng)
        frame.append(np.full(len(seen), f, np.int64))
        z.append(seen)
        which.append(others[row] + 1)
    R = np.diag(np.square(world.sigma()))
    at = np.concatenate(frame)
    return at, np.concatenate(z), np.tile(R, (len(at), 1, 1)), np.concatenate(which)

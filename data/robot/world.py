"""The worlds `walls:SEED`: the simulated robot drives along the walls of a room, and what its line carried is the log.

The line is well (`data.robot.simulate` is the one with faults). The robot starts at the world's origin; walls
are (rho, alpha) there. An observation's true id is the wall whose distance and direction it meets; none: clutter.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field

import numpy as np

from data.inputs import CLUTTER, Inputs, IntArray, LandmarkMap
from data.log import Log
from data.robot.driving import WallFollower
from data.robot.log import SENSOR, Framing, Noise, inputs_of
from data.robot.packets import PERIOD
from data.robot.simulated.physics import Physics, drive
from data.robot.simulated.room import Room, room
from data.se2 import Array, between, wrap_angle
from data.truth import Truth
from data.worlds.parameters import check_parameters

SAME = 1e-6
"""m, rad. Sides nearer to one line than this are one wall."""
MEETS = (0.1, 0.15)
"""m, rad. An observation this near to a wall shows it; parallel faces are more than half a metre apart, and an
observation's angle has a standard deviation of 0.05 rad at most (`observe.VAGUEST`)."""


@dataclass(frozen=True)
class Walls:
    """Parameters of the world; what the log states of noise is what there is.

    Attributes:
        frames: packets, four a second; 1200 are five minutes.
        room: seed of the room, 0 is 10 x 6 m with two boxes; that of the log if left out.
        slip: m per square root of a metre of a wheel's way, standard deviation, each wheel for itself.
        range_sigma: m, standard deviation of a sonar's distance.
        dropout: share of echoes that are missed.
        crosstalk: share of readings that are the echo of another sonar's ping.

    Raises:
        UsageError: a value of the wrong type or out of range.
    """

    frames: int = 1200
    room: int | None = field(default=None, metadata={"default": "the seed"})
    slip: float = Physics.slip
    range_sigma: float = Physics.range_sigma
    dropout: float = Physics.dropout
    crosstalk: float = Physics.crosstalk

    def __post_init__(self) -> None:
        check_parameters(
            "walls", self, positive=("frames", "range_sigma"), not_negative=("room", "slip", "dropout", "crosstalk")
        )


def simulate(walls: Walls, seed: int, name: str | None = None) -> Log:
    """One log of the world. Same arguments: same bytes."""
    place = room(seed if walls.room is None else walls.room)
    physics = Physics(walls.slip, walls.range_sigma, dropout=walls.dropout, crosstalk=walls.crosstalk)
    driven = drive(place, WallFollower(), walls.frames * PERIOD, np.random.default_rng(seed), physics)
    framing = Framing(Noise(walls.slip, walls.range_sigma))
    frames = [framing.frame(packet) for packet in driven.packets]
    path = between(place.start, driven.poses)
    known = lines(place)
    inputs = inputs_of(frames, framing.at_rest, known)
    truth = Truth(path, known, shown(inputs, path, known))
    source = {"kind": "walls", "seed": seed, "walls": asdict(walls)}
    return Log(name or f"walls:{seed}", inputs, truth, source=source)


def lines(place: Room) -> LandmarkMap:
    """The lines (rho, alpha) that a room's walls lie on, rho >= 0, seen from where the robot starts; ids count them."""
    ends = between(place.start, np.concatenate([place.segments, np.zeros((*place.segments.shape[:2], 1))], axis=2))
    found: list[Array] = []
    for (ax, ay, _), (bx, by, _) in ends:
        alpha = math.atan2(ax - bx, by - ay)
        rho = ax * math.cos(alpha) + ay * math.sin(alpha)
        line = np.array([rho, alpha]) if rho >= 0.0 else np.array([-rho, wrap_angle(alpha + math.pi)])
        if not any(np.abs(SENSOR.residual(line, other)).max() < SAME for other in found):
            found.append(line)
    return LandmarkMap(np.arange(len(found)), np.array(found))


def shown(inputs: Inputs, path: Array, known: LandmarkMap) -> IntArray:
    """Id (M,) of the wall that each observation shows, seen from the true path (N, 3)."""
    o = inputs.observations
    ids = np.full(len(o.frame), CLUTTER, np.int64)
    for i, (frame, z) in enumerate(zip(o.frame.tolist(), o.z, strict=True)):
        e = np.abs(SENSOR.residual(z, SENSOR.predict(path[frame], known.xy))) / MEETS
        nearest = int(np.argmin(e.sum(axis=1)))
        if e[nearest].max() < 1.0:
            ids[i] = known.id[nearest]
    return ids

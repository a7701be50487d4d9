"""The worlds `walls:SEED`: the simulated robot follows the walls of a room over a perfect line.

The robot starts at the world's origin; walls are (rho, alpha) there. An observation's true id is the wall it agrees
with; none: clutter.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from data.inputs import CLUTTER, Inputs, IntArray, LandmarkMap
from data.log import Log
from data.se2 import Array, between, wrap_angle
from data.truth import Truth
from data.worlds.parameters import check_parameters, told
from wings.robot.driving import WallFollower
from wings.robot.log import SENSOR, Framing, Noise, inputs_of
from wings.robot.packets import PERIOD
from wings.robot.simulated import Physics, Room, drive, room
from wings.robot.walls import FITS, USUAL_FIT

SAME = 1e-6  # m, rad. Sides nearer to one line are one wall.
MEETS = (0.1, 0.15)
"""m, rad. An observation this near to a wall is of it; parallel faces are more than 0.5 m apart, and the angle's
standard deviation is at most 0.05 rad (`observe.VAGUEST`)."""


@dataclass(frozen=True)
class Walls:
    """Parameters of the world; the log states the true noise. Raises UsageError for a value out of range."""

    frames: int = told(1200, "packets, four a second; 1200 are five minutes")
    room: int | None = told(
        None, "seed of the room, 0 is 10 x 6 m with two boxes; that of the log if left out", default="the seed"
    )
    slip: float = told(Physics.slip, "m per sqrt(m) of a wheel's travel, standard deviation, independent per wheel")
    range_sigma: float = told(Physics.range_sigma, "m, standard deviation of a sonar's distance")
    dropout: float = told(Physics.dropout, "share of echoes that are missed")
    crosstalk: float = told(Physics.crosstalk, "share of readings that are the echo of another sonar's ping")
    fit: str = told(USUAL_FIT, "of walls, see wings.robot.walls.FITS")

    def __post_init__(self) -> None:
        check_parameters("walls", self, positive=("frames", "range_sigma"), choices={"fit": FITS})


def simulate(walls: Walls, seed: int, name: str | None = None) -> Log:
    """One log of the world. Same arguments: same bytes."""
    place = room(seed if walls.room is None else walls.room)
    physics = Physics(walls.slip, walls.range_sigma, dropout=walls.dropout, crosstalk=walls.crosstalk)
    driven = drive(place, WallFollower(walls.fit), walls.frames * PERIOD, np.random.default_rng(seed), physics)
    framing = Framing(Noise(walls.slip, walls.range_sigma), walls.fit)
    frames = [framing.frame(packet) for packet in driven.packets]
    path = between(place.start, driven.poses)
    known = lines(place)
    inputs = inputs_of(frames, known)
    truth = Truth(path, known, shown(inputs, path, known))
    return Log(name or f"walls:{seed}", inputs, truth, source={"kind": "walls", "seed": seed, "walls": asdict(walls)})


def lines(place: Room) -> LandmarkMap:
    """Lines (rho, alpha) of a room's walls, rho >= 0, relative to the robot's start; ids count them."""
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
    """Id (M,) of the wall of each observation, from the true path (N, 3)."""
    o = inputs.observations
    ids = np.full(len(o.frame), CLUTTER, np.int64)
    for i, (frame, z) in enumerate(zip(o.frame.tolist(), o.z, strict=True)):
        e = np.abs(SENSOR.residual(z, SENSOR.predict(path[frame], known.xy))) / MEETS
        nearest = int(np.argmin(e.sum(axis=1)))
        if e[nearest].max() < 1.0:
            ids[i] = known.id[nearest]
    return ids

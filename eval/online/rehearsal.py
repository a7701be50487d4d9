"""Before the robot moves: everything that a drive will call is called once, so that nothing is loaded or compiled then.

A kernel that is compiled takes seconds, one that is only loaded 40 ms; a frame has 250.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from data.inputs import Frame, Increment, Sightings
from data.robot.driving import WallFollower
from data.robot.packets import PERIOD
from data.robot.simulated.physics import drive
from data.robot.simulated.room import room
from eval.online.session import Estimating, Session
from eval.replay.settings import Setup

DRIVEN = 15.0
"""s of a simulated drive: packets as they are."""
WALLS = (0.0, 0.5 * math.pi, math.pi)
"""rad, directions of the walls of made-up frames."""
PARKED = 1.0
"""s after which a wall leaves the state there, if it ever shall."""


def rehearse(names: Sequence[str], association: str, setup: Setup) -> None:
    """A short simulated drive, and frames with several walls at once, which leave the view and come back."""
    session = Session(names, association, setup)
    for packet in drive(room(0), WallFollower(), DRIVEN, np.random.default_rng(0)).packets:
        session.take(packet)
    soon = setup if setup.deactivate_after is None else replace(setup, deactivate_after=PARKED)
    for name in names:
        estimating = Estimating(name, association, soon)
        for frame in frames():
            estimating.take(frame)
        estimating.map()


def frames() -> Iterator[Frame]:
    """A wall is seen, and another for longer than it takes to park the first; then all, then one, then all again."""
    seen, rng, sigma = 0, np.random.default_rng(0), 0.01
    long = round(2.0 * PARKED / PERIOD)
    for number, walls in enumerate([
        WALLS[:1], *[WALLS[1:2]] * long, WALLS, (), WALLS[:2], WALLS, *[WALLS[:1]] * long, WALLS,
        WALLS[1:],
    ]):  # fmt: skip
        count = len(walls)
        z = np.array([[1.0, angle] for angle in walls]).reshape(-1, 2)
        z += 0.3 * sigma * rng.standard_normal(z.shape)
        R = np.tile(sigma**2 * np.eye(2), (count, 1, 1))
        increment = Increment(np.zeros(3), 1e-6 * np.eye(3)) if number else None
        for array in (z, R, *(increment or ())):
            array.setflags(write=False)
        yield Frame(number, PERIOD * number, increment, Sightings(z, R), None, seen)
        seen += count

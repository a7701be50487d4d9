"""The simulated worlds, each listed once: its module, its parameters, what a person is told, logs of it by name.

A world is imported when it is asked for, so that `--help` and a mistyped flag do not wait for it.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from data.errors import UsageError
from data.worlds import names

if TYPE_CHECKING:
    from data.log import Log


@dataclass(frozen=True)
class World:
    """A world and how it is spoken of.

    Attributes:
        module: where it stands, with its function `simulate(parameters, seed, name)`.
        parameters: in that module, the dataclass of its parameters.
        example: names of logs of it.
        counts: further keys of its names, whole numbers from 1 up that are no parameters.
        help, description, examples: of its kind of `python -m data.convert`; empty where that writes something else.
    """

    module: str
    parameters: str
    example: str
    help: str = ""
    description: str = ""
    examples: str = ""
    counts: tuple[str, ...] = ()


SIMULATORS: Mapping[str, World] = {
    "arena": World(
        "data.worlds.arena",
        "Arena",
        "arena:0 or arena:0:scale=-0.1+curvature=0.02",
        "a simulated world whose noise is known",
        "A simulated robot among point landmarks, every noise known; the same seed gives the same log.",
        """\
examples:
  python -m data.convert arena logs/arena-0 --seed 0 --frames 500 --sensor relative_point
  python -m data.convert arena logs/off --curvature 0.02 --scale -0.1    odometry that errs systematically
""",
    ),
    "circle": World(
        "data.worlds.circle",
        "Circle",
        "circle:0",
        "the circle world of the literature on consistent SLAM, simulated",
        "A simulated robot round and round among landmarks; the defaults are a published benchmark, the same seed gives"
        " the same log.",
        """\
examples:
  python -m data.convert circle logs/circle-0 --seed 0
  python -m data.convert circle logs/short --frames 400 --turn-rate .075 --landmarks 15 --ring 1 --min-range .5
  python -m data.convert circle logs/scattered --layout scatter --map-seed 1 --substeps 3
""",
    ),
    "corridor": World(
        "data.worlds.corridor",
        "Corridor",
        "corridor:0 or corridor:0:people+range=8",
        "the corridor lab on data association, simulated",
        "A simulated robot once round a square of corridors, with people or without; the same seed gives the same log.",
        """\
examples:
  python -m data.convert corridor logs/corridor-0 --seed 0 --people
  python -m data.convert corridor logs/blind --seed 3 --no-odometry
  python -m data.convert corridor logs/narrow --people --crowd 20 --range 8 --min-angle -60 --max-angle 60 --srho .02
""",
    ),
    "floorplan": World(
        "data.worlds.floorplan.world",
        "Floorplan",
        "floorplan:0 or floorplan:0:people+glass+thin=5",
        "rooms and corridors seen by a laser scanner, simulated",
        "A simulated robot with a laser scanner through rooms and corridors, again and again; the same seed gives the"
        " same log.",
        """\
examples:
  python -m data.convert floorplan logs/floorplan-0 --seed 0 --frames 3000
  python -m data.convert floorplan logs/office --seed 3 --people --crowd 20 --glass --max-range 20
""",
    ),
    "linear": World(
        "data.worlds.linear",
        "LinearWorld",
        "linear:0",
        "a simulated world in which every right estimator is consistent",
        "A simulated robot among a grid of landmarks, its heading all but known; the same seed gives the same log.",
        "example:\n  python -m data.convert linear logs/linear-0 --seed 0 --frames 200",
    ),
    "park": World(
        "data.worlds.park",
        "Park",
        "park:0 or park:0:frames=8240",
        "a large log: kilometres of ways among trees, simulated",
        "A simulated robot on a grid of ways among trees, in loops of kilometres; the park grows with the drive, and"
        " the same seed gives the same log.",
        "example:\n  python -m data.convert park logs/park-0 --seed 0 --frames 8240 --spacing 4.5",
    ),
    "walls": World(
        "data.robot.world",
        "Walls",
        "walls:0 or walls:3:room=0",
        "a small robot with sonars along the walls of a room, simulated",
        "A simulated robot with eight sonars and wheel encoders follows the walls of a room, which are the landmarks;"
        " the same seed gives the same log.",
        "example:\n  python -m data.convert walls logs/walls-0 --seed 0 --frames 2400",
    ),
    "visual": World("data.worlds.gallery", "Gallery", "visual:0", counts=("frames",)),
}


class Named(NamedTuple):
    """What a log's name says: the world, its parameters, the seed, and the world's `counts` that were given."""

    world: str
    parameters: Any
    seed: int
    counts: Mapping[str, int]


def parameters_of(world: str) -> type[Any]:
    """The dataclass of a world's parameters."""
    w = SIMULATORS[world]
    found: type[Any] = getattr(importlib.import_module(w.module), w.parameters)
    return found


def simulate(world: str, parameters: Any, seed: int, name: str | None = None) -> Log:
    """One log of a world. Same arguments: same bytes."""
    log: Log = importlib.import_module(SIMULATORS[world].module).simulate(parameters, seed, name)
    return log


def is_simulated(name: str) -> bool:
    """Whether a log's name is that of a simulated one, well-formed or not."""
    world, colon, _ = name.partition(":")
    return bool(colon) and world in SIMULATORS


def parse(name: str) -> Named:
    """What the name of a simulated log says, see `data.worlds.names`. Raises UsageError for what is not understood."""
    world = name.partition(":")[0]
    w = SIMULATORS[world]
    return Named(world, *names.parse(name, parameters_of(world), w.example, counts=w.counts))


def named_log(name: str) -> Log:
    """The log that a name says, under that name; the visual world's is without images.

    Raises UsageError for a name that is not understood, and for counts: they say how much of a recording is read.
    """
    world, parameters, seed, counts = parse(name)
    for key in counts:
        raise UsageError(f"{name}: {key} is for a recording with images")
    return simulate(world, parameters, seed, name)

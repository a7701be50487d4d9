"""The corridor lab: a robot drives once round a square of four corridors; people may walk about, odometry may be off.

World, motion and constants of the university lab on data association built around Neira and Tardos, "Data association
in stochastic mapping using the joint compatibility test", IEEE Trans. Robotics & Automation 17(6), 2001. Unlike the
lab's program, R comes from the measured range and bearing, so that no truth leaks into the inputs.

Odometry noise, sensor noise, the walks of people and the noise of seeing them come from independent streams of the
seed, and noise is drawn for unseen points, too: people, range or angles leave every reading they do not concern as it
was.
"""

from __future__ import annotations

import math
import re
from dataclasses import Field, asdict, dataclass, field, fields
from typing import Any

import numpy as np

from data.errors import UsageError
from data.inputs import CLUTTER, Increments, Inputs, IntArray, LandmarkMap, Observations, Prior, floor_covariances
from data.log import Log
from data.se2 import Array, wrap_angle
from data.sensors import RelativePoint
from data.truth import Truth

SIDE = 10
"""m, and moves of 1 m, from corner to corner."""
ROWS = ((-0.60, range(0, 11, 2)), (-0.35, range(0, 11, 2)), (0.35, range(1, 10, 2)), (0.60, range(1, 10, 2)))
"""A corridor's rows of points in its own frame: y [m], and x [m] of each point."""
QUARTERS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""cos and sin of 0, 90, 180 and 270 degrees, exact."""
SLACK = 1e-9
"""m and rad. Points abreast of the robot stand at the very edge of the view; they are seen, whatever rounding says.
(In the lab's program rounding did decide: its runs see them on three sides of the square, and not on the fourth.)"""
NEAREST = 1e-3
"""m. No range is measured below it: at zero range R is singular."""


def _degrees(value: float) -> float:
    """A field in radians whose value is written in degrees, in a log's name and as a flag."""
    default: float = field(default=math.radians(value), metadata={"unit": "deg"})
    return default


@dataclass(frozen=True)
class Corridor:
    """Parameters of the lab, with its own numbers as defaults. Angles: radians here, degrees in names and flags.

    Attributes:
        people: people walk about and are seen like points.
        odometry: the wheels are read; without, every increment is zero, with the sigmas called blind.
        frames: number of frames; 44 end the first lap, and the motions repeat after that.
        range: m; points as far as this or farther are not seen.
        min_angle, max_angle: deg, bearings between which points are seen, both ends included.
        srho: standard deviation of a range, as a share of that range.
        sphi: deg, standard deviation of a bearing.
        sx_move, sy_move: m, standard deviations of the odometry of a move of 1 m.
        stheta_move: deg, the same of its heading.
        sx_turn, sy_turn: m, standard deviations of the odometry of a turn of 90 deg in place.
        stheta_turn: deg, the same of its heading.
        sx_blind, sy_blind: m, standard deviations claimed for every motion when there is no odometry.
        stheta_blind: deg, the same of its heading.
        crowd: number of people, where there are people.
        sv_people: m per frame, standard deviation of each coordinate of a person's first velocity.
        sa_people: m per frame, standard deviation of that coordinate's change from frame to frame.

    Raises:
        UsageError: a number out of range, or one given a value of its own where it has no effect.
    """

    people: bool = False
    odometry: bool = True
    frames: int = 44
    range: float = 5.0
    min_angle: float = _degrees(-90.0)
    max_angle: float = _degrees(90.0)
    srho: float = 0.01
    sphi: float = _degrees(0.125)
    sx_move: float = 0.01
    sy_move: float = 0.01
    stheta_move: float = _degrees(2.0)
    sx_turn: float = 0.03
    sy_turn: float = 0.03
    stheta_turn: float = _degrees(2.5)
    sx_blind: float = 0.25
    sy_blind: float = 0.10
    stheta_blind: float = _degrees(5.0)
    crowd: int = 10
    sv_people: float = 0.05
    sa_people: float = 0.01

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name in ("frames", "crowd") and value < 1:
                raise UsageError(f"corridor: {f.name} = {value}; at least 1 is needed")
            if f.name in ("range", "srho", "sphi") and not 0.0 < value < math.inf:
                raise UsageError(f"corridor: {f.name} = {_written(f, value)}; a positive number is needed")
            if f.name.startswith(("sx", "sy", "stheta", "sv", "sa")) and not 0.0 <= value < math.inf:
                raise UsageError(f"corridor: {f.name} = {_written(f, value)}; a number from 0 up is needed")
            idle = self._idle(f.name)
            if idle and value != f.default:
                raise UsageError(f"corridor: {f.name} = {_written(f, value)} has no effect {idle}")
        if not -math.pi <= self.min_angle < self.max_angle <= math.pi:
            low, high = (_written(f, getattr(self, f.name)) for f in fields(self) if f.name.endswith("_angle"))
            raise UsageError(
                f"corridor: min_angle = {low}, max_angle = {high}; -180 <= min_angle < max_angle <= 180 is needed"
            )

    def _idle(self, key: str) -> str:
        """Why a constant has no effect; empty if it has one."""
        if key in ("crowd", "sv_people", "sa_people") and not self.people:
            return "without people"
        if key.endswith("_blind") and self.odometry:
            return "with odometry; add no-odometry"
        return "with no-odometry" if key.endswith(("_move", "_turn")) and not self.odometry else ""

    def model(self) -> RelativePoint:
        """The sensor with its field of view."""
        return RelativePoint(max_range=self.range, min_angle=self.min_angle, max_angle=self.max_angle)


def _written(f: Field[Any], value: Any) -> str:
    """A constant as it stands in a log's name."""
    if isinstance(value, float) and f.metadata.get("unit") == "deg":
        short = f"{math.degrees(value):.12g}"
        return short if math.radians(float(short)) == value else repr(math.degrees(value))
    return f"{value:.12g}" if isinstance(value, float) and float(f"{value:.12g}") == value else str(value)


def name_of(corridor: Corridor, seed: int) -> str:
    """The log's name, `corridor:SEED` and what differs from the defaults, in the order of the fields."""
    parts = []
    for f in fields(Corridor):
        value = getattr(corridor, f.name)
        if value != f.default:
            parts.append(("" if value else "no-") + f.name if f.type == "bool" else f"{f.name}={_written(f, value)}")
    return f"corridor:{seed}" + (":" + "+".join(parts) if parts else "")


def parse_name(name: str) -> tuple[Corridor, int]:
    """Parameters and seed from `corridor:SEED` or `corridor:SEED:KEY+KEY=VALUE+...`, angles in degrees.

    Keys are the fields of `Corridor`, whatever their order; the two switches are also `people` and `no-odometry`.

    Raises:
        UsageError: anything not understood, with what would be.
    """
    head, seed, text = (*name.split(":", 2), "", "")[:3]
    if head != "corridor" or not re.fullmatch(r"[0-9]{1,18}", seed):
        raise UsageError(f"{name}: the seed is a whole number, as in corridor:0 or corridor:0:people+range=8")
    values: dict[str, object] = {}
    for part in text.split("+") if len(name.split(":", 2)) == 3 else ():
        key, value = _constant(name, part)
        if key in values:
            raise UsageError(f"{name}: {key} is given twice")
        values[key] = value
    return Corridor(**values), int(seed)  # type: ignore[arg-type]


def _constant(name: str, part: str) -> tuple[str, object]:
    """Field and value from `key=value`, `key` or `no-key`."""
    key, equals, text = part.partition("=")
    key = key.strip().replace("-", "_")
    known = {f.name: f for f in fields(Corridor)}
    if not equals:
        key, text = (key[3:], "off") if key.startswith("no_") else (key, "on")
    if key not in known or (not equals and known[key].type != "bool"):
        what = f"{key} needs a value, as in {key}=1" if key in known else f"{part!r} is not known"
        raise UsageError(f"{name}: {what}; known: people, no-odometry, {', '.join(f'{k}=' for k in list(known)[2:])}")
    f, text = known[key], text.strip()
    if f.type == "bool":
        switch = {"on": True, "true": True, "1": True, "off": False, "false": False, "0": False}
        if text not in switch:
            hint = "; their number is crowd=N" if key == "people" else ""
            raise UsageError(f"{name}: {part}: on or off is needed{hint}")
        return key, switch[text]
    if f.type == "int":
        if not re.fullmatch(r"[0-9]{1,9}", text):
            raise UsageError(f"{name}: {part}: a whole number is needed")
        return key, int(text)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"{name}: {part}: a number is needed")
    return key, math.radians(number) if f.metadata.get("unit") == "deg" else number


def simulate(corridor: Corridor, seed: int, name: str | None = None) -> Log:
    """One log of the corridor. Same parameters and seed: same bytes. The true path and the 88 points never change.

    Observations of a frame come by landmark id (1 to 88), then people (true id -1); frames are numbered, not timed; the
    prior is exact.
    """
    odometry_rng, sensor_rng, walk_rng, people_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)
    )
    truth, turned = _path(corridor.frames)
    increments, floored = _odometry(corridor, turned, odometry_rng)
    known = _world()
    sensor = corridor.model()
    walks = _walks(corridor, walk_rng) if corridor.people else np.empty((corridor.frames, 0, 2))
    frame, true_id, z, R = [], [], [], []
    for k, pose in enumerate(truth):
        for points, ids, rng in (
            (known.xy, known.id, sensor_rng),
            (walks[k], np.full(walks.shape[1], CLUTTER), people_rng),
        ):
            seen, readings, covariances = _look(corridor, sensor, pose, points, rng)
            frame.append(np.full(len(seen), k))
            true_id.append(ids[seen])
            z.append(readings)
            R.append(covariances)
    inputs = Inputs(
        Prior(np.zeros(3), np.zeros((3, 3))),
        np.arange(corridor.frames, dtype=np.float64),
        increments,
        Observations(np.concatenate(frame).astype(np.int64), np.concatenate(z), np.concatenate(R)),
        sensor,
        known,
        time_is_index=True,
        floored=floored,
    )
    return Log(
        name or name_of(corridor, seed),
        inputs,
        Truth(truth, known, np.concatenate(true_id)),
        source={"kind": "corridor", "seed": seed, "corridor": asdict(corridor)},
    )


def _world() -> LandmarkMap:
    """The 88 points: by side, row, and place in the row."""
    side = np.array([(x, y) for y, places in ROWS for x in places], float)
    sides, corner = [], np.zeros(2)
    for c, s in QUARTERS:
        sides.append(corner + side @ np.array([[c, s], [-s, c]]))
        corner = corner + SIDE * np.array([c, s])
    return LandmarkMap(np.arange(1, 4 * len(side) + 1), np.concatenate(sides))


def _path(frames: int) -> tuple[Array, IntArray]:
    """True poses (N, 3), and (N,) 1 where the motion into a frame is a turn of 90 degrees, else 0 (a move of 1 m)."""
    turned = (np.arange(frames) % (SIDE + 1) == 0).astype(np.int64)
    turned[0] = 0
    quarter = np.cumsum(turned)
    # the motion into a frame is along the heading of the frame before, which a move leaves as it is
    step = (1 - turned)[:, None] * np.array(QUARTERS)[quarter % 4]
    step[0] = 0
    return np.column_stack([np.cumsum(step, axis=0), wrap_angle(0.5 * math.pi * (quarter % 4))]), turned


def _odometry(corridor: Corridor, turned: IntArray, rng: np.random.Generator) -> tuple[Increments, int]:
    """Increments as read, and how many got the covariance floor."""
    c = corridor
    if c.odometry:
        move, turn = (c.sx_move, c.sy_move, c.stheta_move), (c.sx_turn, c.sy_turn, c.stheta_turn)
        sigma = np.array([move, turn])[turned]
        exact = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.5 * math.pi]])[turned]
        mean = exact + sigma * rng.standard_normal(sigma.shape)
        mean[0] = 0.0
    else:
        sigma = np.tile([c.sx_blind, c.sy_blind, c.stheta_blind], (len(turned), 1))
        mean = np.zeros(sigma.shape)
    sigma[0] = 0.0
    covariance, floored = floor_covariances(sigma[:, :, None] ** 2 * np.eye(3), Inputs.covariance_floor)
    return Increments(mean, covariance), floored


def _walks(corridor: Corridor, rng: np.random.Generator) -> Array:
    """Where each person is in each frame (N, K, 2); they have made one step by frame 0, and walk through walls."""
    start = rng.uniform(0.0, SIDE, (corridor.crowd, 2))
    velocity = corridor.sv_people * rng.standard_normal((corridor.crowd, 2))
    change = corridor.sa_people * rng.standard_normal((corridor.frames - 1, corridor.crowd, 2))
    walks: Array = start + np.cumsum(np.cumsum(np.concatenate([velocity[None], change]), axis=0), axis=0)
    return walks


def _look(
    corridor: Corridor, sensor: RelativePoint, pose: Array, points: Array, rng: np.random.Generator
) -> tuple[IntArray, Array, Array]:
    """Indices (m,) of the points in view; z (m, 2) and R (m, 2, 2), both from the noisy range and bearing."""
    exact = sensor.predict(pose, points)
    noise = np.array([corridor.srho, corridor.sphi]) * rng.standard_normal((len(points), 2))
    seen = np.flatnonzero(sensor.in_view(exact, margin_range=-SLACK, margin_angle=SLACK))
    polar = sensor.polar(exact[seen])
    r = np.maximum(polar[:, 0] * (1.0 + noise[seen, 0]), NEAREST)
    b = polar[:, 1] + noise[seen, 1]
    direction = np.stack([np.cos(b), np.sin(b)], axis=-1)
    across = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    # R = J J', J with the sigmas in it: d z / d range = direction, d z / d bearing = r across
    J = np.stack([corridor.srho * r[:, None] * direction, corridor.sphi * r[:, None] * across], axis=-1)
    return seen, r[:, None] * direction, J @ np.swapaxes(J, 1, 2)

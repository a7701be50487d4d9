"""Draws a variety of worlds by index: arenas, parks and corridors, their readings, and what is misstated of them.

Of `WORLDS` worlds, those of even index are there to choose settings on, those of odd index to judge them. As many more
come after them: nothing was chosen or judged on these, so they tell how much of what is reached was luck.

Landmarks, readings and clutter come from independent streams of the index. What people were read as stays.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data.inputs import CLUTTER, Increments, Inputs, IntArray, LandmarkMap, Observations
from data.log import Log
from data.motion.velocity import floor_covariances
from data.se2 import Array, wrap_angle
from data.sensors import RANGE_BEARING, Sensor
from data.truth import Truth
from data.worlds import registry
from data.worlds.registry import name_of, named_log

WORLDS = 200
STREAM = 0x7A41E7  # Sets these random numbers apart from those of the worlds, whose seeds are the same indices
KINDS = ("arena", "park", "corridor")
LARGE = 25  # Of so many worlds in a row the last two, one of each half, are large
CHOOSE, JUDGE, LATER = "choose", "judge", "later"
FACTOR = 4.0  # By so much a sigma is misstated at most, up or down


@dataclass(frozen=True)
class Readings:
    sigma_range: float  # sigma_range: m, sigma_bearing: rad, noise as it is
    sigma_bearing: float
    detection: float = 1.0  # probability that a landmark in view is read
    clutter: float = 0.0  # share of the readings that are of no landmark


@dataclass(frozen=True)
class Crowding:
    kept: float = 1.0  # share of the world's landmarks that are there
    paired: float = 0.0  # share of those that get a neighbour
    spacing: float = math.inf  # of a landmark and its neighbour, in sigmas of the sensor at half its range
    most: int = 1000  # landmarks, neighbours included


@dataclass(frozen=True)
class Misstated:
    """Stated as a multiple of what is: sigmas of odometry, ranges and bearings; range and opening angle of the view."""

    odometry: float = 1.0
    range: float = 1.0
    bearing: float = 1.0
    view_range: float = 1.0
    view_angle: float = 1.0


@dataclass(frozen=True)
class Drawn:
    """A world of the variety: the simulated log its path and odometry are from, and everything that is changed."""

    index: int
    name: str
    readings: Readings
    crowding: Crowding
    misstated: Misstated

    @property
    def half(self) -> str:
        return LATER if self.index >= WORLDS else CHOOSE if self.index % 2 == 0 else JUDGE


def indices(half: str | None, worlds: int) -> list[int]:
    """The first `worlds` indices of a half, of both (None), or of those that come later."""
    every = {
        None: range(WORLDS), CHOOSE: range(0, WORLDS, 2), JUDGE: range(1, WORLDS, 2), LATER: range(WORLDS, 2 * WORLDS),
    }[half]  # fmt: skip
    return list(every[:worlds])


def draw(index: int, *, exact: bool = False) -> Drawn:
    """The world of an index, always the same; exact: all as stated, odometry without systematic errors."""
    rng = np.random.default_rng([index, STREAM])
    kind = KINDS[index // 2 % len(KINDS)]
    large = index // 2 % LARGE == LARGE - 1
    readings = Readings(
        _log(rng, 0.02, 0.2), _log(rng, 0.005, 0.04), _linear(rng, 0.5, 1.0, 0.7), _linear(rng, 0.0, 0.2, 0.7)
    )
    crowding = Crowding(
        kept=_log(rng, 0.1, 1.0) if kind == "corridor" else 1.0,
        paired=_linear(rng, 0.05, 0.5) if rng.random() < 0.5 else 0.0,
        spacing=_log(rng, 0.2, 20.0),
    )
    sigmas = (_factor(rng, FACTOR, 0.75) for _ in range(3))
    misstated = Misstated(*sigmas, *(_factor(rng, 1.4, 1 / 3) for _ in range(2)))
    errors, values = _odometry(rng), {"arena": _arena, "park": _park, "corridor": _corridor}[kind](rng, large)
    if exact:
        errors, misstated = {}, Misstated()
    if values.get("people"):
        readings = replace(readings, clutter=0.0)
    name = name_of(kind, registry.parameters_of(kind)(**errors, **values), index)
    return Drawn(index, name, readings, crowding, misstated)


def _odometry(rng: np.random.Generator) -> dict[str, float]:
    """Systematic errors of the odometry, in two worlds of three."""
    limits = {"scale": 0.05, "curvature": 0.02, "left": 0.05, "right": 0.05}
    erring = rng.random() < 2 / 3
    values = {key: _linear(rng, -most, most) for key, most in limits.items()}
    values["drift"] = _linear(rng, 0.0, 0.01, 0.5)
    return values if erring else {}


def _arena(rng: np.random.Generator, large: bool) -> dict[str, object]:
    """5 to 1000 landmarks, about 3 to 12 of them in view."""
    landmarks = 1000 if large else round(_log(rng, 5.0, 400.0))
    apart = _log(rng, 0.6, 1.2 if large else 4.0)
    view = float(rng.choice([90.0, 180.0, 270.0, 360.0]))
    side = max(apart * math.sqrt(landmarks), 6.0)
    reach = side * math.sqrt(_log(rng, 3.0, 12.0) / landmarks * 360.0 / view / math.pi)
    return {
        "landmarks": landmarks, "side": _short(side), "radius": _short(min(max(side / 3.0, 3.0), 15.0)),
        "frames": 600 if large else round(_log(rng, 150.0, 600.0)),
        "max_range": _short(min(max(reach, 2.0), 20.0)),
        "field_of_view": _short(math.radians(view)),
        "sigma_v": _log(rng, 0.02, 0.1), "sigma_omega": _log(rng, 0.005, 0.04),
    }  # fmt: skip


def _park(rng: np.random.Generator, large: bool) -> dict[str, object]:
    return {
        "frames": 2000 if large else round(_log(rng, 200.0, 600.0)), "block": int(rng.integers(20, 41)),
        "spacing": _log(rng, 2.0, 8.0), "max_range": _linear(rng, 8.0, 18.0),
        "field_of_view": float(rng.choice([120.0, 180.0, 360.0])),
        "sigma_v": _log(rng, 0.02, 0.1), "sigma_omega": _log(rng, 0.005, 0.02),
    }  # fmt: skip


def _corridor(rng: np.random.Generator, large: bool) -> dict[str, object]:
    size, turn = _log(rng, 0.5, 2.0), math.radians(_log(rng, 1.0, 3.0))
    return {
        "frames": 440 if large else round(_log(rng, 44.0, 220.0)), "people": bool(rng.random() < 1 / 3),
        "range": _linear(rng, 3.0, 7.0), "sx_move": _short(0.01 * size), "sy_move": _short(0.01 * size),
        "stheta_move": turn, "sx_turn": _short(0.03 * size), "sy_turn": _short(0.03 * size),
        "stheta_turn": turn,
    }  # fmt: skip


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return _short(math.exp(rng.uniform(math.log(low), math.log(high))))


def _linear(rng: np.random.Generator, low: float, high: float, share: float = 1.0) -> float:
    """Uniform in a share of the worlds, in the others the ideal end: 1 if that is the upper one, else the lower."""
    value, drawn = _short(rng.uniform(low, high)), rng.random() < share
    return value if drawn else high if high == 1.0 else low


def _factor(rng: np.random.Generator, most: float, share: float) -> float:
    """From 1 / most to most in a share of the worlds, else 1."""
    value, drawn = _log(rng, 1.0 / most, most), rng.random() < share
    return value if drawn else 1.0


NEAREST = 0.3  # m. Nothing nearer is read


def log_of(drawn: Drawn) -> Log:
    seed = np.random.SeedSequence([drawn.index, STREAM + 1])
    map_rng, sensor_rng, clutter_rng = (np.random.default_rng(s) for s in seed.spawn(3))
    log = named_log(drawn.name)
    r, truth = log.recorded, log.truth
    assert truth.pose is not None
    assert truth.landmarks is not None
    assert truth.landmark_of is not None
    xy = crowded(truth.landmarks.xy, drawn.crowding, sensor_sigma(drawn.readings, r.sensor), map_rng)
    frame, polar, who = _read(r.sensor, truth.pose, xy, drawn.readings, sensor_rng)
    people = truth.landmark_of < 0 if drawn.name.startswith("corridor") else np.zeros(len(truth.landmark_of), bool)
    parts = [
        (frame, polar, who),
        (r.observations.frame[people], r.sensor.polar(r.observations.z[people]), truth.landmark_of[people]),
        _clutter(r.sensor, len(r), len(frame), drawn.readings.clutter, clutter_rng),
    ]
    return as_stated(f"variety-{drawn.index:03d}", drawn, r, truth, xy, parts)


def as_stated(
    name: str, drawn: Drawn, r: Inputs, truth: Truth, xy: Array, parts: Sequence[tuple[IntArray, Array, IntArray]]
) -> Log:
    """The log of these parts (frames (m,), polar readings (m, 2), true ids (m,)), its noise and view as misstated.

    `xy` (L, 2): all landmarks. The part of the name before the hyphen is its kind.
    """
    frame, polar, who = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    order = np.argsort(frame, kind="stable")
    z, R = stated_readings(r.sensor, polar[order], drawn.readings, drawn.misstated)
    u = r.increments
    covariance, floored = floor_covariances(drawn.misstated.odometry**2 * u.covariance, r.covariance_floor)
    known = LandmarkMap(np.arange(len(xy)), xy)
    recorded = replace(
        r, increments=Increments(u.mean, covariance), observations=Observations(frame[order], z, R),
        sensor=stated_sensor(r.sensor, drawn.misstated), map=known, floored=floored,
    )  # fmt: skip
    kind, _, index = name.partition("-")
    source = {"kind": kind, "index": int(index), "of": drawn.name}
    return Log(name, recorded, Truth(truth.pose, known, who[order], errors=truth.errors), source=source)


def sensor_sigma(readings: Readings, sensor: Sensor) -> float:
    """Standard deviation [m] of a landmark's place, per coordinate, read at half the sensor's range."""
    return math.hypot(readings.sigma_range, readings.sigma_bearing * 0.5 * sensor.max_range) / math.sqrt(2.0)


def crowded(xy: Array, crowding: Crowding, sigma: float, rng: np.random.Generator) -> Array:
    """Those of the landmarks (L, 2) that are there, at least five, and after them the neighbours that some get."""
    kept = max(round(crowding.kept * len(xy)), min(5, len(xy)))
    xy = xy[np.sort(rng.permutation(len(xy))[:kept])]
    pairs = min(round(crowding.paired * kept), max(crowding.most - kept, 0))
    chosen, way = rng.permutation(kept)[:pairs], rng.uniform(-math.pi, math.pi, pairs)
    off = crowding.spacing * sigma if pairs else 0.0
    return np.concatenate([xy, xy[chosen] + off * np.stack([np.cos(way), np.sin(way)], axis=1)])


def stated_sensor(sensor: Sensor, misstated: Misstated) -> Sensor:
    half = min(0.5 * (sensor.max_angle - sensor.min_angle) * misstated.view_angle, math.pi)
    if sensor.max_angle - sensor.min_angle >= 2.0 * math.pi - 1e-3:  # what sees all around is not mistaken for less
        half = math.pi
    return replace(sensor, max_range=sensor.max_range * misstated.view_range, min_angle=-half, max_angle=half)


def stated_readings(sensor: Sensor, polar: Array, readings: Readings, misstated: Misstated) -> tuple[Array, Array]:
    """Readings z (M, 2) as the sensor gives them, of ranges and bearings (M, 2) as read, and R (M, 2, 2) as stated."""
    sigma = np.array([readings.sigma_range * misstated.range, readings.sigma_bearing * misstated.bearing])
    if sensor.kind == RANGE_BEARING:
        return polar, np.tile(np.diag(sigma**2), (len(polar), 1, 1))
    r, b = polar.T
    along = np.stack([np.cos(b), np.sin(b)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    J = np.stack([sigma[0] * along, sigma[1] * r[:, None] * across], axis=-1)
    return r[:, None] * along, J @ np.swapaxes(J, 1, 2)


def _read(
    sensor: Sensor, truth: Array, xy: Array, readings: Readings, rng: np.random.Generator
) -> tuple[IntArray, Array, IntArray]:
    """Frames (M,), ranges and bearings (M, 2) and landmarks (M,) of what is read from the true poses (N, 3)."""
    frames, polars, who = [], [], []
    sigma = np.array([readings.sigma_range, readings.sigma_bearing])
    for k, pose in enumerate(truth):
        exact = sensor.predict(pose, xy)
        polar = sensor.polar(exact)
        there = rng.random(len(xy)) < readings.detection
        noise = sigma * rng.standard_normal((len(xy), 2))
        seen = np.flatnonzero(sensor.in_view(exact) & there & (polar[:, 0] >= NEAREST))
        frames.append(np.full(len(seen), k))
        polars.append(_wrapped(polar[seen] + noise[seen]))
        who.append(seen)
    return np.concatenate(frames).astype(np.int64), np.concatenate(polars), np.concatenate(who).astype(np.int64)


def _clutter(
    sensor: Sensor, frames: int, true: int, share: float, rng: np.random.Generator
) -> tuple[IntArray, Array, IntArray]:
    """The same of false readings, uniform over the view, such that they are a share of all beside `true` others."""
    count = rng.poisson(share / (1.0 - share) * true)
    r = sensor.max_range * np.sqrt(rng.uniform((NEAREST / sensor.max_range) ** 2, 1.0, count))
    polar = np.stack([r, rng.uniform(sensor.min_angle, sensor.max_angle, count)], axis=1)
    return rng.integers(frames, size=count), polar, np.full(count, CLUTTER, np.int64)


def _wrapped(polar: Array) -> Array:
    """Ranges and bearings (m, 2) with no range below a tenth of `NEAREST`, bearings in (-pi, pi]."""
    return np.stack([np.maximum(polar[:, 0], 0.1 * NEAREST), wrap_angle(polar[:, 1])], axis=1)

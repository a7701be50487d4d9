"""Worlds where landmarks hide: the variety's paths and odometry, with readings as they are outdoors.

Landmarks have a diameter and hide each other; detection falls with range, differs by landmark, and some landmarks are
read from one side only (a tag). Some are removed half-way, and people stand for a while. The stated view is optimistic.
In every second world noise and odometry are as stated.

Of `WORLDS` worlds those of even index are there to choose on, those of odd index to judge; as many more come after
them, for a last look. `GROVE` is one large log beside them: 299 trees and a laser whose view is stated far too wide.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor
from data.worlds.registry import named_log
from tests.research.variety import worlds as variety
from tests.research.variety.worlds import (
    LATER,
    NEAREST,
    Crowding,
    Drawn,
    Misstated,
    Readings,
    as_stated,
    crowded,
    sensor_sigma,
)

WORLDS = 80
STREAM = 0x41D1  # Sets these random numbers apart from those of the variety
FIRST, EACH = 1000, 48
"""The first path of the variety that is used; of fifty the last two are large, so the first 48 are."""
GROVE = -1  # Index of the large log
REACH = 1.6  # Range in which landmarks are read over that of the variety's sensor: fewer of them are read
FRONT = math.radians(75.0)  # Half the angle from which a landmark with a front is read


@dataclass(frozen=True)
class Hiding:
    diameter: float  # m, median of the landmarks' diameters; they differ by a factor of 1.5 (one sigma)
    half: float  # range at which half of the detections are left, in ranges of the sensor
    uneven: float  # standard deviation of the landmarks' own detection, as logit
    fronted: float  # share of landmarks read from the front only
    removed: float  # share of landmarks removed between 35 and 65 % of the log
    standing: float  # people who stand for 3 to 20 % of the log, as share of the landmarks
    optimistic: float  # stated range over the range in which landmarks are read


@dataclass(frozen=True)
class Hidden:
    """A world: a drawn one of the variety, and how its landmarks hide."""

    index: int
    drawn: Drawn
    hiding: Hiding

    @property
    def kind(self) -> str:
        return "grove" if self.index == GROVE else self.drawn.name.partition(":")[0]


def indices(half: str | None, worlds: int) -> list[int]:
    """The first `worlds` indices of a half, of both (None), or of those that come later."""
    every = {
        None: range(WORLDS), variety.CHOOSE: range(0, WORLDS, 2), variety.JUDGE: range(1, WORLDS, 2),
        LATER: range(WORLDS, 2 * WORLDS),
    }[half]  # fmt: skip
    return list(every[:worlds])


def draw(index: int) -> Hidden:
    if index == GROVE:
        return _grove()
    rng = np.random.default_rng([index, STREAM])
    base = variety.draw(FIRST + 50 * (index // EACH) + index % EACH, exact=index // 2 % 2 == 1)
    tall = rng.random() < 0.7  # landmarks that hide others
    hiding = Hiding(
        diameter=variety._log(rng, 0.1, 0.8) if tall else 0.02,
        half=variety._log(rng, 0.4, 1.5),
        uneven=variety._linear(rng, 0.0, 1.5, 0.7),
        fronted=variety._linear(rng, 0.0, 0.99, 1 / 3),
        removed=variety._linear(rng, 0.0, 0.2, 0.5),
        standing=variety._linear(rng, 0.0, 0.15, 0.5),
        optimistic=variety._linear(rng, 1.01, 2.0) if rng.random() < 0.5 else 1.0,
    )
    readings = replace(base.readings, detection=0.95, clutter=0.5 * base.readings.clutter)
    crowding = replace(base.crowding, paired=0.0)
    return Hidden(index, replace(base, readings=readings, crowding=crowding), hiding)


def _grove() -> Hidden:
    """Seven kilometres among 299 trees; everything but the view is as stated."""
    name = "park:7:frames=6800+block=60+revisits=9.4+spacing=2.408+max_range=80.0+sigma_v=0.02+sigma_omega=0.002"
    base = Drawn(GROVE, name, Readings(0.06, 0.008, detection=0.95, clutter=0.003), Crowding(), Misstated())
    return Hidden(GROVE, base, Hiding(0.6, 0.28, 1.5, 0.0, 0.0, 0.0, 1.2))


def log_of(hidden: Hidden) -> Log:
    drawn, hiding = hidden.drawn, hidden.hiding
    seed = np.random.SeedSequence([hidden.index + 1, STREAM + 1])
    map_rng, sensor_rng, clutter_rng, people_rng = (np.random.default_rng(s) for s in seed.spawn(4))
    log = named_log(drawn.name)
    r, truth = log.recorded, log.truth
    if hidden.index != GROVE:
        r = replace(r, sensor=replace(r.sensor, max_range=REACH * r.sensor.max_range))
    assert truth.pose is not None
    assert truth.landmarks is not None
    xy = crowded(truth.landmarks.xy, drawn.crowding, sensor_sigma(drawn.readings, r.sensor), map_rng)
    people, since, until = _people(truth.pose, xy, hiding.standing, r.sensor.max_range, people_rng)
    there = np.zeros((len(xy) + len(people), 2), np.int64)
    there[:, 1] = len(r)
    gone = map_rng.random(len(xy)) < hiding.removed
    there[: len(xy), 1][gone] = np.rint(map_rng.uniform(0.35, 0.65, int(gone.sum())) * len(r)).astype(np.int64)
    there[len(xy) :] = np.stack([since, until], axis=1)
    frame, polar, who = _read(r.sensor, truth.pose, np.concatenate([xy, people]), there, drawn.readings, hiding,
                              map_rng, sensor_rng)  # fmt: skip
    who[who >= len(xy)] = CLUTTER
    parts = [(frame, polar, who), variety._clutter(r.sensor, len(r), len(frame), drawn.readings.clutter, clutter_rng)]
    made = as_stated(f"hiding-{hidden.index:03d}", drawn, r, truth, xy, parts)
    sensor = made.recorded.sensor
    wider = replace(sensor, max_range=sensor.max_range * hiding.optimistic)
    return replace(made, recorded=replace(made.recorded, sensor=wider))


def world_of(index: int) -> tuple[Log, str]:
    hidden = draw(index)
    return log_of(hidden), hidden.kind


def _people(
    path: Array, xy: Array, share: float, reach: float, rng: np.random.Generator
) -> tuple[Array, IntArray, IntArray]:
    """Where people (p, 2) stand, beside the path, and from which frame (p,) to which."""
    count = round(share * len(xy))
    since = rng.integers(0, max(len(path) - 1, 1), count)
    until = since + np.rint(rng.uniform(0.03, 0.2, count) * len(path)).astype(np.int64)
    way, off = rng.uniform(-math.pi, math.pi, count), rng.uniform(0.2, 0.7, count) * reach
    return path[since, :2] + off[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1), since, until


def _read(
    sensor: Sensor, path: Array, xy: Array, there: IntArray, readings: Readings, hiding: Hiding,
    map_rng: np.random.Generator, sensor_rng: np.random.Generator,
) -> tuple[IntArray, Array, IntArray]:  # fmt: skip
    """Frames (M,), ranges and bearings (M, 2) and things (M,) of what is read of the things (n) from the true path."""
    n = len(xy)
    radius = 0.5 * hiding.diameter * np.exp(math.log(1.5) * map_rng.standard_normal(n))
    own = 1.0 / (1.0 + np.exp(-(1.5 + hiding.uneven * map_rng.standard_normal(n)))) if hiding.uneven else np.ones(n)
    front = map_rng.uniform(-math.pi, math.pi, n)
    fronted = map_rng.random(n) < hiding.fronted
    sigma = np.array([readings.sigma_range, readings.sigma_bearing])
    frames, polars, who = [], [], []
    for k, pose in enumerate(path):
        exact = sensor.predict(pose, xy)
        polar = sensor.polar(exact)
        r, b = polar.T
        here = (there[:, 0] <= k) & (k < there[:, 1])
        falling = 1.0 / (1.0 + (r / (hiding.half * sensor.max_range)) ** 4)
        drawn = sensor_rng.random(n) < readings.detection * own * falling
        noise = sigma * sensor_rng.standard_normal((n, 2))
        side = wrap_angle(np.arctan2(pose[1] - xy[:, 1], pose[0] - xy[:, 0]) - front)
        shown = ~fronted | (np.abs(side) < FRONT)
        inside = sensor.in_view(exact) & here & (r >= NEAREST)
        seen = np.flatnonzero(inside & drawn & shown & ~_hidden(r, b, radius, here))
        frames.append(np.full(len(seen), k))
        polars.append(variety._wrapped(polar[seen] + noise[seen]))
        who.append(seen)
    return np.concatenate(frames).astype(np.int64), np.concatenate(polars), np.concatenate(who).astype(np.int64)


def _hidden(r: Array, b: Array, radius: Array, here: BoolArray) -> BoolArray:
    """Whether the centre of each thing (n,) is behind a nearer one."""
    half = np.arcsin(np.minimum(radius / np.maximum(r, 1e-6), 1.0))
    before = (np.abs(wrap_angle(b[None, :] - b[:, None])) < half[None, :]) & (r[None, :] < r[:, None]) & here[None, :]
    hidden: BoolArray = before.any(axis=1)
    return hidden

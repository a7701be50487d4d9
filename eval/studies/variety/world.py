"""The log of a world of the variety: a simulated robot's path and odometry, readings made anew, and what is misstated.

Landmarks, readings and clutter come from independent streams of the index. What people were read as stays.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from data.inputs import CLUTTER, Increments, IntArray, LandmarkMap, Observations
from data.log import Log
from data.motion.floor import floor_covariances
from data.se2 import Array, wrap_angle
from data.sensors import RANGE_BEARING, Sensor
from data.truth import Truth
from data.worlds.registry import named_log
from eval.studies.variety.draw import STREAM, Crowding, Drawn, Misstated, Readings

NEAREST = 0.3
"""m. Nothing nearer is read."""


def log_of(drawn: Drawn) -> Log:
    """The log, called `variety-INDEX`. Same world: same bytes."""
    seed = np.random.SeedSequence([drawn.index, STREAM + 1])
    map_rng, sensor_rng, clutter_rng = (np.random.default_rng(s) for s in seed.spawn(3))
    log = named_log(drawn.name)
    r, truth = log.recorded, log.truth
    assert truth.pose is not None
    assert truth.landmarks is not None
    assert truth.landmark_of is not None
    sigma = sensor_sigma(drawn.readings, r.sensor)
    xy = crowded(truth.landmarks.xy, drawn.crowding, sigma, map_rng)
    frame, polar, who = _read(r.sensor, truth.pose, xy, drawn.readings, sensor_rng)
    people = truth.landmark_of < 0 if drawn.name.startswith("corridor") else np.zeros(len(truth.landmark_of), bool)
    parts = [
        (frame, polar, who),
        (r.observations.frame[people], r.sensor.polar(r.observations.z[people]), truth.landmark_of[people]),
        _clutter(r.sensor, len(r), len(frame), drawn.readings.clutter, clutter_rng),
    ]
    frame, polar, who = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    order = np.argsort(frame, kind="stable")
    z, R = stated_readings(r.sensor, polar[order], drawn.readings, drawn.misstated)
    u = r.increments
    covariance, floored = floor_covariances(drawn.misstated.odometry**2 * u.covariance, r.covariance_floor)
    known = LandmarkMap(np.arange(len(xy)), xy)
    recorded = replace(
        r,
        increments=Increments(u.mean, covariance),
        observations=Observations(frame[order], z, R),
        sensor=stated_sensor(r.sensor, drawn.misstated),
        map=known,
        floored=floored,
    )
    return Log(
        f"variety-{drawn.index:03d}",
        recorded,
        Truth(truth.pose, known, who[order], errors=truth.errors),
        source={"kind": "variety", "index": drawn.index, "of": drawn.name},
    )


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
    """The sensor with the view that is stated of it."""
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

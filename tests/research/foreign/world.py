"""`make`: one log of a foreign world, sound or with one fault. Same arguments, same bytes.

Written apart from `data.worlds`. The stated covariances of a sound log are the true ones, and an increment's error is
added in the body frame, as the estimators take it. Path, landmarks, odometry, readings and faults have streams of
their own, so a fault leaves all else as it is in the sound log of the seed.
"""

import math
import zlib

import numpy as np

from data import se2
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.se2 import Array
from data.sensors import RangeBearing, RelativePoint, Sensor
from data.truth import Truth
from data.worlds.registry import named_log
from tests.research.foreign import faults
from tests.research.foreign.shapes import SHAPES, Drive, Generator, Shape, places

DETECTED = 0.93  # Probability that a landmark in view is read
LEAST, MOST = 0.7, 2.2
"""Factors of a shape's sigmas, one for each of odometry and both coordinates: robots are better and worse."""
STILL = 1e-3  # s and m under the roots of odometry's noise, so that no covariance is singular


def make(shape: str, seed: int, fault: str | None = None, strength: float = 1.0) -> Log:
    """The log of a shape and seed; `fault`: a key of `faults.FAULTS`, None for a sound log."""
    if shape not in SHAPES:  # a sound log of ours, such as of `arena:frames=80`
        kind, _, values = shape.partition(":")
        return named_log(":".join(filter(None, (kind, str(seed), values))))
    form = SHAPES[shape]
    size = faults.FAULTS[fault].of(strength) if fault is not None else 0.0
    streams = np.random.SeedSequence([seed, zlib.crc32(shape.encode())]).spawn(6)
    way, ground, wheels, eyes, start, wrong = (np.random.default_rng(s) for s in streams)
    quality = np.exp(ground.uniform(math.log(LEAST), math.log(MOST), 3))
    sigma = np.array(form.sigma) * (quality[:2] if form.polar else quality[0])
    drift = np.array([form.along, form.across, form.turn]) * quality[2]
    drive = Drive(form, way)
    time = np.arange(int(drive.seconds * form.rate)) / form.rate
    driven = drive.at(time)
    landmarks = places(form, driven, ground)
    ids = 11 + 3 * np.arange(len(landmarks))

    pose = faults.on_path(fault, size, driven, form, wrong)
    increments = _odometry(fault, size, drive, time, drift, wheels, wrong)
    late = faults.lateness(fault, size, time)
    # where readings are made: only lateness parts it from the pose of the frame
    reading = pose if not late.any() else drive.at(time - late)
    frame, row, z = _seen(form, reading, landmarks, faults.sensor_at(fault, size, form, wrong), eyes)
    z = faults.on_exact(fault, size, z, form.polar)
    plain = fault in ("tails", "range-sigma", "sensor-sigma", "sensor-sigma-half", "noisy-stretch", "outliers", "ar1")
    z += sigma * faults.noise(fault, size, frame, ids[row], len(time), wrong if plain else eyes)
    if form.polar:
        z[:, 0], z[:, 1] = np.abs(z[:, 0]), se2.wrap_angle(z[:, 1])
    who = ids[row].astype(np.int64)

    true_map = LandmarkMap(ids, landmarks)
    known = faults.on_map(fault, size, true_map, who, form, wrong)
    inputs = Inputs(
        _prior(form, pose[0], start), time, increments,
        Observations(frame, z, np.tile(np.diag(np.broadcast_to(sigma, 2) ** 2), (len(z), 1, 1))), sensor_of(form),
        known,
    )  # fmt: skip
    name = f"foreign-{shape}:{seed}" + ("" if fault is None else f":{fault}={strength:g}")
    source = {"kind": f"foreign-{shape}", "seed": seed, "fault": fault or "none", "strength": strength}
    return Log(name, inputs, Truth(pose, true_map, who), faults.labels(fault, size, who, wrong), source=source)


def sensor_of(shape: Shape) -> Sensor:
    kind = RangeBearing if shape.polar else RelativePoint
    half = 0.5 * shape.view
    return kind(shape.reach, -half, half, translation=(-shape.mount, 0.0))


def _odometry(
    fault: str | None, size: float, drive: Drive, time: Array, drift: Array, rng: Generator, wrong: Generator
) -> Increments:
    """Increments with the noise of their stated covariances, or more."""
    true = np.zeros((len(time), 3))
    driven = drive.at(time)
    true[1:] = se2.between(driven[:-1], driven[1:])
    far, dt = np.hypot(true[:, 0], true[:, 1]), np.diff(time, prepend=time[0])
    spread = np.stack([np.sqrt(far + STILL * drive.speed)] * 2 + [np.sqrt(dt + STILL)], 1) * drift
    mean = faults.on_motion(fault, size, drive, time, wrong)
    mean += (size if fault == "odometry-sigma" else 1.0) * spread * rng.standard_normal((len(time), 3))
    mean[:, 2] = se2.wrap_angle(mean[:, 2])
    covariance = np.zeros((len(time), 3, 3))
    covariance[:, range(3), range(3)] = spread**2
    mean[0], covariance[0] = 0.0, 0.0
    return Increments(mean, covariance)


def _seen(
    shape: Shape, pose: Array, landmarks: Array, aside: Array, rng: Generator
) -> tuple[IntArray, IntArray, Array]:
    """Frame (M,), row of the landmark (M,) and reading without noise (M, 2), in the order of frames."""
    eye = np.array([shape.mount, 0.0]) + aside
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    at = pose[:, :2] + np.stack([c * eye[0] - s * eye[1], s * eye[0] + c * eye[1]], 1)
    to = landmarks[None] - at[:, None]
    ahead, left = c[:, None] * to[..., 0] + s[:, None] * to[..., 1], c[:, None] * to[..., 1] - s[:, None] * to[..., 0]
    distance, bearing = np.hypot(ahead, left), np.arctan2(left, ahead)
    seen = (distance <= shape.reach) & (np.abs(bearing) <= 0.5 * shape.view) & (rng.random(to.shape[:2]) < DETECTED)
    seen &= distance > 0.02 * shape.reach
    frame, row = np.nonzero(seen)
    pair = (distance, bearing) if shape.polar else (ahead, left)
    return frame.astype(np.int64), row.astype(np.int64), np.stack([p[seen] for p in pair], 1)


def _prior(shape: Shape, pose: Array, rng: Generator) -> Prior:
    """A prior whose error has its covariance: 3 cm of a unit and half a degree."""
    sigma = np.array([0.03 * shape.unit, 0.03 * shape.unit, math.radians(0.5)])
    mean = pose + sigma * rng.standard_normal(3)
    mean[2] = se2.wrap_angle(mean[2])
    return Prior(mean, np.diag(sigma**2))

"""The tutorial world: a unicycle robot drives loops among point landmarks; every noise is known.

The true path is noise-free and the same for every seed. Map, odometry noise, sensor noise and the prior's error come
from independent streams of the seed, so changing one parameter leaves the others' draws alone.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from data import se2
from data.inputs import CLUTTER, Inputs, IntArray, LandmarkMap, Observations
from data.log import Log
from data.se2 import Array
from data.sensors import RangeBearing, RelativePoint, Sensor
from data.truth import Truth
from data.worlds import parameters
from data.worlds.parameters import told


@dataclass(frozen=True)
class Arena(parameters.Imperfect):
    """Parameters of the world; with the defaults linearization errors are small."""

    landmarks: int = told(25, "number of point landmarks, uniform in a square")
    side: float = told(24.0, "m, side of that square, centred on the loop")
    frames: int = told(200, "number of frames")
    period: float = told(0.5, "s between frames")
    odometry_rate: float = told(10.0, "Hz of the (v, omega) samples")
    speed: float = told(1.0, "m/s")
    radius: float = told(6.0, "m, of the loop the robot drives; its turn rate swings about speed / radius")
    swing: float = told(0.3, "rad/s, amplitude of that swing")
    sigma_v: float = told(0.05, "m per sqrt(s)")
    sigma_omega: float = told(0.02, "rad per sqrt(s), odometry noise densities")
    sensor: str = told("range_bearing", "range_bearing or relative_point")
    sigma_range: float = told(0.1, "m")
    sigma_bearing: float = told(0.02, "rad, noise of the range-bearing sensor")
    sigma_point: float = told(0.1, "m, noise of each coordinate of the Cartesian sensor")
    min_range: float = told(0.5, "m; nothing nearer or farther is reported")
    max_range: float = told(8.0, "m; nothing nearer or farther is reported")
    field_of_view: float = told(2.0 * math.pi, "rad, full opening angle")
    prior_sigma: float = told(0.1, "m")
    prior_sigma_heading: float = told(0.03, "rad; the prior mean is drawn with them")
    detection: float = told(1.0, "probability that a landmark in view is reported", most="probability")
    clutter: float = told(0.0, "mean number of false alarms per frame (Poisson), uniform over the field of view")
    sigma_map: float = told(
        0.0, "m, error of the map in x and y of each landmark, which the map states; 0: it is exact"
    )

    positive: ClassVar[tuple[str, ...]] = (
        *("landmarks", "frames", "side", "period", "odometry_rate", "radius", "max_range", "field_of_view"),
        *("sigma_range", "sigma_bearing", "sigma_point"),
    )
    signed: ClassVar[tuple[str, ...]] = ("speed", "swing")
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"sensor": ("range_bearing", "relative_point")}

    def __post_init__(self) -> None:
        world = type(self).__name__.lower()
        parameters.check_parameters(world, self, positive=self.positive, signed=self.signed, choices=self.choices)

    def model(self) -> Sensor:
        """The sensor with its field of view."""
        kind = RangeBearing if self.sensor == "range_bearing" else RelativePoint
        half = min(0.5 * self.field_of_view, math.pi)
        return kind(max_range=self.max_range, min_angle=-half, max_angle=half)

    def sigma(self) -> tuple[float, float]:
        """Standard deviations of an observation's two coordinates."""
        polar = self.sensor == "range_bearing"
        return (self.sigma_range, self.sigma_bearing) if polar else (self.sigma_point, self.sigma_point)


def simulate(arena: Arena, seed: int, name: str | None = None) -> Log:
    """One log of the arena. Same parameters and seed: same bytes."""
    map_rng, odometry_rng, sensor_rng, prior_rng = parameters.streams(seed, 4)
    centre = np.array([0.0, arena.radius])
    landmarks = centre + map_rng.uniform(-0.5 * arena.side, 0.5 * arena.side, (arena.landmarks, 2))
    frame_time = arena.period * np.arange(arena.frames, dtype=np.float64)
    dt = 1.0 / arena.odometry_rate  # True poses (N, 3) at the frames and the noisy increments between them
    time = dt * np.arange(math.ceil(frame_time[-1] / dt) + 1)
    v = np.full(len(time), arena.speed)
    omega = arena.speed / arena.radius + arena.swing * np.sin(2.0 * math.pi * time / 15.0)
    density = (arena.sigma_v, arena.sigma_omega)
    truth, increments, floored = parameters.driven(dt, v, omega, frame_time, np.zeros(3), density, odometry_rng)
    increments, errors = parameters.reported(arena, increments, seed)
    sensor = arena.model()
    frame, z, true_id = observe(arena, sensor, truth, landmarks, sensor_rng)
    R = np.tile(np.diag(np.square(arena.sigma())), (len(z), 1, 1))
    known = LandmarkMap(np.arange(arena.landmarks), landmarks)
    prior = parameters.drawn_prior(truth[0], arena.prior_sigma, arena.prior_sigma_heading, prior_rng)
    inputs = Inputs(prior, frame_time, increments, Observations(frame, z, R), sensor, known, floored=floored)
    truth_side = Truth(truth, known, true_id, errors=errors)
    log = Log(name or f"arena:{seed}", inputs, truth_side, source={"kind": "arena", "seed": seed})
    return parameters.surveyed(parameters.dressed(arena, log, seed), arena.sigma_map, seed)


def observe(
    arena: Arena, sensor: Sensor, truth: Array, landmarks: Array, rng: np.random.Generator
) -> tuple[IntArray, Array, IntArray]:
    """Frames (M,), observations (M, 2) and true ids (M,), by frame and landmark, false alarms last in a frame."""
    frames, readings, ids = [], [], []
    sigma = np.array(arena.sigma())
    for k, pose in enumerate(truth):
        exact = sensor.predict(pose, landmarks)
        reported = rng.random(len(landmarks)) < arena.detection
        near = sensor.polar(exact)[:, 0] < arena.min_range
        seen = np.flatnonzero(sensor.in_view(exact) & reported & ~near)
        z = parameters.as_read(arena, sensor, exact[seen]) + sigma * rng.standard_normal((len(seen), 2))
        false = rng.poisson(arena.clutter)
        r = arena.max_range * np.sqrt(rng.uniform((arena.min_range / arena.max_range) ** 2, 1.0, false))
        b = rng.uniform(sensor.min_angle, sensor.max_angle, false)
        ghost = np.stack([r, b], 1) if arena.sensor == "range_bearing" else np.stack([r * np.cos(b), r * np.sin(b)], 1)
        z = np.concatenate([z, ghost])
        if arena.sensor == "range_bearing":
            z[:, 0] = np.maximum(z[:, 0], 0.0)
            z[:, 1] = se2.wrap_angle(z[:, 1])
        frames.append(np.full(len(z), k))
        readings.append(z)
        ids.append(np.concatenate([seen, np.full(false, CLUTTER)]))
    return np.concatenate(frames).astype(np.int64), np.concatenate(readings), np.concatenate(ids).astype(np.int64)

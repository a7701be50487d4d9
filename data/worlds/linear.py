"""A practically linear Gaussian world: every correct estimator must be consistent in it.

A robot drives a figure of eight in a grid of landmarks, observed as points in its own frame. Position errors (5 cm per
step) are small against distances (some 80 m), and heading is almost known (3e-5 rad at the start and per step), so
linearization neglects some 3e-4 of a standard deviation (up to 3e-3 in the heading of a SLAM filter). Such distant
landmarks make heading observable within ten frames; otherwise a run's mean NEES would be little more than one sample.

Noise is drawn exactly from the stated covariances. The true path is the same for every seed; odometry noise, sensor
noise and the prior's error come from independent streams of the seed.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from data import se2
from data.inputs import Increments, Inputs, LandmarkMap, Observations
from data.log import Log
from data.motion.velocity import floor_covariances
from data.se2 import Array
from data.sensors import RelativePoint
from data.truth import Truth
from data.worlds.parameters import check_parameters, drawn_prior, streams, told


@dataclass(frozen=True)
class LinearWorld:
    """Parameters of the world; larger heading sigmas make it nonlinear. UsageError for an invalid value."""

    frames: int = told(100, "number of frames")
    period: float = told(1.0, "s between frames")
    laps: float = told(2.0, "number of laps of the figure of eight")
    half_length: float = told(120.0, "m, half the extent of the figure of eight along x and y")
    half_width: float = told(80.0, "m, half the extent of the figure of eight along x and y")
    rows: int = told(5, "of the grid of landmarks, which has its centre where the path crosses itself")
    columns: int = told(6, "of the grid of landmarks, which has its centre where the path crosses itself")
    spacing: float = told(50.0, "m, between neighbours of the grid")
    max_range: float = told(120.0, "m; nearer landmarks are observed, in any direction")
    sigma_odometry: float = told(0.05, "m, noise of each coordinate of a step")
    sigma_turn: float = told(3e-5, "rad, noise of a step's turn; below 1e-5 the covariance floor of 1e-10 applies")
    sigma_point: float = told(0.1, "m, noise of each coordinate of an observed point")
    prior_sigma: float = told(0.01, "m")
    prior_sigma_heading: float = told(3e-5, "rad; the prior mean is drawn with them")

    def __post_init__(self) -> None:
        layout = ("frames", "period", "laps", "half_length", "half_width", "rows", "columns", "spacing")
        check_parameters("linear", self, positive=(*layout, "max_range", "sigma_point"))


def simulate(world: LinearWorld, seed: int, name: str | None = None) -> Log:
    """One log of the linear world, reproducible to the byte; labels are the true ids, ascending in each frame."""
    odometry_rng, sensor_rng, prior_rng = streams(seed, 3)
    # True poses (N, 3) on x = a sin(u), y = b sin(2 u), heading along the path.
    u = 2.0 * math.pi * world.laps * np.arange(world.frames) / world.frames
    a, b = world.half_length, world.half_width
    heading = np.arctan2(2.0 * b * np.cos(2.0 * u), a * np.cos(u))
    x = world.spacing * (np.arange(world.columns) - 0.5 * (world.columns - 1))  # Landmarks, row by row
    y = world.spacing * (np.arange(world.rows) - 0.5 * (world.rows - 1))
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    truth, known = np.column_stack([a * np.sin(u), b * np.sin(2.0 * u), heading]), LandmarkMap(np.arange(len(xy)), xy)
    increments, floored = _odometry(world, truth, odometry_rng)
    sensor = RelativePoint(max_range=world.max_range)
    exact = np.stack([sensor.predict(pose, known.xy) for pose in truth])
    noisy = exact + world.sigma_point * sensor_rng.standard_normal(exact.shape)
    frame, ids = np.nonzero(np.hypot(exact[..., 0], exact[..., 1]) < world.max_range)
    R = np.tile(world.sigma_point**2 * np.eye(2), (len(frame), 1, 1))
    inputs = Inputs(
        drawn_prior(truth[0], world.prior_sigma, world.prior_sigma_heading, prior_rng),
        world.period * np.arange(world.frames, dtype=np.float64), increments,
        Observations(frame, noisy[frame, ids], R), sensor, known, floored=floored,
    )  # fmt: skip
    source = {"kind": "linear", "seed": seed, "linear": asdict(world)}
    return Log(name or f"linear:{seed}", inputs, Truth(truth, known, ids), source=source)


def _odometry(world: LinearWorld, truth: Array, rng: np.random.Generator) -> tuple[Increments, int]:
    """True increments with noise of their stated covariance, and how many got the covariance floor."""
    variance = np.square([world.sigma_odometry, world.sigma_odometry, world.sigma_turn])
    covariance = np.tile(np.diag(variance), (world.frames, 1, 1))
    covariance[0] = 0.0
    covariance, floored = floor_covariances(covariance, Inputs.covariance_floor)
    mean = np.zeros((world.frames, 3))
    sigma = np.sqrt(np.einsum("nii->ni", covariance[1:]))
    mean[1:] = se2.between(truth[:-1], truth[1:]) + sigma * rng.standard_normal(sigma.shape)
    mean[:, 2] = se2.wrap_angle(mean[:, 2])
    return Increments(mean, covariance), floored

"""The circle world of the SLAM consistency literature: a robot drives circles among landmarks near it.

The true path is noise-free, in straight steps (Euler): p += R(theta) [speed period, 0], theta += turn_rate period.
Speed and turn rate are measured with independent noise per step, landmarks as points in the robot's frame. The defaults
are the 2D SLAM benchmark of Brossard, Barrau, Bonnabel, "A code for unscented Kalman filtering on manifolds", ICRA
2020; other parameters give those of Brossard, Barrau, Bonnabel, IEEE Sensors Journal 19(4), 2019.

Odometry noise, sensor noise and the prior's error come from independent streams of the seed, and noise is drawn for
unseen landmarks, too, so noise, view or number of frames leave other draws alone.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from data.errors import UsageError
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations
from data.log import Log
from data.motion.velocity import floor_covariances
from data.se2 import Array, wrap_angle
from data.sensors import RelativePoint
from data.truth import Truth
from data.worlds.parameters import check_parameters, drawn_prior, streams, told

_CHOICES = {"heading_noise": ("after", "before"), "speed_noise": ("start", "end")}


@dataclass(frozen=True)
class Circle:
    """Parameters of the world. UsageError for an invalid value. Published filters differ in `heading_noise` and
    `speed_noise`, which change the stated covariance of the increments, not the measurements.
    """

    frames: int = told(2500, "number of frames; nothing is observed in the first")
    period: float = told(1.0, "s between frames")
    speed: float = told(0.25, "m/s, true speed")
    turn_rate: float = told(math.radians(1.5), "rad/s, true turn rate; the path's radius is speed / turn_rate")
    sigma_speed: float = told(0.05 * 0.25 / math.sqrt(2.0), "m/s, noise of the measured speed of a step")
    sigma_turn: float = told(0.05 * 0.25 * math.sqrt(8.0), "rad/s, noise of the measured turn rate of a step")
    sigma_point: float = told(0.1, "m, noise of each coordinate of an observed point")
    landmarks: int = told(20, "number of landmarks, at equal angles on one circle")
    ring: float = told(3.0, "m, radius of the landmarks' circle minus that of the path")
    centre_x: float = told(0.0, "m, centre of the landmarks")
    centre_y: float | None = told(
        None, "m, centre of the landmarks", default="speed / turn_rate, the centre of the path"
    )
    min_range: float = told(1.0, "m; landmarks are observed between these distances, both excluded")
    max_range: float = told(5.0, "m; landmarks are observed between these distances, both excluded")
    prior_sigma: float = told(0.0, "m and rad; the prior mean is drawn with it, 0 is an exact start")
    heading_noise: str = told(
        "after",
        "after, a step's heading noise does not affect its translation (exact for this motion), or before, it turns "
        "the translation, too",
    )  # fmt: skip
    speed_noise: str = told(
        "start", "the noise of the speed acts along the heading at the start or at the end of a step"
    )
    covariance_floor: float = told(1e-10, "smallest eigenvalue of an increment's covariance; 0 for none (filters only)")

    def __post_init__(self) -> None:
        positive = ("frames", "period", "speed", "turn_rate", "sigma_point", "landmarks", "max_range")
        check_parameters("circle", self, positive=positive, signed=("ring", "centre_x", "centre_y"), choices=_CHOICES)
        if not self.min_range < self.max_range:
            ranges = f"min_range = {self.min_range}, max_range = {self.max_range}"
            raise UsageError(f"circle: {ranges}; min_range < max_range is needed")
        if not self.radius + self.ring > 0:
            raise UsageError(f"circle: ring = {self.ring}; more than -{self.radius} is needed, the radius of the path")

    @property
    def radius(self) -> float:
        """Radius of the path [m]."""
        return self.speed / self.turn_rate


def simulate(circle: Circle, seed: int, name: str | None = None) -> Log:
    """One log of the circle world, reproducible to the byte; labels are the true ids, ascending in each frame."""
    odometry_rng, sensor_rng, prior_rng = streams(seed, 3)
    theta = circle.turn_rate * circle.period * np.arange(circle.frames, dtype=np.float64)  # True poses (N, 3)
    step = circle.speed * circle.period * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    truth = np.zeros((circle.frames, 3))
    truth[1:, :2] = np.cumsum(step[:-1], axis=0)
    truth[:, 2] = wrap_angle(theta)
    angle = 2.0 * math.pi * np.arange(circle.landmarks) / circle.landmarks  # The map
    centre = np.array([circle.centre_x, circle.radius if circle.centre_y is None else circle.centre_y])
    xy = centre + (circle.radius + circle.ring) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    known = LandmarkMap(np.arange(circle.landmarks), xy)
    increments, floored = _odometry(circle, odometry_rng)
    frame, ids, z = _observe(circle, truth, known.xy, sensor_rng)
    R = np.tile(circle.sigma_point**2 * np.eye(2), (len(z), 1, 1))
    inputs = Inputs(
        drawn_prior(truth[0], circle.prior_sigma, circle.prior_sigma, prior_rng),
        circle.period * np.arange(circle.frames, dtype=np.float64), increments, Observations(frame, z, R),
        RelativePoint(max_range=circle.max_range), known, covariance_floor=circle.covariance_floor, floored=floored,
    )  # fmt: skip
    source = {"kind": "circle", "seed": seed, "circle": asdict(circle)}
    return Log(name or f"circle:{seed}", inputs, Truth(truth, known, ids), source=source)


def _odometry(circle: Circle, rng: np.random.Generator) -> tuple[Increments, int]:
    """Increments as measured, and how many got the covariance floor."""
    sigma = np.array([circle.sigma_speed, circle.sigma_turn])
    measured = np.array([circle.speed, circle.turn_rate]) + sigma * rng.standard_normal((circle.frames - 1, 2))
    mean, covariance = np.zeros((circle.frames, 3)), np.zeros((circle.frames, 3, 3))
    mean[1:, 0], mean[1:, 2] = circle.period * measured.T
    # covariance G Q G' in the body frame at a step's start, with G = [h [cos a, sin a, 0], h [0, 0, 1]], h the length
    # of a step and a the heading of the speed's noise; heading noise `before` the translation turns it by v h
    h = circle.period
    v, omega = measured.T
    along = h * omega if circle.speed_noise == "end" else np.zeros(len(v))
    G = np.zeros((len(v), 3, 2))
    G[:, 0, 0], G[:, 1, 0], G[:, 2, 1] = h * np.cos(along), h * np.sin(along), h
    if circle.heading_noise == "before":
        G[:, 1, 1] = h * (v * h)
    P = G @ (sigma**2 * np.eye(2)) @ np.swapaxes(G, 1, 2)
    covariance[1:] = 0.5 * (P + np.swapaxes(P, 1, 2))
    covariance, floored = floor_covariances(covariance, circle.covariance_floor)
    return Increments(mean, covariance), floored


def _observe(circle: Circle, truth: Array, xy: Array, rng: np.random.Generator) -> tuple[IntArray, IntArray, Array]:
    """Frame (M,), landmark id (M,) and observation (M, 2), by frame and id."""
    c, s = np.cos(truth[:, None, 2]), np.sin(truth[:, None, 2])
    dx, dy = np.moveaxis(xy - truth[:, None, :2], 2, 0)
    distance = np.hypot(dx, dy)
    exact = np.stack([c * dx + s * dy, -s * dx + c * dy], axis=2)
    z = exact + circle.sigma_point * rng.standard_normal(exact.shape)
    seen = (circle.min_range < distance) & (distance < circle.max_range)
    seen[0] = False
    frame, ids = np.nonzero(seen)
    return frame.astype(np.int64), ids.astype(np.int64), z[seen]

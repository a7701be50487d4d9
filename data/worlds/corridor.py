"""The corridor lab: a robot drives round a square of four corridors; people may walk about, odometry may be off.

World (88 points), motion and constants of a university lab on data association based on Neira and Tardos, "Data
association in stochastic mapping using the joint compatibility test", IEEE Trans. Robotics & Automation 17(6), 2001.
Unlike in the lab's program, R depends on the measured range and bearing, so no truth enters the inputs.

Odometry noise, sensor noise, the walks of people and the noise of observing them come from independent streams of the
seed, and noise is drawn for unseen points, too: people, range or angles leave other observations unchanged.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from data.errors import UsageError
from data.inputs import CLUTTER, Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.motion_prior import ConstantVelocityPrior, ForwardPrior, MotionPrior, note_of
from data.motion.velocity import floor_covariances
from data.se2 import Array, wrap_angle
from data.sensors import RelativePoint
from data.truth import Truth
from data.worlds import parameters
from data.worlds.parameters import in_degrees, told
from data.worlds.registry import name_of, written

SIDE = 10  # m, and number of moves, from corner to corner
ROWS = ((-0.60, range(0, 11, 2)), (-0.35, range(0, 11, 2)), (0.35, range(1, 10, 2)), (0.60, range(1, 10, 2)))
"""A corridor's rows of points in its own frame: y [m], and x [m] of each point."""
QUARTERS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # cos and sin of 0, 90, 180 and 270 degrees, exact


def points() -> LandmarkMap:
    """The 88 points: by side, row, and place in the row."""
    side = np.array([(x, y) for y, places in ROWS for x in places], float)
    sides, corner = [], np.zeros(2)
    for c, s in QUARTERS:
        sides.append(corner + side @ np.array([[c, s], [-s, c]]))
        corner = corner + SIDE * np.array([c, s])
    return LandmarkMap(np.arange(1, 4 * len(side) + 1), np.concatenate(sides))


def path(frames: int) -> tuple[Array, IntArray]:
    """True poses (N, 3), and (N,) 1 where the motion into a frame is a turn of 90 degrees, else 0 (a move of 1 m)."""
    turned = (np.arange(frames) % (SIDE + 1) == 0).astype(np.int64)
    turned[0] = 0
    quarter = np.cumsum(turned)
    # the motion into a frame is along the heading of the frame before, which a move does not change
    step = (1 - turned)[:, None] * np.array(QUARTERS)[quarter % 4]
    step[0] = 0
    return np.column_stack([np.cumsum(step, axis=0), wrap_angle(0.5 * math.pi * (quarter % 4))]), turned


def walks(frames: int, crowd: int, sv: float, sa: float, rng: np.random.Generator) -> Array:
    """Positions (N, K, 2) of people in each frame, after one step in frame 0; they walk through walls. sv, sa: m per
    frame, standard deviations of a coordinate's first velocity and of its change.
    """
    start = rng.uniform(0.0, SIDE, (crowd, 2))
    velocity = sv * rng.standard_normal((crowd, 2))
    change = sa * rng.standard_normal((frames - 1, crowd, 2))
    return np.asarray(start + np.cumsum(np.cumsum(np.concatenate([velocity[None], change]), axis=0), axis=0))


SLACK = 1e-9  # m and rad. Points beside the robot are at the edge of the view, and are seen whatever the rounding.
NEAREST = 1e-3  # m, smallest measured range: at zero range R is singular
STEP = (
    "m, mean and standard deviation of a step that forward states; 0 m (a turn in place) and 1 m are within 1.25 "
    "sigma, 1 m backwards is at 3.75"
)


@dataclass(frozen=True)
class Corridor(parameters.Imperfect):
    """Parameters of the lab, with its own numbers as defaults. Angles: radians here, degrees in names and flags.

    UsageError for a number out of range, or one without effect.
    """

    people: bool = told(False, "people walk about and are observed like points", hint="their number is crowd=N")
    odometry: bool = told(
        True, "wheels are measured; without, every increment is zero, with the sigmas called blind, or a prior's"
    )
    forward: bool = told(False, "without odometry, state that the robot goes forward by a step or turns")
    constant_velocity: bool = told(
        False, "without odometry, state that the robot keeps a velocity (a turn in place is 8 sigma off)"
    )
    frames: int = told(44, "number of frames; 44 end the first lap, and the motions repeat after that")
    range: float = told(5.0, "m; points at this distance or farther are not observed")
    min_angle: float = in_degrees(-90.0, "deg, bearings between which points are observed, both ends included")
    max_angle: float = in_degrees(90.0, "deg, bearings between which points are observed, both ends included")
    srho: float = told(0.01, "standard deviation of a range, as a share of that range")
    sphi: float = in_degrees(0.125, "deg, standard deviation of a bearing")
    sx_move: float = told(0.01, "m, standard deviations of the odometry of a move of 1 m")
    sy_move: float = told(0.01, "m, standard deviations of the odometry of a move of 1 m")
    stheta_move: float = in_degrees(2.0, "deg, the same of its heading")
    sx_turn: float = told(0.03, "m, standard deviations of the odometry of a turn of 90 deg in place")
    sy_turn: float = told(0.03, "m, standard deviations of the odometry of a turn of 90 deg in place")
    stheta_turn: float = in_degrees(2.5, "deg, the same of its heading")
    sx_blind: float = told(0.25, "m, standard deviations stated for every motion without odometry")
    sy_blind: float = told(0.10, "m, standard deviations stated for every motion without odometry")
    stheta_blind: float = in_degrees(5.0, "deg, the same of its heading")
    step_mean: float = told(0.5, STEP)
    step_sigma: float = told(0.4, STEP)
    velocity: float = told(1.0, "m per frame, mean and standard deviation that constant_velocity states")
    velocity_sigma: float = told(0.5, "m per frame, mean and standard deviation that constant_velocity states")
    lateral_sigma: float = told(0.1, "m, standard deviation sideways that either prior states")
    turn_sigma: float = in_degrees(60.0, "deg, standard deviation of the turn in a frame that either prior states")
    crowd: int = told(10, "number of people, where there are people")
    sv_people: float = told(0.05, "m per frame, standard deviation of each coordinate of a person's first velocity")
    sa_people: float = told(0.01, "m per frame, standard deviation of that coordinate's change from frame to frame")

    def __post_init__(self) -> None:
        positive = ("frames", "crowd", "range", "srho", "sphi")
        signed = ("min_angle", "max_angle", "step_mean", "velocity")
        parameters.check_parameters("corridor", self, positive=positive, signed=signed)
        known = {f.name: f for f in fields(self)}
        for names, used, why in self._uses():
            for f in (known[name] for name in names if not used):
                if (value := getattr(self, f.name)) != f.default:
                    raise UsageError(f"corridor: {f.name} = {written(f, value)} has no effect {why}")
        if not -math.pi <= self.min_angle < self.max_angle <= math.pi:
            low, high = (written(f, getattr(self, f.name)) for f in fields(self) if f.name.endswith("_angle"))
            right = "-180 <= min_angle < max_angle <= 180 is needed"
            raise UsageError(f"corridor: min_angle = {low}, max_angle = {high}; {right}")

    def _uses(self) -> Iterator[tuple[tuple[str, ...], bool | int, str]]:
        """Parameters, whether they have an effect, and why not if they have none."""
        blind, one = ("sx_blind", "sy_blind", "stheta_blind"), "with a motion prior; one can be stated"
        primed, add = self.forward or self.constant_velocity, "; add forward or constant-velocity"
        yield ("crowd", "sv_people", "sa_people"), self.people, "without people"
        yield ("scale", "curvature", "left", "right", "drift"), self.odometry, "with no-odometry"
        yield ("forward", "constant_velocity", *blind), not self.odometry, "with odometry; add no-odometry"
        yield blind, not primed, one
        yield ("constant_velocity",), not self.forward, one
        yield ("class_error",), self.classes, "without classes"
        yield ("step_mean", "step_sigma"), self.forward, "without forward"
        yield ("velocity", "velocity_sigma"), self.constant_velocity, "without constant-velocity"
        yield ("lateral_sigma", "turn_sigma"), primed, f"without a motion prior{add}"
        yield ("sx_move", "sy_move", "stheta_move"), self.odometry, "with no-odometry"
        yield ("sx_turn", "sy_turn", "stheta_turn"), self.odometry, "with no-odometry"

    def prior(self) -> MotionPrior | None:
        """The motion prior stated instead of odometry, if any."""
        if self.forward:
            return ForwardPrior(self.step_mean, self.step_sigma, self.lateral_sigma, self.turn_sigma)
        if self.constant_velocity:
            return ConstantVelocityPrior(self.velocity, self.velocity_sigma, self.lateral_sigma, 0.0, self.turn_sigma)
        return None

    def model(self) -> RelativePoint:
        """The sensor with its field of view."""
        return RelativePoint(max_range=self.range, min_angle=self.min_angle, max_angle=self.max_angle)


def simulate(corridor: Corridor, seed: int, name: str | None = None) -> Log:
    """One log of the corridor, reproducible to the byte. True path and points never change. Observations of a frame are
    ordered by landmark id (1 to 88), then people (true id -1). Frames have no stamps; the prior is exact.
    """
    odometry_rng, sensor_rng, walk_rng, people_rng = parameters.streams(seed, 4)
    truth, turned = path(corridor.frames)
    increments, floored = _odometry(corridor, turned, odometry_rng)
    increments, errors = parameters.reported(corridor, increments, seed)
    c, sensor, prior, known = corridor, corridor.model(), corridor.prior(), points()
    crowd = walks(c.frames, c.crowd if c.people else 0, c.sv_people, c.sa_people, walk_rng)
    frame, true_id, z, R = [], [], [], []
    for k, pose in enumerate(truth):
        people = crowd[k], np.full(crowd.shape[1], CLUTTER), people_rng
        for xy, ids, rng in ((known.xy, known.id, sensor_rng), people):
            seen, readings, covariances = _observe(corridor, sensor, pose, xy, rng)
            frame.append(np.full(len(seen), k))
            true_id.append(ids[seen])
            z.append(readings)
            R.append(covariances)
    inputs = Inputs(
        Prior(np.zeros(3), np.zeros((3, 3))), np.arange(corridor.frames, dtype=np.float64), increments,
        Observations(np.concatenate(frame).astype(np.int64), np.concatenate(z), np.concatenate(R)), sensor, known,
        time_is_index=True, floored=floored,
    )  # fmt: skip
    truth_side = Truth(truth, known, np.concatenate(true_id), errors=errors)
    all_named = parameters.described(corridor).items()
    named = {k: v for k, v in all_named if k not in parameters.LOOKS or not corridor.is_plain}
    source = {"kind": "corridor", "seed": seed, "corridor": named}
    notes = () if prior is None else (note_of(prior),)
    log = Log(name or name_of("corridor", corridor, seed), inputs, truth_side, source=source, notes=notes)
    return parameters.dressed(corridor, log, seed)


def _odometry(corridor: Corridor, turned: IntArray, rng: np.random.Generator) -> tuple[Increments, int]:
    """Measured increments, and how many got the covariance floor."""
    c = corridor
    if c.odometry:
        move, turn = (c.sx_move, c.sy_move, c.stheta_move), (c.sx_turn, c.sy_turn, c.stheta_turn)
        sigma = np.array([move, turn])[turned]
        exact = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.5 * math.pi]])[turned]
        mean, covariance = exact + sigma * rng.standard_normal(sigma.shape), sigma[:, :, None] ** 2 * np.eye(3)
        mean[0], covariance[0] = 0.0, 0.0
    else:
        stated = c.prior() or ForwardPrior(0.0, c.sx_blind, c.sy_blind, c.stheta_blind)
        given = stated.increments(np.arange(float(c.frames)))
        mean, covariance = given.mean, given.covariance
    covariance, floored = floor_covariances(covariance, Inputs.covariance_floor)
    return Increments(mean, covariance), floored


def _observe(
    corridor: Corridor, sensor: RelativePoint, pose: Array, points: Array, rng: np.random.Generator
) -> tuple[IntArray, Array, Array]:
    """Indices (m,) of the points in view; z (m, 2) and R (m, 2, 2), both from the noisy range and bearing."""
    exact = sensor.predict(pose, points)
    noise = np.array([corridor.srho, corridor.sphi]) * rng.standard_normal((len(points), 2))
    seen = np.flatnonzero(sensor.in_view(exact, margin_range=-SLACK, margin_angle=SLACK))
    polar = sensor.polar(parameters.as_read(corridor, sensor, exact[seen]))
    r = np.maximum(polar[:, 0] * (1.0 + noise[seen, 0]), NEAREST)
    b = polar[:, 1] + noise[seen, 1]
    direction = np.stack([np.cos(b), np.sin(b)], axis=-1)
    across = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    # R = J J', with the sigmas in J: d z / d range = direction, d z / d bearing = r across
    J = np.stack([corridor.srho * r[:, None] * direction, corridor.sphi * r[:, None] * across], axis=-1)
    return seen, r[:, None] * direction, J @ np.swapaxes(J, 1, 2)

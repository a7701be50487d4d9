"""The park: large logs. A robot drives for kilometres on a grid of paths among trees that it observes with a laser.

At every crossing it takes the path driven least often, so it returns often, after loops of all lengths. Odometry is one
sample of speed and turn rate per frame, as in many wheel encoder logs: an increment is known to a floor across the
motion, and badly along it. Trees are anywhere in strips about the paths, a few of them in the way.

Route, map, odometry noise, sensor noise and the prior's error come from independent streams of the seed.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from data import se2
from data.errors import UsageError
from data.inputs import Inputs, IntArray, LandmarkMap, Observations
from data.log import Log
from data.se2 import Array
from data.sensors import RangeBearing
from data.truth import Truth
from data.worlds import parameters
from data.worlds.parameters import Imperfect, check_parameters, dressed, told

RADIUS, TURN = 5, 8  # Steps: radius of a quarter turn at a crossing, and number of (slightly shorter) steps of the turn
HEADINGS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # East, north, west, south


@dataclass(frozen=True)
class Park(Imperfect):
    """Parameters of the world; the park's size and its trees follow from the length. UsageError if invalid."""

    frames: int = told(2000, "number of frames")
    period: float = told(1.0, "s between frames, one odometry sample each")
    step: float = told(1.0, "m, distance driven in a frame")
    block: int = told(60, "steps between two crossings; at least 20")
    revisits: float = told(3.0, "mean number of times a path is driven")
    spacing: float = told(4.0, "m of path for each tree")
    strip: float = told(6.0, "m, half the width of the strips of trees about the paths")
    sigma_v: float = told(0.05, "m per sqrt(s)")
    sigma_omega: float = told(0.01, "rad per sqrt(s), odometry noise densities")
    sigma_range: float = told(0.1, "m")
    sigma_bearing: float = told(0.02, "rad, noise of the sensor")
    min_range: float = told(0.0, "m; nothing nearer or farther is reported")
    max_range: float = told(18.0, "m; nothing nearer or farther is reported")
    field_of_view: float = told(180.0, "deg, full opening angle")
    detection: float = told(0.9, "probability that a tree in view is reported", most="probability")
    prior_sigma: float = told(0.1, "m")
    prior_sigma_heading: float = told(0.02, "rad; the prior mean is drawn with them")

    def __post_init__(self) -> None:
        layout = ("frames", "period", "step", "block", "revisits", "spacing", "strip")
        sensing = ("sigma_range", "sigma_bearing", "max_range", "field_of_view", "detection")
        check_parameters("park", self, positive=(*layout, "sigma_v", "sigma_omega", *sensing))
        if self.block < 20:
            raise UsageError(f"park: block = {self.block}; at least 20 is needed, or the turns do not fit")

    @property
    def side(self) -> float:
        """Distance between two crossings [m]."""
        return self.block * self.step

    @property
    def crossings(self) -> int:
        """Number of crossings in each direction; at least 2."""
        ways = self.frames / (self.block * self.revisits)
        return max(2, round(0.5 + math.sqrt(0.25 + ways / 2.0)))  # n crossings a side: 2 n (n - 1) ways

    def sensor(self) -> RangeBearing:
        """The sensor with its field of view."""
        half = min(0.5 * math.radians(self.field_of_view), math.pi)
        return RangeBearing(max_range=self.max_range, min_angle=-half, max_angle=half)


def simulate(park: Park, seed: int, name: str | None = None) -> Log:
    """One log of the park. Same parameters and seed: same bytes."""
    route_rng, map_rng, odometry_rng, sensor_rng, prior_rng = parameters.streams(seed, 5)
    time = park.period * np.arange(park.frames, dtype=np.float64)
    v, omega = (each / park.period for each in _route(park, route_rng))
    start, density = np.array([RADIUS * park.step, 0.0, 0.0]), (park.sigma_v, park.sigma_omega)
    truth, increments, floored = parameters.driven(park.period, v, omega, time, start, density, odometry_rng)
    increments, errors = parameters.reported(park, increments, seed)
    trees = _trees(park, map_rng)
    sensor = park.sensor()
    frame, z, true_id = _observe(park, sensor, truth, trees, sensor_rng)
    R = np.tile(np.diag([park.sigma_range**2, park.sigma_bearing**2]), (len(z), 1, 1))
    known = LandmarkMap(np.arange(len(trees)), trees)
    prior = parameters.drawn_prior(truth[0], park.prior_sigma, park.prior_sigma_heading, prior_rng)
    inputs = Inputs(prior, time, increments, Observations(frame, z, R), sensor, known, floored=floored)
    truth_side = Truth(truth, known, true_id, errors=errors)
    return dressed(park, Log(name or f"park:{seed}", inputs, truth_side, source={"kind": "park", "seed": seed}), seed)


def _route(park: Park, rng: np.random.Generator) -> tuple[Array, Array]:
    """True distance [m] and turn [rad] (N,) by frame, along a grid with quarter turns, from crossing (0, 0) east."""
    straight, across = park.block - 2 * RADIUS, 2 * RADIUS
    arc = 0.5 * math.pi * RADIUS / TURN
    driven: dict[tuple[int, int, int], int] = {}
    x, y, heading, length = 0, 0, 0, 0
    way, turn = list[Array](), list[Array]()
    while length < park.frames:
        here = _way(x, y, heading)
        driven[here] = driven.get(here, 0) + 1
        x, y = x + HEADINGS[heading][0], y + HEADINGS[heading][1]
        there = [h for h in range(4) if h != (heading + 2) % 4 and _inside(park, x, y, h)]
        times = [driven.get(_way(x, y, h), 0) for h in there]
        least = [h for h, t in zip(there, times, strict=True) if t == min(times)]
        chosen = least[int(rng.integers(len(least)))]
        side = (chosen - heading + 1) % 4 - 1  # 1: left, -1: right
        crossing = TURN if side else across
        way += [np.ones(straight), np.full(crossing, arc if side else 1.0)]
        turn += [np.zeros(straight), np.full(crossing, side * 0.5 * math.pi / TURN)]
        heading, length = chosen, length + straight + crossing
    return park.step * np.concatenate(way)[: park.frames], np.concatenate(turn)[: park.frames]


def _way(x: int, y: int, heading: int) -> tuple[int, int, int]:
    """The path that leaves crossing (x, y) by a heading: its western or southern end, and its axis."""
    dx, dy = HEADINGS[heading]
    return x + min(dx, 0), y + min(dy, 0), heading % 2


def _inside(park: Park, x: int, y: int, heading: int) -> bool:
    dx, dy = HEADINGS[heading]
    return 0 <= x + dx < park.crossings and 0 <= y + dy < park.crossings


def _trees(park: Park, rng: np.random.Generator) -> Array:
    """Positions (L, 2), uniform in the strips about all paths, in random order."""
    n = park.crossings
    ends = [(x, y, h) for h in range(2) for x in range(n) for y in range(n) if _inside(park, x, y, h)]
    count = max(1, round(len(ends) * park.side / park.spacing))
    which = rng.integers(len(ends), size=count)
    start, axis = np.array([e[:2] for e in ends], float)[which] * park.side, np.array([e[2] for e in ends])[which]
    along, across = rng.uniform(0.0, park.side, count), rng.uniform(-park.strip, park.strip, count)
    return start + np.where(axis[:, None] == 0, np.stack([along, across], 1), np.stack([across, along], 1))


def _observe(
    park: Park, sensor: RangeBearing, truth: Array, trees: Array, rng: np.random.Generator
) -> tuple[IntArray, Array, IntArray]:
    """Frames (M,), observations (M, 2) and true ids (M,), by frame and tree."""
    near = scipy.spatial.cKDTree(trees).query_ball_point(truth[:, :2], park.max_range, return_sorted=True)
    count = [len(each) for each in near]  # type: ignore[arg-type]
    frame, tree = np.repeat(np.arange(len(truth)), count), np.concatenate(list(near)).astype(np.int64)
    exact = sensor.predict(truth[frame], trees[tree])
    reported = rng.random(len(tree)) < park.detection
    noise = rng.standard_normal((len(tree), 2)) * np.array([park.sigma_range, park.sigma_bearing])
    seen = sensor.in_view(exact) & (exact[:, 0] >= park.min_range) & reported
    z = parameters.as_read(park, sensor, exact[seen]) + noise[seen]
    return frame[seen], np.stack([np.maximum(z[:, 0], 0.0), se2.wrap_angle(z[:, 1])], 1), tree[seen]

"""The floor plan world: scans of rooms and corridors by a robot with an exactly known path and poor odometry.

It drives in lines and arcs, mostly to where it has been least. The scanner measures the nearest hit of each beam among
walls (segments) and people (discs).

Building, route, odometry noise, range noise, glass, people and the prior's error come from independent streams of the
seed, so changing one parameter leaves the others' draws alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from data import se2
from data.compiled import njit
from data.errors import UsageError
from data.inputs import Increments, Inputs, IntArray, Observations, Scanner, Scans
from data.log import Log
from data.motion.velocity import floor_covariances
from data.se2 import Array, BoolArray, compose, inverse, wrap_angle
from data.sensors import RangeBearing
from data.truth import Truth
from data.worlds.parameters import check_parameters, drawn_prior, in_degrees, streams
from wings.laser.floorplan.building import Building, Ways, build

RADIUS = 0.5
"""m, radius of a turn where there is space."""
ABOUT = math.radians(135.0)
"""rad; a sharper turn is made in place."""
WANDER = 0.1
"""m, largest deviation from a place in x and in y, so that lines do not repeat."""
AGAIN = 0.3
"""Probability that the next target was visited before."""


def drive(ways: Ways, rng: np.random.Generator, time: Array, speed: float, turn_rate: float) -> Array:
    """Exact poses (N, 3) at stamps (N,) [s] from 0 up, without rests.

    `speed` [m/s] is that of straight lines; turns are slower where `turn_rate` [rad/s] limits them.
    """
    moves = list[tuple[float, float, float]]()  # s, m/s, rad/s
    points = tour(ways, rng)
    a, b = next(points), next(points)
    start = np.array([*a, math.atan2(b[1] - a[1], b[0] - a[0])])
    lasted, straight = 0.0, float(np.hypot(*(b - a)))
    while lasted <= time[-1]:
        c = next(points)
        onward = float(np.hypot(*(c - b)))
        turn = float(wrap_angle(math.atan2(c[1] - b[1], c[0] - b[0]) - math.atan2(b[1] - a[1], b[0] - a[0])))
        # a turn begins at most half a path before its corner, which leaves space for the turn before
        half = math.tan(0.5 * abs(turn)) if abs(turn) < ABOUT else 0.0
        cut = min(RADIUS * half, 0.45 * onward, 0.45 * float(np.hypot(*(b - a))))
        radius = cut / half if half > 0.0 else 0.0
        slow = min(speed, turn_rate * radius)
        arc = radius * abs(turn) / slow if slow > 0.0 else abs(turn) / turn_rate
        new = [((straight - cut) / speed, speed, 0.0)]
        if arc > 0.0:
            new.append((arc, slow, turn / arc))
        lasted += sum(m[0] for m in new)
        moves += new
        a, b, straight = b, c, onward - cut
    return _poses(start, np.array(moves), time)


def tour(ways: Ways, rng: np.random.Generator) -> Iterator[Array]:
    """Endless points (2,) to drive through, each time to the nearest of three new or old targets."""
    been = np.zeros(len(ways.place), int)
    here = int(rng.choice(ways.target))
    been[here] = 1
    yield _about(ways, here, rng)
    while True:
        times = been[ways.target]
        among = ways.target[times == times.min()] if rng.random() > AGAIN or not times.any() else ways.target[times > 0]
        some = rng.choice(among, size=min(3, len(among)), replace=False)
        nearest = np.argmin(np.linalg.norm(ways.place[some] - ways.place[here], axis=1))
        # the route between two places varies
        route = ways.route(here, int(some[nearest]), ways.length * rng.uniform(1.0, 2.0, len(ways.edge)))
        for place in route[1:]:
            been[place] += 1
            yield _about(ways, place, rng)
        if len(route) == 1:
            been[here] += 1
        here = route[-1]


def _about(ways: Ways, place: int, rng: np.random.Generator) -> Array:
    return np.asarray(ways.place[place] + rng.uniform(-WANDER, WANDER, 2))


def _poses(start: Array, moves: Array, time: Array) -> Array:
    """Poses (N, 3) along moves (K, 3) of s, m/s, rad/s, each a line, an arc or a turn in place."""
    begins = np.concatenate([[0.0], np.cumsum(moves[:-1, 0])])
    pose = np.zeros((len(moves), 3))
    heading = start[2] + np.concatenate([[0.0], np.cumsum(moves[:-1, 0] * moves[:-1, 2])])
    steps = _arc(heading, moves[:, 1], moves[:, 2], moves[:, 0])
    pose[:, :2] = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1], axis=0)])
    pose[:, 2] = heading
    k = np.searchsorted(begins, time, side="right") - 1
    into = time - begins[k]
    at = pose[k]
    at[:, :2] += _arc(at[:, 2], moves[k, 1], moves[k, 2], into)
    at[:, 2] = wrap_angle(at[:, 2] + moves[k, 2] * into)
    return at


def _arc(heading: Array, v: Array, omega: Array, lasts: Array) -> Array:
    """Displacement (n, 2) from a heading with v and omega during a time: the chord of the arc."""
    half = 0.5 * omega * lasts
    chord = v * lasts * np.sinc(half / math.pi)
    return np.stack([chord * np.cos(heading + half), chord * np.sin(heading + half)], 1)


NOTHING = -1
"""Index of a beam without a hit."""


@njit
def _cast(
    poses: Array, angle_min: float, angle_step: float, walls: Array, discs: Array, ranges: Array, hit: IntArray
) -> None:
    """Fill ranges (S, B) [m], inf without a hit, and hit (S, B): the segment's row, len(walls) for a disc.

    Each segment is tested against the beams between the bearings of its ends, and one more on either side.
    """
    beams = ranges.shape[1]
    dx, dy = np.empty(beams), np.empty(beams)
    for k in range(len(poses)):
        x, y, first = poses[k, 0], poses[k, 1], poses[k, 2] + angle_min
        for b in range(beams):
            dx[b], dy[b] = math.cos(first + b * angle_step), math.sin(first + b * angle_step)
        best, what = ranges[k], hit[k]
        for b in range(beams):
            best[b], what[b] = np.inf, -1
        for s in range(len(walls)):
            ax, ay, bx, by = walls[s, 0] - x, walls[s, 1] - y, walls[s, 2] - x, walls[s, 3] - y
            ex, ey = bx - ax, by - ay
            # r d = a + u e: r = (a x e) / (d x e), u = (a x d) / (d x e), 0 <= u <= 1
            a_cross_e = ax * ey - ay * ex
            seen_under = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
            bearing = (math.atan2(ay, ax) if seen_under >= 0.0 else math.atan2(by, bx)) - first
            bearing -= 2.0 * math.pi * math.floor(bearing / (2.0 * math.pi))
            for turn in range(-1, 1):
                low = bearing + 2.0 * math.pi * turn
                begin = max(math.floor(low / angle_step) - 1, 0)
                end = min(math.ceil((low + abs(seen_under)) / angle_step) + 2, beams)
                for b in range(begin, end):
                    den, u = dx[b] * ey - dy[b] * ex, ax * dy[b] - ay * dx[b]
                    num = a_cross_e
                    if den < 0.0:
                        den, num, u = -den, -num, -u
                    if den > 0.0 and u >= 0.0 and u <= den and num > 0.0 and num < best[b] * den:
                        best[b], what[b] = num / den, s
        for j in range(discs.shape[1]):
            cx, cy, radius = discs[k, j, 0] - x, discs[k, j, 1] - y, discs[k, j, 2]
            for b in range(beams):
                along, across = cx * dx[b] + cy * dy[b], cx * dy[b] - cy * dx[b]
                inside = radius * radius - across * across
                if inside > 0.0:
                    r = along - math.sqrt(inside)
                    if r > 0.0 and r < best[b]:
                        best[b], what[b] = r, len(walls)


def scan_ranges(
    poses: Array,
    scanner: Scanner,
    beams: int,
    walls: Array,
    *,
    glass: BoolArray | None = None,
    discs: Array | None = None,
) -> Array:
    """Exact ranges (S, B) [m] from body poses (S, 3) in the world, inf for no return.

    Args:
        poses: world frame.
        scanner: its angles, extrinsic and max_range.
        beams: B.
        walls: (W, 4) segments x0, y0, x1, y1 [m], world frame.
        glass: (W,) true where a wall returns nothing, but occludes.
        discs: (S, D, 3) x, y, radius [m] of discs at each pose; one that contains the scanner is not seen.
    """
    extrinsic = np.array([*scanner.translation, scanner.rotation])
    at = compose(np.asarray(poses, float), inverse(extrinsic))
    ranges = np.empty((len(at), beams))
    hit = np.empty((len(at), beams), np.int64)
    moving = np.zeros((len(at), 0, 3)) if discs is None else discs
    _cast(at, scanner.angle_min, scanner.angle_step, walls, moving, ranges, hit)
    ranges[ranges >= scanner.max_range] = np.inf
    if glass is not None:
        ranges[np.append(glass, False)[hit] & (hit != NOTHING)] = np.inf
    return ranges


FLOOR = 1e-10
"""m^2, rad^2; smallest eigenvalue of an increment's covariance."""
SLIP = (0.04, 0.01, 0.04)
"""m, m, rad; standard deviation of a slip's contribution to an increment, at steps of 0.1 m."""
PANE = 1.5
"""m, longest piece of a wall that is wholly of glass or not."""
PERSON, MANNERS = 0.22, 0.6
"""m, radius of a person, and smallest distance of people from the scanner."""


@dataclass(frozen=True)
class Floorplan:
    """Parameters of the world. Angles: radians here, degrees in names and flags. UsageError for an invalid value.

    Attributes:
        glass: some pieces of the walls return nothing.
        people: people walk about and occlude walls.
        frames: number of frames.
        period: s between frames.
        thin: one of this many frames has a scan, the first included.
        speed: m/s, along straight lines.
        turn_rate: rad/s, at most.
        sigma_along: m per sqrt(s), odometry noise density along the motion.
        sigma_across: m per sqrt(s), the same across the motion.
        sigma_turn: rad per sqrt(s), the same of the heading.
        slip: probability that the wheels slip in a frame.
        beams: in a scan.
        field_of_view: deg, from the first beam to one after the last.
        max_range: m; longer ranges are no return.
        sigma_range: m, standard deviation of a range.
        rotation: deg, of the scanner: p_scanner = R p_body + T.
        translation_x, translation_y: m, T.
        panes: share of the walls that is of glass, where there is glass.
        crowd: number of people, where there are people.
        prior_sigma: m, prior_sigma_heading: rad; the prior mean is drawn with them (0: it is exact).
    """

    glass: bool = field(default=False, metadata={"hint": "its share of the walls is panes=SHARE"})
    people: bool = field(default=False, metadata={"hint": "their number is crowd=N"})
    frames: int = 3000
    period: float = 0.2
    thin: int = 1
    speed: float = 0.5
    turn_rate: float = 0.6
    sigma_along: float = 0.02
    sigma_across: float = 0.007
    sigma_turn: float = 0.02
    slip: float = 0.01
    beams: int = 180
    field_of_view: float = in_degrees(180.0)
    max_range: float = 30.0
    sigma_range: float = 0.015
    rotation: float = in_degrees(0.0)
    translation_x: float = 0.0
    translation_y: float = 0.0
    panes: float = 0.15
    crowd: int = 15
    prior_sigma: float = 0.0
    prior_sigma_heading: float = 0.0

    def __post_init__(self) -> None:
        scans = ("beams", "field_of_view", "max_range", "sigma_range")
        positive = ("frames", "period", "thin", "speed", "turn_rate", *scans)
        check_parameters("floorplan", self, positive=positive, signed=("rotation", "translation_x", "translation_y"))
        for name in ("slip", "panes"):
            if getattr(self, name) > 1.0:
                raise UsageError(f"floorplan: {name} = {getattr(self, name)}; a share of 1 is needed")
        if self.field_of_view > 2.0 * math.pi + 1e-12:
            raise UsageError(f"floorplan: field_of_view = {math.degrees(self.field_of_view):g}; at most 360 deg")

    def scanner(self) -> Scanner:
        """The scanner, with beams from right to left, symmetric except for one step."""
        step, place = self.field_of_view / self.beams, (self.translation_x, self.translation_y)
        return Scanner(-0.5 * self.field_of_view, step, self.max_range, self.sigma_range, self.rotation, place)


def plan_of(seed: int) -> Building:
    """The building of a seed; no parameter changes it."""
    return build(streams(seed, 1)[0])


def simulate(floorplan: Floorplan, seed: int, name: str | None = None) -> Log:
    """One log of the floor plan. Same parameters and seed: same bytes."""
    _, route_rng, odometry_rng, range_rng, glass_rng, people_rng, prior_rng = streams(seed, 7)
    building = plan_of(seed)
    time = floorplan.period * np.arange(floorplan.frames, dtype=np.float64)
    truth = drive(building.ways, route_rng, time, floorplan.speed, floorplan.turn_rate)
    increments, floored = _odometry(floorplan, truth, odometry_rng)
    frame = np.arange(0, floorplan.frames, floorplan.thin)
    walls, of_glass = _panes(building, floorplan.panes if floorplan.glass else 0.0, glass_rng)
    crowd = _people(floorplan, building, time, people_rng)[frame] if floorplan.people else None
    scanner = floorplan.scanner()
    if crowd is not None:  # people too near the scanner are absent: radius zero
        at = compose(truth[frame], inverse(np.array([*scanner.translation, scanner.rotation])))
        crowd[np.hypot(crowd[..., 0] - at[:, None, 0], crowd[..., 1] - at[:, None, 1]) < MANNERS, 2] = 0.0
    ranges = scan_ranges(truth[frame], scanner, floorplan.beams, walls, glass=of_glass, discs=crowd)
    ranges = np.maximum(ranges + floorplan.sigma_range * range_rng.standard_normal(ranges.shape), 1e-3)
    ranges[ranges >= floorplan.max_range] = 0.0
    inputs = Inputs(
        drawn_prior(truth[0], floorplan.prior_sigma, floorplan.prior_sigma_heading, prior_rng),
        time,
        increments,
        Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2))),
        RangeBearing(max_range=floorplan.max_range),
        floored=floored,
        scans=Scans(scanner, frame, ranges),
    )
    return Log(name or f"floorplan:{seed}", inputs, Truth(truth), source={"kind": "floorplan", "seed": seed})


def _odometry(floorplan: Floorplan, truth: Array, rng: np.random.Generator) -> tuple[Increments, int]:
    """Noisy increments with the covariance of steady noise and rare slips together.

    It is the same for every increment, so that it does not depend on the true motion.
    """
    exact = se2.between(truth[:-1], truth[1:])
    density = np.array([floorplan.sigma_along, floorplan.sigma_across, floorplan.sigma_turn])
    steady = density * math.sqrt(floorplan.period) * rng.standard_normal(exact.shape)
    slips = rng.random((len(exact), 1)) < floorplan.slip
    slipped = slips * np.array(SLIP) * rng.standard_normal(exact.shape)
    mean, covariance = np.zeros_like(truth), np.zeros((len(truth), 3, 3))
    mean[1:] = exact + steady + slipped
    covariance[1:] = np.diag(np.square(density) * floorplan.period + floorplan.slip * np.square(SLIP))
    covariance, floored = floor_covariances(covariance, FLOOR)
    return Increments(mean, covariance), floored


def _panes(building: Building, share: float, rng: np.random.Generator) -> tuple[Array, BoolArray]:
    """All walls (W, 4) with their faces cut into panes, and which of them (W,) are of glass."""
    faces = building.walls[: building.faces]
    count = np.maximum(np.ceil(np.linalg.norm(faces[:, 2:] - faces[:, :2], axis=1) / PANE), 1.0).astype(int)
    part = np.concatenate([np.arange(n) / n for n in count])[:, None]
    a, way = np.repeat(faces[:, :2], count, axis=0), np.repeat(faces[:, 2:] - faces[:, :2], count, axis=0)
    step = way / np.repeat(count, count)[:, None]
    glass = rng.random(len(a)) < share
    if not share:
        return building.walls, np.zeros(len(building.walls), bool)
    cut = np.concatenate([a + part * way, a + part * way + step], axis=1)
    rest = building.walls[building.faces :]
    return np.concatenate([cut, rest]), np.concatenate([glass, np.zeros(len(rest), bool)])


def _people(floorplan: Floorplan, building: Building, time: Array, rng: np.random.Generator) -> Array:
    """Discs (N, crowd, 3) of walking people."""
    discs = np.full((len(time), floorplan.crowd, 3), PERSON)
    for i, own in enumerate(rng.spawn(floorplan.crowd)):
        discs[:, i, :2] = drive(building.ways, own, time, float(own.uniform(0.6, 1.3)), math.pi)[:, :2]
    return discs

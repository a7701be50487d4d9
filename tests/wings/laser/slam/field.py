"""Simulated laser logs as robots in the field have them: odometry that lies, rooms that repeat, halls, glass."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from data.formats.recordings.laser import laser_inputs
from data.inputs import IntArray, Scanner, Scans
from data.log import Log
from data.se2 import Array, between, compose, dead_reckoned
from data.truth import Truth
from wings.laser.floorplan.world import drive, plan_of, scan_ranges

SICK = Scanner(-0.5 * math.pi, math.pi / 180.0, 30.0, 0.01)
BEAMS = 180
PERIOD = 0.2


def path_of(seed: int, frames: int = 1200, speed: float = 0.5) -> tuple[Array, Array]:
    """Walls (W, 4) and a path (N, 3) through the plan of a seed."""
    building = plan_of(seed)
    time = PERIOD * np.arange(frames, dtype=float)
    return building.walls, drive(building.ways, np.random.default_rng(seed), time, speed, 0.6)


def moves_of(path: Array) -> Array:
    return np.concatenate([np.zeros((1, 3)), between(path[:-1], path[1:])])


def backing(truth: Array, rng: np.random.Generator, every: int = 150, back: int = 40) -> tuple[Array, IntArray]:
    """The path with stretches driven back and forth, and the sign of each step's motion."""
    order, sign = [0], [1]
    while True:
        for way, steps in ((1, int(rng.integers(every // 2, every))), (-1, int(rng.integers(back // 2, back)))):
            for _ in range(steps):
                following = order[-1] + way
                if following < 0:
                    break
                if following == len(truth):
                    return truth[order], np.array(sign)
                order.append(following)
                sign.append(way)


def recorded(
    truth: Array, walls: Array, rng: np.random.Generator, *, told: Array | None = None, period: float = PERIOD,
    thin: int = 1, scanner: Scanner = SICK, glass: Array | None = None, noise: float = 0.01,
    stamp: Array | None = None, exact_ranges: Array | None = None,
) -> Log:  # fmt: skip
    """A log of a path (N, 3) with odometry whose increments are `told` (N, 3), those of the path by default, plus
    noise with the travel as of real wheels. One of `thin` frames has a scan, of the walls or as given.
    """
    told = moves_of(truth) if told is None else told
    distance, turn = np.hypot(told[:, 0], told[:, 1]), np.abs(told[:, 2])
    along, about = np.sqrt(0.03**2 * distance + 0.03**2 * turn), np.sqrt(0.05**2 * distance + 0.04**2 * turn)
    odometry = told + np.stack([along, along, about], axis=1) * rng.standard_normal(truth.shape)
    pose = dead_reckoned(truth[0], odometry)
    frame = np.arange(0, len(truth), thin)
    ranges = scan_ranges(truth[frame], scanner, BEAMS, walls, glass=glass) if exact_ranges is None else exact_ranges
    ranges = np.maximum(ranges + noise * rng.standard_normal(ranges.shape), 1e-3)
    ranges[ranges >= scanner.max_range] = 0.0
    times = period * np.arange(len(truth), dtype=float) if stamp is None else stamp
    return Log("field", laser_inputs(pose, times, Scans(scanner, frame, ranges)), Truth(truth))


def reporting_forward(seed: int) -> Log:
    """A robot that backs in some stretches while its odometry says forward."""
    walls, truth = path_of(seed)
    rng = np.random.default_rng(seed + 1000)
    truth, sign = backing(truth, rng)
    told = moves_of(truth)
    told[:, 0] *= sign
    assert (told[1:, 0] > -0.02).all()
    return recorded(truth, walls, rng, told=told)


def slipping_at_rest(seed: int, angle: float, thin: int = 5) -> Log:
    """A robot that turns by up to an angle [rad] while its wheels say that it rests, seven times."""
    walls, truth = path_of(seed, 600)
    rng = np.random.default_rng(seed + 2000)
    told = moves_of(truth)
    turned, spoken = [], []
    for part, own in zip(np.array_split(truth, 7), np.array_split(told, 7), strict=True):
        # turned by the slip in `thin` frames, which the wheels do not see, and back, which they do
        slip = angle * rng.uniform(0.5, 1.0) * rng.choice([-1.0, 1.0])
        there = slip * np.linspace(0.0, 1.0, thin + 1)[1:]
        at = np.repeat(part[-1:], 2 * thin, axis=0)
        at[:, 2] += np.concatenate([there, slip - there])
        motion = np.zeros((2 * thin, 3))
        motion[thin:, 2] = -slip / thin
        turned += [part, at]
        spoken += [own, motion]
    path = np.concatenate(turned)
    path[:, 2] = (path[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return recorded(path, walls, rng, told=np.concatenate(spoken), thin=thin)


def symmetric_room(seed: int, *, thin: int = 5) -> Log:
    """A robot that turns and drives in a rectangle that looks the same after half a turn."""
    rng = np.random.default_rng(seed)
    w, h = rng.uniform(3.0, 6.0), rng.uniform(2.0, 3.5)
    walls = np.array([[-w, -h, w, -h], [w, -h, w, h], [w, h, -w, h], [-w, h, -w, -h]])
    pose, path = np.zeros(3), []
    for _ in range(12):
        rate = rng.uniform(-1.2, 1.2)
        for _ in range(int(rng.integers(5, 20))):
            pose = compose(pose, np.array([0.0, 0.0, PERIOD * rate]))
            path.append(pose)
        path += [pose] * int(rng.integers(0, 10))
        for _ in range(int(rng.integers(0, 8))):
            onward = compose(pose, np.array([0.06, 0.0, 0.0]))
            if abs(onward[0]) < w - 1.0 and abs(onward[1]) < h - 1.0:
                pose = onward
            path.append(pose)
    truth = np.array(path)
    truth[:, 2] = (truth[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return recorded(truth, walls, rng, thin=thin)


def halls(
    seed: int, *, panes: float = 0.3, frames: int = 2500, reach: float = 30.0, thin: int = 1, bias: float = 0.0
) -> Log:
    """Wide halls with rows of equal parallel walls, some of glass: every row looks like the next. `bias` of the
    odometry's heading [rad per m].
    """
    rng = np.random.default_rng(seed)
    width, depth, rows = 36.0, 20.0, 9
    walls = [[0, 0, width, 0], [width, 0, width, depth], [width, depth, 0, depth], [0, depth, 0, 0]]
    spacing = width / (rows + 1)
    walls += [[spacing * (k + 1), 3.0, spacing * (k + 1), depth - 3.0] for k in range(rows)]
    cut = []
    for x0, y0, x1, y1 in walls:
        ends = np.linspace([x0, y0], [x1, y1], max(int(math.hypot(x1 - x0, y1 - y0) / 1.5), 1) + 1)
        cut += [[*a, *b] for a, b in pairwise(ends)]
    lines = np.array(cut, float)
    glass = rng.random(len(lines)) < panes
    points, x = [np.array([0.5 * spacing, 1.5])], 0  # up one row and down another, at random
    while len(points) < 60:
        following = int(np.clip(x + rng.integers(-3, 4), 0, rows))
        y = 1.5 if points[-1][1] < 0.5 * depth else depth - 1.5
        for to in ((spacing * (following + 0.5), y), (spacing * (following + 0.5), depth - y)):
            points.append(np.array(to) + rng.uniform(-0.2, 0.2, 2))
        x = following
    truth = through(points, frames)
    told = moves_of(truth)
    told[:, 2] = (told[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    told[:, 2] += bias * np.hypot(told[:, 0], told[:, 1])
    scanner = replace(SICK, max_range=reach)
    return recorded(truth, lines, rng, glass=glass, thin=thin, told=told, scanner=scanner)


def through(points: list[Array], frames: int, step: float = 0.12, turn: float = 0.15) -> Array:
    path = [np.array([*points[0], 0.0])]
    for to in points[1:]:
        away = to - path[-1][:2]
        left = (math.atan2(away[1], away[0]) - path[-1][2] + math.pi) % (2.0 * math.pi) - math.pi
        for _ in range(math.ceil(abs(left) / turn)):
            last = path[-1]
            path.append(np.array([last[0], last[1], last[2] + left / math.ceil(abs(left) / turn)]))
        n = math.ceil(float(np.hypot(*away)) / step)
        start = path[-1]
        path += [np.array([*(start[:2] + away * (k + 1) / n), start[2]]) for k in range(n)]
    truth = np.array(path[:frames])
    truth[:, 2] = (truth[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return truth


def ring(
    seed: int, *, scale: float = 0.04, spacing: float = 2.0, rounds: int = 3, reach: float = 8.0, glass: bool = True
) -> Log:
    """A corridor around a block, driven some rounds. One long side has bare walls, on one side of glass; the other has
    pillars at equal distances. Odometry's way is too long by a share `scale`, which only the bare side leaves unseen.
    """
    rng = np.random.default_rng(seed)
    width, depth, wide = 60.0, 24.0, 3.0
    outer = [[0, 0, width, 0], [width, 0, width, depth], [width, depth, 0, depth], [0, depth, 0, 0]]
    a, b, c, d = wide, wide, width - wide, depth - wide
    walls = [*outer, *[[a, b, c, b], [c, b, c, d], [c, d, a, d], [a, d, a, b]]]
    for x in np.arange(a + spacing, c, spacing).tolist():
        for y0, y1 in ((d, d + 0.4), (depth, depth - 0.4)):
            for dx in (-0.2, 0.2):
                walls.append([x + dx, y0, x + dx, y1])
            walls.append([x - 0.2, y1, x + 0.2, y1])
    lines = np.array(walls, float)
    clear = np.zeros(len(lines), bool)
    clear[4] = glass
    m = 0.5 * wide
    corners = [(m, m), (width - m, m), (width - m, depth - m), (m, depth - m)]
    points = [np.array(p) + rng.uniform(-0.2, 0.2, 2) for _ in range(rounds) for p in corners] + [np.array([30.0, m])]
    truth = through(points, 100_000)
    told = moves_of(truth)
    told[:, 2] = (told[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    told[:, 0] *= 1.0 + scale
    return recorded(truth, lines, rng, glass=clear, told=told, scanner=replace(SICK, max_range=reach))

"""Frontier exploration (Yamauchi 1997): drive to the nearest border of free and unknown cells until none is reachable.

The map is the occupancy grid of the key scans and the newest one, drawn anew for each plan. Paths are shortest on the
grid, by Dijkstra's algorithm from the robot: A* for the nearest of many goals has no better heuristic than zero.
"""

import math
from collections.abc import Callable

import numpy as np
import scipy
from scipy import ndimage

from data.inputs import IntArray, Scanner
from data.se2 import Array, BoolArray, wrap_angle
from wings.laser.scans.occupancy import Grid, occupancy_grid
from wings.robot.driving import SPIN
from wings.robot.packets import AHEAD, FASTEST, PERIOD, RADIUS
from wings.robot.traffic import Packet

CELL = 0.1  # m
ROOM = RADIUS + 0.5 * CELL  # m from the robot's centre to an occupied cell: its body, and half a cell
ROOMY = 2.0 * ROOM  # m; nearer to a wall a metre counts up to three times
GAP = (2.0 * ROOM) ** 2  # m^2. In a smaller unknown area the robot has no room
REPLAN = 3.0  # s
NEARBY = 6.0  # m, of paths that are sought first
AHEAD_ON_PATH = 0.25  # m, of the point on the path that the robot turns to; a chord of 0.4 m meets the corners of walls
FACING = 0.6  # rad. Farther off it turns on the spot
TURNING = 2.0  # 1/s, turn rate over angle: below 1 / (0.25 s command + 0.1 s motor)
STUCK = 6.0  # s without `PROGRESS` metres: the goal is given up, and the robot backs away for `BACKING`
PROGRESS = 0.1
BACKING = 1.5  # s
AROUND = np.ones((3, 3), bool)  # a cell and its eight neighbours
SPEED = 0.75 * FASTEST  # leaves a quarter for turning
BLOCKED = SPEED * PERIOD + 0.5 * CELL
"""m ahead of the rim. For a nearer obstacle the robot turns, and backs away from one on its path."""
ON_PATH = 0.2  # rad
BACKWARDS = -0.3 * SPEED


class Explorer:
    """A policy: speed [m/s] and turn rate [rad/s] after each packet; `finished` when nothing reachable is unknown."""

    def __init__(
        self, scans: Callable[[], tuple[Array, Array, Scanner] | None], pose: Callable[[], Array | None]
    ) -> None:
        """`scans` gives poses and scans for the map, `pose` the robot's pose (3,), both as estimated online."""
        self._scans, self._pose = scans, pose
        self._path, self._planned = np.empty((0, 2)), -math.inf
        self._given_up = list[Array]()
        self._moved, self._at, self._backing = -math.inf, np.full(2, np.inf), -math.inf
        self.finished = False

    def __call__(self, packet: Packet) -> tuple[float, float]:
        """Command after a packet, which the estimator has taken already."""
        pose = self._pose()
        if pose is None or self.finished:
            return 0.0, 0.0
        if np.hypot(*(pose[:2] - self._at)) > PROGRESS:
            self._moved, self._at = packet.t, pose[:2].copy()
        if packet.t - self._moved > STUCK and len(self._path):
            self._given_up.append(self._path[-1])
            self._moved, self._planned, self._backing = packet.t, -math.inf, packet.t + BACKING
        if packet.t < self._backing:
            return BACKWARDS, 0.0
        if packet.t - self._planned >= REPLAN or not len(self._path):
            self._plan(pose, packet.t)
        return self._follow(pose, packet)

    def _plan(self, pose: Array, t: float) -> None:
        found, self._planned = self._scans(), t
        if found is None:
            return
        poses, ranges, scanner = found
        grid = occupancy_grid(poses, ranges, scanner, resolution=CELL)
        self._path = path_to_frontier(grid, pose[:2], np.array(self._given_up).reshape(-1, 2))
        self.finished = not len(self._path)

    def _follow(self, pose: Array, packet: Packet) -> tuple[float, float]:
        """Turn to a point ahead on the path, and drive unless something is just ahead."""
        if not len(self._path):
            return 0.0, 0.0
        self._path = self._path[int(np.argmin(np.hypot(*(self._path - pose[:2]).T))) :]
        far = np.hypot(*(self._path - pose[:2]).T) >= AHEAD_ON_PATH
        to = self._path[int(np.argmax(far)) if far.any() else -1] - pose[:2]
        if not far.any() and np.hypot(*to) < CELL:  # what is unknown from here stays so
            self._given_up.append(self._path[-1])
            self._path = self._path[:0]
            return 0.0, 0.0
        off = float(wrap_angle(math.atan2(to[1], to[0]) - pose[2]))
        turn = min(max(TURNING * off, -SPIN), SPIN)
        if room_ahead(packet) < BLOCKED:
            return (BACKWARDS if abs(off) < ON_PATH else 0.0), turn
        return (0.0 if abs(off) > FACING else SPEED * math.cos(off)), turn


def room_ahead(packet: Packet) -> float:
    """Way [m] straight ahead until the rim meets what the lidar sees; by the sonar where the scan was lost."""
    if packet.scan is None:
        return float(packet.ranges[AHEAD])
    r = packet.scan.metres
    angle = packet.scan.beams.first / 1e6 + packet.scan.beams.step / 1e9 * np.arange(len(r))
    x, y = r * np.cos(angle), r * np.sin(angle)
    lane = (r > 0.0) & (x > 0.0) & (np.abs(y) < RADIUS)
    return float((x[lane] - np.sqrt(RADIUS**2 - y[lane] ** 2)).min(initial=np.inf))


def _large(cells: BoolArray, least: float) -> BoolArray:
    """Cells (H, W) in connected areas of at least `least` cells."""
    label, count = ndimage.label(cells, AROUND)
    return np.asarray((np.bincount(label.ravel(), minlength=count + 1) >= least)[label] & cells)


def passable(grid: Grid, room: float = ROOM) -> tuple[BoolArray, Array]:
    """Cells (H, W) where the robot's centre may be, `room` m from walls, and what a metre costs there."""
    off = ndimage.distance_transform_edt(grid.log_odds <= 0.0) * grid.resolution
    return (grid.log_odds < 0.0) & (off > room), 1.0 + 2.0 * np.clip((ROOMY - off) / (ROOMY - ROOM), 0.0, 1.0)


def path_to_frontier(grid: Grid, start: Array, given_up: Array) -> Array:
    """Centres (n, 2) [m] of the cells from `start` (2,) to the nearest frontier not near `given_up` (k, 2), or none; at
    half the room from walls only where no other path is, as an error of the map may enclose the robot.
    """
    free = grid.log_odds < 0.0
    # free cells beside unknown areas of at least `GAP`, in rows as wide as the robot: walls have holes
    unknown = _large(grid.log_odds == 0.0, GAP / CELL**2)
    seen = _large(np.asarray(free & ndimage.binary_dilation(unknown, AROUND)), 2.0 * ROOM / CELL)
    beside = ndimage.binary_dilation(seen, AROUND, math.ceil(ROOM / CELL), mask=free)  # not through walls
    row, column = np.floor((start - grid.origin)[::-1] / grid.resolution).astype(int)
    near = np.zeros_like(seen)
    near[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4] = True
    near &= grid.log_odds <= 0.0  # the robot stands there, so it fits
    near[row, column] = True
    centres = grid.origin + (np.argwhere(np.ones_like(seen))[:, ::-1] + 0.5) * grid.resolution
    goal = np.flatnonzero(passable(grid)[0] & beside)
    goal = goal[np.hypot(*(centres[goal] - start).T) > CELL]
    if len(given_up):
        goal = goal[scipy.spatial.cKDTree(given_up).query(centres[goal])[0] > ROOMY]
    for room, limit in ((ROOM, NEARBY), (ROOM, np.inf), (0.5 * ROOM, np.inf)):
        open_, cost = passable(grid, room)
        before, length = shortest(open_ | near, cost, row * near.shape[1] + column, limit)
        if len(goal) and np.isfinite(length[goal]).any():
            cells = [int(goal[np.argmin(length[goal])])]
            while before[cells[-1]] >= 0:
                cells.append(int(before[cells[-1]]))
            return np.asarray(centres[cells[::-1]])
    return np.empty((0, 2))


def shortest(open_: BoolArray, cost: Array, start: int, limit: float = np.inf) -> tuple[IntArray, Array]:
    """The cell before each (H W,), negative for none, and the length [m] of its path, infinite beyond `limit`."""
    height, width = open_.shape
    number = np.arange(height * width, dtype=np.int32).reshape(height, width)
    rows, columns, lengths = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, height - dy), slice(max(-dx, 0), width - max(dx, 0)))
        b = (slice(dy, height), slice(max(dx, 0), width - max(-dx, 0)))
        both = open_[a] & open_[b]
        rows.append(number[a][both])
        columns.append(number[b][both])
        lengths.append(CELL * math.hypot(dy, dx) * 0.5 * (cost[a][both] + cost[b][both]))
    ends = np.concatenate(rows), np.concatenate(columns)
    graph = scipy.sparse.csr_array((np.concatenate(lengths), ends), shape=(number.size, number.size))
    shortest = scipy.sparse.csgraph.dijkstra
    length, before = shortest(graph, directed=False, indices=[start], return_predecessors=True, limit=limit)
    return before[0].astype(np.int64), length[0]

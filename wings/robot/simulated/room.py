"""Rooms of straight walls, and the echo of a sonar's cone in them: the worlds `walls:SEED`."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.se2 import Array
from wings.laser.floorplan.world import plan_of
from wings.robot.packets import CONE_HALF_ANGLE, RADIUS

GAP = 6.0 * RADIUS  # m, least distance between objects in a room: three robots wide, so a wall follower gets through
TRIES = 1000


@dataclass(frozen=True)
class Room:
    """Walls (S, 2, 2) by their end points [m], and the start pose (3,) [m, m, rad], world frame."""

    segments: Array
    start: Array


class Echo(NamedTuple):
    """The nearest wall point in each of N cones."""

    distance: Array  # (N,) m, inf where the cone is empty
    incidence: Array  # (N,) rad, 0 to pi/2, between the direction of that point and the wall's normal


def _box(x0: float, y0: float, x1: float, y1: float) -> Array:
    """Sides (4, 2, 2) of an axis-parallel rectangle."""
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def room(seed: int) -> Room:
    """The room of a seed: 0 is 10 x 6 m with two boxes; others vary in size, boxes and partition walls. Objects are at
    least `GAP` apart; the robot starts a metre from two walls, facing along the one on its right.
    """
    start = np.array([1.0, 1.0, 0.0])
    if seed == 0:
        return Room(np.concatenate([_box(0, 0, 10, 6), _box(2.5, 3.4, 3.7, 4.6), _box(6.2, 1.8, 7.6, 2.8)]), start)
    rng = np.random.default_rng(seed)
    width, depth = rng.uniform(7.0, 12.0), rng.uniform(5.0, 8.0)
    walls = [_box(0.0, 0.0, width, depth)]
    taken = [(0.0, 0.0, start[0] + 0.5, start[1] + 0.5)]
    if rng.random() < 0.5:
        x = rng.uniform(0.4, 0.6) * width
        length = rng.uniform(0.3, 0.5) * depth
        walls.append(np.array([[[x, depth], [x, depth - length]]]))
        taken.append((x, depth - length, x, depth))
    boxes = int(rng.integers(1, 5))
    for _ in range(TRIES):
        if not boxes:
            break
        w, d = rng.uniform(0.6, 1.6, 2)
        if min(width - w, depth - d) < 2.0 * GAP:
            continue
        x0, y0 = rng.uniform(GAP, width - GAP - w), rng.uniform(GAP, depth - GAP - d)
        new = (x0, y0, x0 + w, y0 + d)
        if all(_apart(new, other) >= GAP for other in taken):
            walls.append(_box(*new))
            taken.append(new)
            boxes -= 1
    return Room(np.concatenate(walls), start)


def floor_of(seed: int) -> Room:
    """The building of `floorplan:SEED` as a room; the robot starts on the first of its ways, along it."""
    building = plan_of(seed)
    at, to = building.ways.trace()[:2]
    return Room(building.walls.reshape(-1, 2, 2), np.array([*at, math.atan2(to[1] - at[1], to[0] - at[0])]))


def _apart(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> float:
    """Distance [m] of two rectangles x0, y0, x1, y1."""
    dx = max(a[0] - b[2], b[0] - a[2], 0.0)
    return math.hypot(dx, max(a[1] - b[3], b[1] - a[3], 0.0))


def cast(room: Room, poses: Array, half_angle: float = CONE_HALF_ANGLE) -> Echo:
    """Nearest wall point inside the cones of sensors at `poses` (N, 3), world frame, exactly: of each segment the foot
    of the perpendicular, an end, or where it meets an edge. A half angle of 0 is a beam, pi the whole circle.
    """
    poses = np.asarray(poses, float)
    a = room.segments[None, :, 0] - poses[:, None, :2]
    b = room.segments[None, :, 1] - poses[:, None, :2]
    e = b - a
    length2 = np.sum(e * e, axis=-1)
    share = np.clip(-np.sum(a * e, axis=-1) / length2, 0.0, 1.0)  # of the nearest point, were the cone all round
    shares = [share, np.zeros_like(share), np.ones_like(share)]
    for edge in (-half_angle, half_angle):
        dx, dy = np.cos(poses[:, 2, None] + edge), np.sin(poses[:, 2, None] + edge)
        across = e[..., 1] * dx - e[..., 0] * dy
        with np.errstate(divide="ignore", invalid="ignore"):
            shares.append((a[..., 0] * dy - a[..., 1] * dx) / across)
    u = np.stack(shares)  # (5, N, S)
    on_segment = (u >= 0.0) & (u <= 1.0)
    u = np.where(on_segment, u, 0.0)
    points = a + u[..., None] * e
    bearing = np.arctan2(points[..., 1], points[..., 0]) - poses[:, 2, None]
    bearing = np.abs(np.remainder(bearing + math.pi, 2.0 * math.pi) - math.pi)
    far = np.hypot(points[..., 0], points[..., 1])
    far = np.where(on_segment & (bearing <= half_angle + 1e-9), far, np.inf)
    which = np.argmin(far, axis=0)[None]
    far = np.take_along_axis(far, which, axis=0)[0]  # (N, S)
    wall = np.argmin(far, axis=1)
    rows = np.arange(len(poses))
    distance = far[rows, wall]
    point = np.take_along_axis(points, which[..., None], axis=0)[0][rows, wall]
    along = np.abs(np.sum(point * e[rows, wall], axis=-1))
    norm = np.sqrt(length2[0, wall]) * np.hypot(point[:, 0], point[:, 1])
    return Echo(distance, np.arcsin(np.clip(along / np.where(norm > 0.0, norm, 1.0), 0.0, 1.0)))


def clearance(room: Room, point: Array) -> float:
    """Distance [m] from a point (2,) or pose (3,) to the nearest wall."""
    a, b = room.segments[:, 0] - point[:2], room.segments[:, 1] - point[:2]
    e = b - a
    share = np.clip(-np.sum(a * e, axis=1) / np.sum(e * e, axis=1), 0.0, 1.0)
    return float(np.sqrt(np.sum((a + share[:, None] * e) ** 2, axis=1).min()))

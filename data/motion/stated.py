"""What an odometry with systematic errors would state of a way, were it not for its noise, with Jacobians.

The inverse of `data.motion.systematic.correct`.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from data.motion.systematic import BEARING, CURVATURE, DRIFT, LEFT, RANGE, RIGHT, SCALE
from data.se2 import Array, BoolArray
from data.sensors import wrap_angle


@numba.njit(cache=True)
def stated(way, errors, mount, leftwards, m, by_way, by_errors):  # type: ignore[no-untyped-def]
    """What an odometry with all errors (7,) would state, without noise, of the way (3,) of the sensor at `mount` (3,).

    `leftwards`: the odometry does state a turn to the left, so that its error is the one for these. Whether the way is
    one may change with every step of a search, which would get stuck at the kink where straight is.

    Fills in m (3,) and its Jacobians (3, 3) to the way and (3, 7) to the errors, all additive.
    """
    scale, slope = 1.0 + errors[SCALE], errors[CURVATURE] + errors[DRIFT]
    # the robot's way, u, out of the sensor's
    size, angle = 1.0 + errors[RANGE], errors[BEARING] - mount[2]
    c, s = math.cos(angle) / size, math.sin(angle) / size
    ax, ay = c * way[0] + s * way[1], c * way[1] - s * way[0]
    turn: float = wrap_angle(way[2])
    ct, st = math.cos(turn), math.sin(turn)
    qx, qy = ct * mount[0] - st * mount[1], st * mount[0] + ct * mount[1]
    ux, uy = ax + mount[0] - qx, ay + mount[1] - qy
    # as the odometry sees it
    D = math.copysign(math.hypot(ux, uy), ux)
    Dx, Dy = (ux / D, uy / D) if D != 0.0 else (1.0, 0.0)
    d = D / scale
    side = LEFT if leftwards else RIGHT
    more = 1.0 + errors[side]
    t = (turn - slope * d) / more
    half = 0.5 * (turn - t)
    ch, sh = math.cos(half) / scale, math.sin(half) / scale
    x, y = ch * ux + sh * uy, ch * uy - sh * ux
    m[0], m[1], m[2] = x, y, t
    # by u and the turn; what turns the odometry less turns the step back by half of it
    tx, ty, tt = -slope * Dx / (scale * more), -slope * Dy / (scale * more), 1.0 / more
    xx, xy, xt = ch - 0.5 * y * tx, sh - 0.5 * y * ty, 0.5 * y * (1.0 - tt)
    yx, yy, yt = -sh + 0.5 * x * tx, ch + 0.5 * x * ty, -0.5 * x * (1.0 - tt)
    by_way[0, 0], by_way[0, 1], by_way[0, 2] = xx * c - xy * s, xx * s + xy * c, xx * qy - xy * qx + xt
    by_way[1, 0], by_way[1, 1], by_way[1, 2] = yx * c - yy * s, yx * s + yy * c, yx * qy - yy * qx + yt
    by_way[2, 0], by_way[2, 1], by_way[2, 2] = tx * c - ty * s, tx * s + ty * c, tx * qy - ty * qx + tt
    by_errors[:, :] = 0.0
    by_errors[2, SCALE] = slope * d / (scale * more)
    by_errors[2, CURVATURE] = by_errors[2, DRIFT] = -d / more
    by_errors[2, side] = -t / more
    for e in range(RANGE):
        by_errors[0, e], by_errors[1, e] = -0.5 * y * by_errors[2, e], 0.5 * x * by_errors[2, e]
    by_errors[0, SCALE] -= x / scale
    by_errors[1, SCALE] -= y / scale
    for e, vx, vy in ((RANGE, -ax / size, -ay / size), (BEARING, ay, -ax)):
        by_errors[0, e], by_errors[1, e], by_errors[2, e] = xx * vx + xy * vy, yx * vx + yy * vy, tx * vx + ty * vy


@numba.njit(cache=True)
def _stated_all(way, errors, mount, leftwards, m, by_way, by_errors):  # type: ignore[no-untyped-def]
    for k in range(len(way)):
        stated(way[k], errors[k], mount, leftwards[k], m[k], by_way[k], by_errors[k])


def stated_all(way: Array, errors: Array, leftwards: BoolArray) -> tuple[Array, Array, Array]:
    """The same of the robot's own ways (n, 3) under errors (n, 7): (n, 3), Jacobians (n, 3, 3) and (n, 3, 7)."""
    n = len(way)
    found = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 7))
    _stated_all(np.array(way, float, order="C"), np.array(errors, float, order="C"), np.zeros(3), leftwards, *found)
    return found

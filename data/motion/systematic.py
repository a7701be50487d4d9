"""Systematic errors of odometry and sensor: what each does to an increment, with Jacobians.

Uneven wheels and a steering that is off centre turn a robot a little with every metre, and not as far as it thinks with
every turn (Borenstein and Feng, "Measurement and correction of systematic odometry errors in mobile robots", IEEE
Transactions on Robotics and Automation 12, 1996). The robot that measured (m, t) has moved by (1 + scale) R(e/2) m and
turned by t + e, where e = d (curvature + drift) + left max(t, 0) + right min(t, 0) and d is |m|, negative backwards.

A sensor whose ranges are (1 + range) times the true ones and whose bearings are true + bearing sees everything right
from a frame that is turned by -bearing in a world that is larger by (1 + range). In that frame, the sensor's (see
`data.motion.sensor_frame`), the measurement model has no error, and the increments have all of them. So filters and
smoothers take the errors in one place, as a function of the increments:

    increment(b) = (1 + range) Rot(bearing) E^-1 (corrected odometry) E Rot(-bearing),    E the sensor's mount.

The drift is an Ornstein-Uhlenbeck process over the distance travelled, constant between knots.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from data.inputs import ERRORS, Increment, IntArray, Systematic
from data.se2 import Array

SCALE, CURVATURE, LEFT, RIGHT, DRIFT, RANGE, BEARING = range(len(ERRORS))
"""Places of the errors among all of them."""
BETWEEN_KNOTS = 0.2
"""Of the drift's length: how far apart its knots are. The step at a knot is then 0.57 of the drift's sigma; half and
twice as many knots change no estimate by more than a tenth of its sigma in the tests' worlds."""


class Corrected(NamedTuple):
    """An increment under given errors: mean (3,), covariance (3, 3), Jacobian A (3, p) to the errors."""

    mean: Array
    covariance: Array
    A: Array


def places(systematic: Systematic) -> IntArray:
    """Where each of the errors (p,) stands among all."""
    return np.array([list(ERRORS).index(n) for n in systematic.names], np.int64)


@numba.njit(cache=True)
def correct(motion, errors, mount, mean, A, G):  # type: ignore[no-untyped-def]
    """The corrected increment `mean` (3,) of odometry's `motion` (3,) under all errors (7,).

    Also A (3, 7), its Jacobian to the errors, and G (3, 3), to the odometry's additive noise. `mount` (3,): pose of the
    sensor on the robot, zero to stay in the robot's own frame.
    """
    x, y, t = motion[0], motion[1], motion[2]
    d = math.hypot(x, y)
    if x < 0.0:
        d = -d
    positive, negative = max(t, 0.0), min(t, 0.0)
    e = d * (errors[CURVATURE] + errors[DRIFT]) + errors[LEFT] * positive + errors[RIGHT] * negative
    ch, sh = math.cos(0.5 * e), math.sin(0.5 * e)
    rx, ry = ch * x - sh * y, sh * x + ch * y
    ux, uy = (1.0 + errors[SCALE]) * rx, (1.0 + errors[SCALE]) * ry
    turn = t + e
    # R(turn) times the mount's position, and what the mount moves by for it
    ct, st = math.cos(turn), math.sin(turn)
    qx, qy = ct * mount[0] - st * mount[1], st * mount[0] + ct * mount[1]
    # the whole turn into the sensor's frame: bearing - mount's heading
    size = 1.0 + errors[RANGE]
    angle = errors[BEARING] - mount[2]
    c, s = size * math.cos(angle), size * math.sin(angle)
    vx, vy = ux + qx - mount[0], uy + qy - mount[1]
    mean[0], mean[1], mean[2] = c * vx - s * vy, s * vx + c * vy, turn
    # by e: half of the extra turn comes before the step, all of it moves the mount
    ex, ey = -0.5 * uy - qy, 0.5 * ux + qx
    dx, dy = c * ex - s * ey, s * ex + c * ey
    A[0, SCALE], A[1, SCALE], A[2, SCALE] = c * rx - s * ry, s * rx + c * ry, 0.0
    A[0, CURVATURE], A[1, CURVATURE], A[2, CURVATURE] = d * dx, d * dy, d
    A[0, LEFT], A[1, LEFT], A[2, LEFT] = positive * dx, positive * dy, positive
    A[0, RIGHT], A[1, RIGHT], A[2, RIGHT] = negative * dx, negative * dy, negative
    A[0, DRIFT], A[1, DRIFT], A[2, DRIFT] = d * dx, d * dy, d
    A[0, RANGE], A[1, RANGE], A[2, RANGE] = mean[0] / size, mean[1] / size, 0.0
    A[0, BEARING], A[1, BEARING], A[2, BEARING] = -mean[1], mean[0], 0.0
    G[0, 0], G[0, 1], G[0, 2] = c, -s, -c * qy - s * qx
    G[1, 0], G[1, 1], G[1, 2] = s, c, -s * qy + c * qx
    G[2, 0], G[2, 1], G[2, 2] = 0.0, 0.0, 1.0


@numba.njit(cache=True)
def _correct_all(motion, noise, errors, place, mount, mean, covariance, A):  # type: ignore[no-untyped-def]
    all_errors, whole, G = np.zeros(7), np.zeros((3, 7)), np.zeros((3, 3))
    for k in range(len(motion)):
        for j in range(len(place)):
            all_errors[place[j]] = errors[k, j]
        correct(motion[k], all_errors, mount, mean[k], whole, G)
        covariance[k] = G @ noise[k] @ G.T
        for j in range(len(place)):
            A[k, :, j] = whole[:, place[j]]


def corrected(increment: Increment, errors: Array, place: IntArray, mount: Array) -> Corrected:
    """One increment under errors (p,) that stand at `place` (p,) among all; `mount` as of `correct`."""
    one = corrected_all(increment.mean[None], increment.covariance[None], errors[None], place, mount)
    return Corrected(*(each[0] for each in one))


def corrected_all(mean: Array, covariance: Array, errors: Array, place: IntArray, mount: Array) -> Corrected:
    """The same for increments (n, 3), (n, 3, 3), each under its own errors (n, p): (n, 3), (n, 3, 3), (n, 3, p)."""
    n, p = len(mean), len(place)
    found = Corrected(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, p)))
    motion, noise, each = (np.array(a, float, order="C") for a in (mean, covariance, np.broadcast_to(errors, (n, p))))
    _correct_all(motion, noise, each, place, np.array(mount, float), found.mean, found.covariance, found.A)
    return found


@numba.njit(cache=True)
def knot(since, motion, step):  # type: ignore[no-untyped-def]
    """Before an increment `motion` (3,), `since` metres after the last knot: metres that a new knot here ends, 0 for
    no knot; and the metres since the last knot after the increment. A knot comes where `step` metres are reached.
    """
    ended = 0.0
    if since >= step:
        ended, since = since, 0.0
    return ended, since + math.hypot(motion[0], motion[1])


@numba.njit(cache=True)
def _knots(mean, step, of, ended):  # type: ignore[no-untyped-def]
    since, count = 0.0, 0
    for k in range(1, len(mean)):
        end, since = knot(since, mean[k], step)
        if end > 0.0:
            ended[count] = end
            count += 1
        of[k] = count
    return count


def knots(systematic: Systematic, mean: Array) -> tuple[IntArray, Array]:
    """Which knot's drift each increment (N, 3) has, (N,), and the metres (K - 1,) that each knot but the last held."""
    of, ended = np.zeros(len(mean), np.int64), np.zeros(len(mean))
    count = _knots(np.array(mean, float, order="C"), BETWEEN_KNOTS * systematic.length, of, ended)
    return of, ended[:count].copy()


@numba.njit(cache=True)
def forgotten(ended, length):  # type: ignore[no-untyped-def]
    """Of the drift over `ended` metres: the share that stays, and the share of its variance that comes anew."""
    stays = math.exp(-ended / length)
    return stays, 1.0 - stays * stays

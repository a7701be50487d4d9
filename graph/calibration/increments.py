"""An increment with systematic errors as a factor: exact in both poses wherever they go, linear in the errors.

A factor that is linear in the poses as well is exact for rigid motions of both to first order only. Far from where the
log began poses move by metres while increments are known to millimetres, and what is left out of it throws the estimate
about. So the residual is formed anew each time that gtsam linearizes the factor, at the errors as known then, and taken
from there to where gtsam has them by its tangent: these may be far apart, and none of the rest need be eliminated anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numba
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import Increment
from data.se2 import Array
from graph.calibration.variables import Errors
from graph.factors import noise
from graph.linear.increments import linearize_increments

Residual = Callable[[gtsam.CustomFactor, gtsam.Values, list[Array] | None], Array]
UNIT = noise.Unit.Create(3)


@numba.njit(cache=True)
def tangent(x, y, theta, x2, y2, theta2, at, errors, order, sigma, motion, root, place, mount):  # type: ignore[no-untyped-def]
    """Columns (3, 1 + 6 + p): the whitened residual of one increment and its Jacobians to both poses and the variables.

    Poses (x, y, theta), the second one after the increment; the residual is linearized at `errors` (p,) and taken to
    variables `at` (p,). Each of these is error `order` (p,), all in units of `sigma` (p,); others as of
    `linearize_increments`.
    """
    p = len(at)
    pose, b = np.array([[x, y, theta], [x2, y2, theta2]]), np.empty((1, p))
    residual, before, after, by = np.empty((1, 3)), np.empty((1, 3, 3)), np.empty((1, 3, 3)), np.empty((1, 3, p))
    for j in range(p):
        b[0, order[j]] = errors[j] * sigma[order[j]]
    linearize_increments(pose, motion, root, b, place, mount, residual, before, after, by)
    found = np.empty((3, 7 + p))
    for i in range(3):
        found[i, 0] = residual[0, i]
        for j in range(3):
            found[i, 1 + j], found[i, 4 + j] = before[0, i, j], after[0, i, j]
        for j in range(p):
            slope = by[0, i, order[j]] * sigma[order[j]]
            found[i, 7 + j] = slope
            found[i, 0] += slope * (at[j] - errors[j])
    return found


def increment_factor(
    errors: Errors, frame: int, increment: Increment, root: Array, knot: int, now: Array
) -> gtsam.CustomFactor:
    """The increment into a frame; root (3, 3): R with R'R the information of odometry's noise; `knot`: whose drift.

    `now` (q,): the constants as they are known, in prior sigmas, read each time that the factor is linearized.
    """
    keys = [X(frame - 1), X(frame), *errors.keys(knot)]
    return gtsam.CustomFactor(UNIT, keys, _residual(errors, keys, increment.mean, root, now))


def _residual(errors: Errors, keys: Sequence[int], mean: Array, root: Array, now: Array) -> Residual:
    """What gtsam asks for each time that it linearizes the factor."""
    before, after, q = keys[0], keys[1], len(errors.constant)
    constants, drift = keys[2], keys[-1] if errors.drift >= 0 else -1
    # copies: for arrays that cannot be written to the kernel would be compiled once more
    given = [np.array(a, float, order="C") for a in (errors.systematic.sigma, mean[None], root[None])]
    sigma, motion, roots = given
    order, place, mount = np.array(errors.order), np.array(errors.place), np.array(errors.frame.mount, float)

    def residual(_: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        p, r = values.atPose2(before), values.atPose2(after)
        if drift < 0:
            at, about = values.atVector(constants), now
        else:
            d = values.atVector(drift)
            at = np.concatenate([values.atVector(constants), d]) if q else d
            about = np.concatenate([now, d]) if q else d
        found = tangent(
            p.x(), p.y(), p.theta(), r.x(), r.y(), r.theta(), at, about, order, sigma, motion, roots, place, mount
        )
        if H is not None:
            H[0], H[1] = found[:, 1:4], found[:, 4:7]
            if q:
                H[2] = found[:, 7 : 7 + q]
            if drift >= 0:
                H[-1] = found[:, -1:]
        column: Array = found[:, 0]
        return column

    return residual

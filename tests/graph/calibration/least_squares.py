"""An oracle: all poses, landmarks and systematic errors by dense least squares, in the robot's own frame.

Nothing of the smoothers' is in it: no sensor's frame, no gtsam, no analytic derivative.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from data import se2
from data.inputs import ERRORS
from data.motion.systematic import knots
from tests.graph.calibrating import logarithm, stated_by_hand
from tests.graph.calibration.worlds import read_wrongly


class Solution(NamedTuple):
    """Newest pose and errors with covariances; landmarks (L, 2) with covariances."""

    pose: np.ndarray
    pose_covariance: np.ndarray
    errors: np.ndarray
    errors_covariance: np.ndarray
    xy: np.ndarray
    xy_covariance: np.ndarray


def solve(inputs, number, path, landmarks):
    """From the start path (N, 3) and landmarks (L, 2); number (M,) of each observation, row of `landmarks`."""
    s, n, o = inputs.systematic, len(inputs), inputs.observations
    of, ended = knots(s.length, inputs.increments.mean)
    constant = [j for j, name in enumerate(s.names) if name != "drift"]
    q, K = len(constant), (len(ended) + 1) * s.drifts
    drift = s.names.index("drift") if s.drifts else None
    slam = inputs.map is None
    white = np.linalg.inv(np.linalg.cholesky(inputs.increments.covariance[1:]))
    seen, first = np.linalg.inv(np.linalg.cholesky(o.R)), np.linalg.inv(np.linalg.cholesky(inputs.prior.covariance))

    def parts(x):
        b = np.zeros((n, len(s.names)))
        b[:, constant] = x[:q] * s.sigma[constant]
        if K:
            b[:, drift] = (x[q : q + K] * s.sigma[drift])[of]
        return b, x[q + K : q + K + 3 * n].reshape(n, 3), x[q + K + 3 * n :].reshape(-1, 2) if slam else landmarks

    def residuals(x):
        b, poses, xy = parts(x)
        errors = {name: b[1:, s.names.index(name)] if name in s.names else np.zeros(n - 1) for name in ERRORS}
        measured = inputs.increments.mean[1:]
        step = logarithm(se2.between(measured, stated_by_hand(se2.between(poses[:-1], poses[1:]), errors)))
        step[:, :2] = np.einsum("nij,nj->ni", [se2.rotation(t) for t in measured[:, 2]], step[:, :2])
        stays = np.exp(-ended / s.length) if K else np.empty(0)
        walk = x[q : q + K]
        z = read_wrongly(
            inputs.sensor,
            inputs.sensor.predict(poses[o.frame], xy[number]),
            s.names,
            dict(zip(s.names, b[-1], strict=True)),
        )
        return np.concatenate([
            x[:q], walk[:1], (walk[1:] - stays * walk[:-1]) / np.sqrt(1.0 - stays ** 2),
            first @ se2.pose_error(poses[0], inputs.prior.mean), np.einsum("nij,nj->ni", white, step).ravel(),
            np.einsum("nij,nj->ni", seen, inputs.sensor.residual(o.z, z)).ravel(),
        ])  # fmt: skip

    start = np.concatenate([np.zeros(q + K), path.ravel(), landmarks.ravel() if slam else []])
    found = least_squares(residuals, start, xtol=1e-12, ftol=1e-12, gtol=1e-10)
    C = np.linalg.inv(found.jac.T @ found.jac)
    b, poses, xy = parts(found.x)
    order = [*constant, *([drift] if K else [])]
    at = [*range(q), *([q + K - 1] if K else [])]
    of_errors = np.empty((len(order),) * 2)
    of_errors[np.ix_(order, order)] = C[np.ix_(at, at)] * np.outer(s.sigma[order], s.sigma[order])
    newest, rest = q + K + 3 * (n - 1), q + K + 3 * n
    of_map = np.array(
        [C[rest + 2 * i : rest + 2 * i + 2, rest + 2 * i : rest + 2 * i + 2] for i in range(len(xy) * slam)]
    )
    return Solution(poses[-1], C[newest : newest + 3, newest : newest + 3], b[-1], of_errors, xy, of_map)

"""Graduated non-convexity on a pose graph: which loop closures to accept, with a trusted chain.

Yang, Antonante, Tzoumas and Carlone, "Graduated Non-Convexity for Robust Spatial Perception", IEEE RA-L 5(2), 2020,
with truncated least squares: minimize the sum of min(d^2, c^2), d^2 the squared whitened residual of a loop closure.
"""

from __future__ import annotations

import numpy as np

from association.expectation import gate_threshold
from data.se2 import Array, BoolArray
from graph.poses.batch import Loss, PoseProblem, SmoothedPoses, descend, evaluate, finished

GROW = 1.4  # growth of the control parameter in each round, as in the paper
ROUNDS = 200  # upper bound: 100 take the control parameter from 1e-7 to 1e7
DIM = 3


def gnc_poses(problem: PoseProblem, start: Array, *, probability: float = 0.99) -> tuple[SmoothedPoses, BoolArray]:
    """The exact optimum over the accepted loop closures, and which those are (L,); `start` (K, 3).

    A loop closure is rejected if its d^2 at this optimum is not below the chi-square quantile (3 dof) of `probability`;
    so chi-square and covariances are slightly too small. A local method: consistent wrong loop closures can win. Raises
    `NotConvergedError`.
    """
    threshold = gate_threshold(probability, DIM)
    pose, believed, iterations = _graduate(problem, start, threshold)
    # block-coordinate descent on the truncated cost: the last weights need not match the poses
    before = np.inf
    while True:
        pose, weight, newton, cost, steps = descend(problem, pose, fixed(believed.astype(float)))
        iterations += steps
        square = squares(problem, pose)
        truncated = cost - float(square[believed].sum()) + float(np.minimum(square, threshold).sum())
        last, believed = believed, square < threshold
        if (believed == last).all() or not truncated < before:
            found = finished(problem, pose, weight, newton, cost, iterations, dof=DIM * int(last.sum()))
            return found, last
        before = truncated


def _graduate(problem: PoseProblem, pose: Array, threshold: float) -> tuple[Array, BoolArray, int]:
    """Rounds of weights (eq. 14 of the paper) and one Gauss-Newton step, until every weight is 0 or 1.

    The control parameter starts from the residuals at `pose`, not at the least-squares solution as in the paper, which
    many false loop closures distort.
    """
    square = squares(problem, pose)
    largest = float(square.max(initial=0.0))
    if largest <= threshold:
        return pose, np.ones(problem.loops, np.bool_), 0
    mu = threshold / max(2.0 * largest - threshold, threshold)
    weight = np.ones(problem.loops)
    rounds = 0
    while rounds < ROUNDS:
        rounds += 1
        low, high = mu / (mu + 1.0) * threshold, (mu + 1.0) / mu * threshold
        middle = np.sqrt(threshold / np.maximum(square, low) * mu * (mu + 1.0)) - mu
        weight = np.where(square <= low, 1.0, np.where(square >= high, 0.0, np.clip(middle, 0.0, 1.0)))
        pose = _step(problem, pose, weight)
        square = squares(problem, pose)
        if mu > 1.0 and ((weight == 0.0) | (weight == 1.0)).all():
            break
        mu *= GROW
    return pose, weight > 0.5, rounds


def _step(problem: PoseProblem, pose: Array, weight: Array) -> Array:
    """One Gauss-Newton step of the weighted problem, shortened until its cost falls; none if no share helps."""
    loss = fixed(weight)
    cost, _ = evaluate(problem, pose, loss)
    delta, share = problem.step(pose, weight).delta, 1.0
    while share > 1e-3:
        moved = pose + share * delta
        if evaluate(problem, moved, loss)[0] < cost:
            return moved
        share *= 0.5
    return pose


def fixed(weight: Array) -> Loss:
    """The loss of least squares with these weights (L,)."""
    return lambda square: (weight * square, weight)


def squares(problem: PoseProblem, pose: Array) -> Array:
    """Squared whitened residuals (L,) of the loop closures."""
    square: Array = (problem.residuals(pose)[problem.keys - 1 :] ** 2).sum(axis=1)
    return square

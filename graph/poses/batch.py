"""Batch optimization of a pose graph: the optimum of all constraints with its exact covariances, by sparse QR.

As `graph.optimum` does for landmarks: Gauss-Newton steps cut down until the cost falls, ended and judged by their
length in sigmas. A robust loss is on the norm of the whole whitened residual of a loop closure, by reweighting.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from data.se2 import Array, wrap_angle
from graph.factors import CAUCHY, HUBER, LOSSES
from graph.optimum import (
    ARMIJO,
    CONVERGED,
    ERROR_ROUNDING,
    SHORTEST,
    SHRANK,
    STEP,
    TINY,
    NotConvergedError,
)
from graph.poses.linear import Newton, PoseProblem

CUT = 30.0
"""sigma. From Cauchy's optimum on, a loop closure further off has no weight at all. There it has 0.1 %, a pull of 3 %
of a sigma; but two hundred false ones pull together: in grids of corridors with as many false loop closures as true
ones the path's error changed by up to a third, cut by less than 2 % (GNC: 0). Cut at 10, honest ones were lost, too."""
MOST = 400
"""Steps of one search. Of a robust loss 50 to 150 are usual."""
DEPTH = 6
"""Steps that an extrapolation is made of."""
ROUNDING = 1e-5
"""sigma. A step that hardly shrank and is shorter than this, for each direction, ends the search."""


Loss = Callable[[Array], tuple[Array, Array]]
"""Squared whitened residuals (L,) of the loop closures to twice their losses (L,) and their weights (L,)."""


@dataclass(frozen=True, eq=False)
class SmoothedPoses:
    """The optimum of a pose graph.

    Attributes:
        pose: (K, 3), world frame.
        covariance: (K, 3, 3), world frame, additive; of the information as weighted.
        weight: (L,) of each loop closure, 0: left out, 1: believed.
        cost: twice the sum of all losses; without a robust one the chi-square.
        dof: its degrees of freedom.
        iterations: steps in all.
        last_step: sigmas, largest component of the step that was left.
    """

    pose: Array
    covariance: Array
    weight: Array
    cost: float
    dof: int
    iterations: int
    last_step: float


def smooth_poses(problem: PoseProblem, start: Array, *, loss: str = "gaussian") -> SmoothedPoses:
    """The optimum reached from poses `start` (K, 3); `loss` (gaussian, huber, cauchy) is on loop closures only.

    Raises `NotConvergedError` where none was reached, ValueError for an unknown loss or a start that is not finite.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss {loss!r}; known: {', '.join(LOSSES)}")
    if start.shape != (problem.keys, 3) or not np.isfinite(start).all():
        raise ValueError("start: not a finite pose for every key pose")
    found = descend(problem, start, KERNELS[loss])
    if loss == "cauchy":
        first = found[-1]
        found = descend(problem, found[0], _cauchy_cut)
        return finished(problem, *found[:-1], first + found[-1])
    return finished(problem, *found)


def descend(problem: PoseProblem, pose: Array, loss: Loss) -> tuple[Array, Array, Newton, float, int]:
    """Steps from poses (K, 3), until one is short or leads no further down.

    Returns poses, weights of the loops (L,), the step that was left, the cost, and how many steps were made.
    """
    cost, weight = evaluate(problem, pose, loss)
    before, rounding = math.inf, ROUNDING * math.sqrt(3 * problem.keys)
    past: list[tuple[Array, Array]] = []
    for count in range(MOST + 1):
        newton = problem.step(pose, weight)
        left = newton.length
        if left < STEP or SHRANK * before < left < rounding or count == MOST:
            break
        past = [*past[1 - DEPTH :], (pose, newton.delta)]
        for share, moved in _trials(past):
            moved_cost, moved_weight = evaluate(problem, moved, loss)
            promised = share * (2.0 - share) * left**2
            if moved_cost <= cost - ARMIJO * promised + ERROR_ROUNDING * (1.0 + cost):
                break
            if share < 1.0:
                past = past[-1:]
        else:
            break
        pose, cost, weight, before = moved, moved_cost, moved_weight, left
    return pose, weight, newton, cost, count


def _trials(past: Sequence[tuple[Array, Array]]) -> Iterator[tuple[float, Array]]:
    """Where to go next, and which share of a step that is: extrapolated, in full, then shorter and shorter.

    Reweighting converges linearly, and slowly where a weight is in doubt. Anderson ("Iterative procedures for nonlinear
    integral equations", J. ACM 12, 1965): the mixture of the last steps that is the shortest leads further.
    """
    pose, delta = past[-1]
    if len(past) > 1:
        steps = np.array([d.ravel() for _, d in past])
        ends = np.array([(p + d).ravel() for p, d in past])
        change = np.diff(steps, axis=0)
        mix = np.linalg.lstsq(change.T, steps[-1], rcond=1e-8)[0]
        yield 1.0, (ends[-1] - mix @ np.diff(ends, axis=0)).reshape(pose.shape)
    share = 1.0
    while share > SHORTEST:
        yield share, pose + share * delta
        share *= 0.5


def evaluate(problem: PoseProblem, pose: Array, loss: Loss) -> tuple[float, Array]:
    """Twice the sum of all losses at poses (K, 3), and the weights (L,) of the loop closures there."""
    square = (problem.residuals(pose) ** 2).sum(axis=1)
    first = problem.keys - 1
    _, z, _ = problem.prior_residual(pose)
    cost, weight = loss(square[first:])
    return float(square[:first].sum() + z @ z) + float(cost.sum()), weight


def _gaussian(square: Array) -> tuple[Array, Array]:
    return square, np.ones(len(square))


def _huber(square: Array) -> tuple[Array, Array]:
    length = np.sqrt(np.maximum(square, HUBER**2))
    return np.where(square > HUBER**2, HUBER * (2.0 * length - HUBER), square), HUBER / length


def _cauchy(square: Array) -> tuple[Array, Array]:
    share = square / CAUCHY**2
    return CAUCHY**2 * np.log1p(share), 1.0 / (1.0 + share)


def _cauchy_cut(square: Array) -> tuple[Array, Array]:
    cost, weight = _cauchy(np.minimum(square, CUT**2))
    return cost, np.where(square > CUT**2, 0.0, weight)


KERNELS: dict[str, Loss] = {"gaussian": _gaussian, "huber": _huber, "cauchy": _cauchy}


def finished(
    problem: PoseProblem,
    pose: Array,
    weight: Array,
    newton: Newton,
    cost: float,
    iterations: int,
    dof: int | None = None,
) -> SmoothedPoses:
    """Where a search ended, with covariances; `dof` where they are not the problem's own.

    Raises `NotConvergedError` where that is no optimum.
    """
    dof = problem.dof if dof is None else dof
    covariance = problem.covariances(newton)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), TINY**2))
    share = np.abs(newton.delta) / sigma
    last_step = float(share.max())
    if not last_step < CONVERGED:
        raise NotConvergedError(
            f"the optimization did not converge: after {iterations} steps {last_step:.2g} sigma are left at key pose "
            f"{int(share.max(axis=1).argmax())}, cost {cost:.6g} for {dof} degrees of freedom"
        )
    pose = np.column_stack([pose[:, :2], wrap_angle(pose[:, 2])])
    return SmoothedPoses(pose, covariance, weight, cost, dof, iterations, last_step)

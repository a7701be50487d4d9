"""Batch smoothing robust to wrong associations: graduated non-convexity selects the accepted observations.

Yang, Antonante, Tzoumas and Carlone, "Graduated Non-Convexity for Robust Spatial Perception", IEEE RA-L 5(2), 2020,
with truncated least squares: minimize the sum of min(d^2, c^2), d^2 the squared whitened residual of an observation. A
round is one Gauss-Newton step by sparse QR, for points, walls, fixes and closures alike.
"""

from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from association.expectation import gate_threshold
from association.truncated import truncated_square
from data.inputs import Inputs, IntArray
from data.result import DISCARD
from data.se2 import Array, BoolArray
from graph.batch import Rejected, build, end_of, smooth
from graph.optimum import Smoothed
from graph.problem import Problem, Start
from graph.qr.elimination import Rows, eliminate, solve
from graph.qr.rows import Linearizer

GROW = 1.4  # growth of the control parameter in each round, as in the paper
ROUNDS = 200  # upper bound: 100 take the control parameter from 1e-7 to 1e7
SHORTEST = 1e-3  # share of a step below which it is not tried
LEAST = 1e-9  # least weight: a landmark of rejected observations alone keeps a position


class _At(NamedTuple):
    """An estimate, linearized, with squared whitened residuals of the measurements (k,) and of all else together."""

    values: gtsam.Values
    rows: Rows
    square: Array
    rest: float

    def cost(self, weight: Array) -> float:
        return self.rest + float(weight @ self.square)


class Graduated:
    """A problem whose measurements may be rejected: the observations, then fixes and closures, all in use."""

    def __init__(self, problem: Problem) -> None:
        self._linearizer = Linearizer(problem)
        self._blocks = self._linearizer.frames + np.arange(len(problem.observations) + len(problem.pose_factors))

    def at(self, values: gtsam.Values) -> _At:
        """The problem linearized at an estimate."""
        rows = self._linearizer(values)
        every = (rows.b[:, :, 0] ** 2).sum(axis=1)
        square = every[self._blocks]
        rest = every.sum() - square.sum() + (self._linearizer.constants(values) ** 2).sum()
        return _At(values, rows, square, float(rest))

    def search(self, values: gtsam.Values, threshold: Array) -> tuple[gtsam.Values, BoolArray]:
        """The estimate reached from `values`, and which measurements, with thresholds (k,) of their squared whitened
        residuals, have a weight above one half there. The control parameter starts from the residuals at `values`.
        """
        now = self.at(values)
        share = now.square / threshold
        largest = float(share.max(initial=0.0))
        if largest <= 1.0:
            return values, np.ones(len(threshold), np.bool_)
        mu = 1.0 / max(2.0 * largest - 1.0, 1.0)
        for _ in range(ROUNDS):
            # Weights (k,) of squared residuals in thresholds (eq. 14 of the paper).
            low, high = mu / (mu + 1.0), (mu + 1.0) / mu
            middle = np.sqrt(mu * (mu + 1.0) / np.maximum(share, low)) - mu
            weight = np.where(share <= low, 1.0, np.where(share >= high, 0.0, np.clip(middle, 0.0, 1.0)))
            now = self._step(now, weight)
            share = now.square / threshold
            if mu > 1.0 and ((weight == 0.0) | (weight == 1.0)).all():
                break
            mu *= GROW
        return now.values, weight > 0.5

    def _step(self, now: _At, weight: Array) -> _At:
        """One Gauss-Newton step of the weighted problem, shortened until its cost falls; none if no share helps."""
        linearizer, scale = self._linearizer, np.ones(len(now.rows.b))
        scale[self._blocks] = np.sqrt(np.maximum(weight, LEAST))
        rows = now.rows._replace(A=now.rows.A * scale[:, None, None], b=now.rows.b * scale[:, None, None])
        triangle = eliminate(rows, linearizer.structure)
        if triangle.free >= 0:
            return now
        solution = solve(rows, linearizer.structure, triangle, linearizer.constants(now.values))
        step = linearizer.step(linearizer.tangent(solution, now.values), solution.constants)
        share, cost = 1.0, now.cost(weight)
        while share > SHORTEST:
            moved = self.at(linearizer.moved(now.values, step.scale(share)))
            if moved.cost(weight) < cost:
                return moved
            share *= 0.5
        return now


PROBABILITY = 0.99  # of the chi-square quantile beyond which a measurement is rejected


def gnc(
    inputs: Inputs, decisions: IntArray, created: IntArray, start: Start, *, probability: float = PROBABILITY
) -> tuple[Smoothed, BoolArray]:
    """The exact optimum over the accepted measurements, and which observations those are: (M,), False where unused.
    Those of fixes and closures are in the result.

    Conventions of `graph.batch.smooth`. Prior, motion and known landmarks are trusted. A measurement is rejected if its
    squared whitened residual, at this optimum, is not below the chi-square quantile of `probability`; so chi-square and
    covariances are slightly too small, chi-square as `Smoothed.gated` says. A landmark without accepted observations
    leaves the map. It is a local method: consistent wrong pairings can win.

    Raises `UnderConstrained`, DataError for a singular covariance, ValueError for a probability not in (0, 1).
    """
    problem = build(inputs, decisions, created)
    graduated = Graduated(problem)
    dims = [s.dims for s in problem.observations] + [len(p.entries) for p in problem.pose_factors]
    threshold = np.array([gate_threshold(probability, d) for d in dims], float)
    used = np.flatnonzero(np.where(created >= 0, created, decisions) >= 0)
    if problem.motion.names:
        # with wrong errors, right pairings would be rejected
        start = end_of(smooth(inputs, decisions, created, start, loss="huber"), start.landmark, inputs.map)
    values, believed = graduated.search(problem.values(start), threshold)
    start = problem.start_of(values, start.landmark)
    # block-coordinate descent on the truncated cost, from the last weights, which need not match the solution
    before = np.inf
    while True:
        accepted = np.zeros(len(decisions), np.bool_)
        accepted[used[believed[: len(used)]]] = True
        kept = np.where(accepted, decisions, DISCARD), np.where(accepted, created, -1)
        result = smooth(inputs, *kept, start, rejected=_rejected(problem, ~believed[len(used) :]))
        start = end_of(result, start.landmark, inputs.map)
        square = graduated.at(problem.values(start)).square
        if result.map is not None and not problem.priors:
            # a landmark without accepted observations has no position
            square[: len(used)][~np.isin([s.number for s in problem.observations], result.map.number)] = np.inf
        cost = float(np.minimum(square, threshold).sum())
        believed, last = square < threshold, believed
        if (believed == last).all() or not cost < before:
            return _truncated(result, np.array(dims)[last], probability), accepted
        before = cost


def _truncated(result: Smoothed, dims: Array, probability: float) -> Smoothed:
    """The result with what its chi-square, and each NIS, are expected to be, of believed measurements (k,).

    With a measurement the cost is larger by its NIS against all others, and without it by the threshold. So at the
    minimum it is believed where its NIS is below the threshold: a truncated chi-square variable.
    """
    each = np.array([truncated_square(gate_threshold(probability, int(d)), int(d)) for d in dims]).reshape(-1, 2)
    mean, variance = (each.sum(axis=0) / max(int(dims.sum()), 1)).tolist()
    fixes, closures = (None if of is None else of._replace(gate=probability) for of in (result.fixes, result.closures))
    return replace(result, gated=(mean, variance) if len(dims) else None, fixes=fixes, closures=closures)


def _rejected(problem: Problem, out: BoolArray) -> Rejected:
    """Of fixes and closures (k,) in the order of the problem."""
    closure = np.array([p.closure for p in problem.pose_factors], np.bool_)
    fixes, closures = out[~closure], out[closure]
    return Rejected(fixes if len(fixes) else None, closures if len(closures) else None)

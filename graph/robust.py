"""Batch smoothing robust to wrong associations: graduated non-convexity selects the accepted observations.

Yang, Antonante, Tzoumas and Carlone, "Graduated Non-Convexity for Robust Spatial Perception", IEEE RA-L 5(2), 2020,
with truncated least squares: minimize the sum of min(d^2, c^2), d^2 the squared whitened residual of an observation.
gtsam's optimizer of that name cannot evaluate factors in Python, and optimizes to the end in every round. So with
fixes, closures, bearings or ranges a round is one Gauss-Newton step by sparse QR.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from association.expectation import gate_threshold
from association.truncated import truncated_square
from data.inputs import FrameObservations, Inputs, IntArray, LandmarkMap, Prior
from data.result import DISCARD
from data.se2 import Array, BoolArray
from graph.batch import Rejected, Start, build, smooth, start_values
from graph.factors import EXACT, Factor, ObservationFactors, graph_of, is_exact, noise, prior_factor
from graph.incremental import DELICATE
from graph.optimum import Smoothed, poses_of
from graph.problem import Problem
from graph.qr.elimination import Rows, eliminate
from graph.qr.rows import Linearizer
from graph.qr.solution import solve
from graph.systematic import Calibrated
from graph.walls import about, along, known_wall_factors, lines_of, placed, wall_factors

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
        """Weighted sum of squares."""
        return self.rest + float(weight @ self.square)


def graduated(problem: Problem, values: gtsam.Values, threshold: Array) -> tuple[gtsam.Values, BoolArray]:
    """The estimate reached from `values`, and which measurements have a weight above one half there.

    Measurements are the observations, then fixes and closures, all in use; each has a threshold (k,) of its squared
    whitened residual. Prior and motion are trusted. The control parameter starts from the residuals at `values`.
    """
    linearizer = Linearizer(problem)
    blocks = linearizer.frames + np.arange(len(threshold))
    now = _at(linearizer, values, blocks)
    share = now.square / threshold
    largest = float(share.max(initial=0.0))
    if largest <= 1.0:
        return values, np.ones(len(threshold), np.bool_)
    mu = 1.0 / max(2.0 * largest - 1.0, 1.0)
    for _ in range(ROUNDS):
        weight = _weights(share, mu)
        now = _step(linearizer, now, blocks, weight)
        share = now.square / threshold
        if mu > 1.0 and ((weight == 0.0) | (weight == 1.0)).all():
            break
        mu *= GROW
    return now.values, weight > 0.5


def _weights(share: Array, mu: float) -> Array:
    """Weights (k,) of squared residuals in thresholds (eq. 14 of the paper)."""
    low, high = mu / (mu + 1.0), (mu + 1.0) / mu
    middle = np.sqrt(mu * (mu + 1.0) / np.maximum(share, low)) - mu
    return np.where(share <= low, 1.0, np.where(share >= high, 0.0, np.clip(middle, 0.0, 1.0)))


def _at(linearizer: Linearizer, values: gtsam.Values, blocks: IntArray) -> _At:
    rows = linearizer(values)
    every = (rows.b[:, :, 0] ** 2).sum(axis=1)
    return _At(values, rows, every[blocks], float(every.sum() - every[blocks].sum()))


def _step(linearizer: Linearizer, now: _At, blocks: IntArray, weight: Array) -> _At:
    """One Gauss-Newton step of the weighted problem, shortened until its cost falls; none if no share helps."""
    scale = np.ones(len(now.rows.b))
    scale[blocks] = np.sqrt(np.maximum(weight, LEAST))
    rows = now.rows._replace(A=now.rows.A * scale[:, None, None], b=now.rows.b * scale[:, None, None])
    triangle = eliminate(rows, linearizer.structure)
    if triangle.free >= 0:
        return now
    solution = solve(rows, linearizer.structure, triangle, linearizer.constants(now.values))
    delta, share, cost = linearizer.tangent(solution, now.values), 1.0, now.cost(weight)
    while share > SHORTEST:
        moved = _at(linearizer, linearizer.moved(now.values, share * delta, share * solution.constants), blocks)
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
    threshold = thresholds(problem, probability)
    number = np.where(created >= 0, created, decisions)
    used = np.flatnonzero(number >= 0)
    if problem.calibrated is not None:
        # with wrong errors, right pairings would be rejected
        start = _as_start(smooth(inputs, decisions, created, start, loss="huber"), start, inputs.map)
    if problem.pose_factors or any(s.dims != 2 for s in problem.observations):
        start, believed = _graduate_all(problem, start, threshold)
    else:
        walls = None if inputs.sensor.sees_points else _walls(inputs, used, number, start)
        start, believed = _graduate(problem, start, probability, qr=is_delicate(inputs), walls=walls)
    # block-coordinate descent on the truncated cost, from the last weights, which need not match the solution and from
    # gtsam are separate for the two scalars of a relative point
    before = np.inf
    while True:
        accepted = np.zeros(len(decisions), np.bool_)
        accepted[used[believed[: len(used)]]] = True
        kept = np.where(accepted, decisions, DISCARD), np.where(accepted, created, -1)
        result = smooth(inputs, *kept, start, rejected=_rejected(problem, ~believed[len(used) :]))
        start = _as_start(result, start, inputs.map)
        square = _squares(problem, start)
        if result.map is not None and not problem.priors:
            # a landmark without accepted observations has no position
            alone = ~np.isin([s.number for s in problem.observations], result.map.number)
            square[: len(used)][alone] = np.inf
        cost = float(np.minimum(square, threshold).sum())
        believed, last = square < threshold, believed
        if (believed == last).all() or not cost < before:
            return _truncated(result, problem, last, probability), accepted
        before = cost


def _truncated(result: Smoothed, problem: Problem, believed: BoolArray, probability: float) -> Smoothed:
    """The result with what its chi-square, and each NIS, are expected to be where some are not believed (k,).

    With a measurement the cost is larger by its NIS against all others, and without it by the threshold. So at the
    minimum it is believed where its NIS is below the threshold: a truncated chi-square variable.
    """
    dims = np.array([s.dims for s in problem.observations] + [len(p.entries) for p in problem.pose_factors])[believed]
    each = np.array([truncated_square(gate_threshold(probability, int(d)), int(d)) for d in dims]).reshape(-1, 2)
    mean, variance = (each.sum(axis=0) / max(int(dims.sum()), 1)).tolist()
    fixes, closures = (None if of is None else of._replace(gate=probability) for of in (result.fixes, result.closures))
    return replace(result, gated=(mean, variance) if len(dims) else None, fixes=fixes, closures=closures)


def thresholds(problem: Problem, probability: float) -> Array:
    """Of the squared whitened residuals of observations, then of fixes and closures (k,)."""
    dims = [s.dims for s in problem.observations] + [len(p.entries) for p in problem.pose_factors]
    return np.array([gate_threshold(probability, d) for d in dims], float)


def _rejected(problem: Problem, out: BoolArray) -> Rejected:
    """Of fixes and closures (k,) in the order of the problem."""
    closure = np.array([p.closure for p in problem.pose_factors], np.bool_)
    fixes, closures = out[~closure], out[closure]
    return Rejected(fixes if len(fixes) else None, closures if len(closures) else None)


def _graduate_all(problem: Problem, start: Start, threshold: Array) -> tuple[Start, BoolArray]:
    """As `_graduate`, with fixes and closures, bearings and ranges: gtsam's optimizer takes one threshold for all
    dimensions, and no factor in Python. Systematic errors stay at the start.
    """
    values, calibrated = start_values(problem, start), problem.calibrated
    if calibrated is not None:
        errors = calibrated.errors(values)
        calibrated.remove(values)
        problem = problem.held(errors)
    values, believed = graduated(problem, values, threshold)
    found = _start_of(replace(problem, about=None), values, start)
    if problem.about is not None:
        found.landmark[problem.rows] = about(found.landmark[problem.rows], -problem.about)
    return found if calibrated is None else _of_robot(calibrated, errors, found, problem.rows), believed


def is_delicate(inputs: Inputs) -> bool:
    """Whether Cholesky elimination would fail so often that Levenberg-Marquardt is slow."""
    prior = np.linalg.eigvalsh(inputs.prior.covariance)
    motion = np.linalg.eigvalsh(inputs.increments.covariance[1:])
    return bool(prior[0] < DELICATE < prior[-1] or motion.min(initial=np.inf) < DELICATE)


class _Walls(NamedTuple):
    """Observations of walls as gtsam's own factors, further trusted factors, and start values of their variables."""

    observations: list[ObservationFactors]
    believed: list[Factor]
    values: gtsam.Values


def _walls(inputs: Inputs, used: IntArray, number: IntArray, start: Start) -> _Walls:
    """Observations `used` (m,) of walls `number` (M,): gtsam's optimizers cannot use the factors of the problem."""
    o, values, believed = inputs.observations, gtsam.Values(), list[Factor]()
    seen, frame, of = FrameObservations(o.z[used], o.R[used]), o.frame[used], number[used]
    pose = start.pose[frame]
    if inputs.map is not None:
        found = known_wall_factors(inputs.sensor, seen, frame, of, pose, inputs.map.positions(of), 0)
    else:
        found = wall_factors(inputs.sensor, seen, frame, of, pose, dict(enumerate(start.landmark)), 0)
        for n, first in zip(*np.unique(of, return_index=True), strict=True):
            wall = placed(start.landmark[n], pose[first, :2])
            believed.append(along(int(n), wall))
            values.insert(gtsam.symbol("l", int(n)), wall)
    for s in found:
        believed += s.measured[2:]
        for key, at in s.start_values:
            values.insert(key, at)
    return _Walls([replace(s, measured=s.measured[:2]) for s in found], believed, values)


def _graduate(
    problem: Problem, start: Start, probability: float, *, qr: bool, walls: _Walls | None = None
) -> tuple[Start, BoolArray]:
    """The solution of gtsam, and which observations have a weight above one half there: all their factors.

    Systematic errors stay at the start; accepted observations are tested again while they are estimated.

    Two defects of gtsam 4.3's GncOptimizer are worked around. It drops hard constraints, so here they have a sigma of
    `EXACT`. It stops where the cost hardly changes, so here only weights of 0 and 1 stop it, or its 100 iterations. Its
    control parameter starts from the residuals at `start`, not at the first least-squares solution as in the paper.
    """
    values, calibrated = start_values(problem, start), problem.calibrated
    if calibrated is not None:
        errors = calibrated.errors(values)
        calibrated.remove(values)
        problem = problem.held(errors)
    if walls is not None:
        for n in problem.numbers.tolist():
            values.erase(gtsam.symbol("l", n))
        values.insert(walls.values)
        problem = replace(problem, observations=walls.observations)
    prior = problem.prior
    if is_exact(prior):  # no hard constraint
        prior = Prior(prior.mean, (2.0 * EXACT) ** 2 * np.eye(3))
    believed: list[Factor] = [prior_factor(prior), *problem.motion, *([] if walls is None else walls.believed)]
    believed += [
        gtsam.PriorFactorPoint2(s.key, s.xy, noise.Isotropic.Sigma(2, EXACT))
        for s in problem.observations
        if s.key is not None and s.xy is not None
    ]
    believed += [p.factor for p in problem.priors]
    steps = gtsam.LevenbergMarquardtParams()
    steps.setLinearSolverType("MULTIFRONTAL_QR" if qr else "MULTIFRONTAL_CHOLESKY")
    parameters = gtsam.GncLMParams(steps)
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setKnownInliers(range(len(believed)))
    parameters.setRelativeCostTol(0.0)
    graph = graph_of([*believed, *(f for s in problem.observations for f in s.measured)])
    optimizer = gtsam.GncLMOptimizer(graph, values, parameters)
    count = np.array([len(s.measured) for s in problem.observations], np.int64)
    # one quantile for all: of the pair, or such that two independent scalars both pass as often as the pair
    quantile = gate_threshold(np.sqrt(probability), 1) if (count == 2).all() else gate_threshold(probability)
    optimizer.setInlierCostThresholds(0.5 * quantile)
    values = optimizer.optimize()
    weight = optimizer.getWeights()[len(believed) :]
    first = np.cumsum(count) - count
    smallest = np.minimum.reduceat(weight, first) if len(count) else weight
    found = _start_of(problem, values, start)
    return found if calibrated is None else _of_robot(calibrated, errors, found, problem.rows), smallest > 0.5


def _of_robot(calibrated: Calibrated, errors: Array, found: Start, rows: IntArray) -> Start:
    """A solution in the sensor's frame as the robot's in the world: its poses, landmarks of these rows, and errors."""
    found.landmark[rows] = calibrated.frame.points_out(found.landmark[rows], errors[-1])[0]
    return Start(calibrated.frame.poses_out(found.pose, errors)[0], found.landmark, errors)


def _start_of(problem: Problem, values: gtsam.Values, start: Start) -> Start:
    """Values as a start; landmarks that are not in the problem are unchanged."""
    landmark = start.landmark.copy()
    keys = [gtsam.symbol("l", n) for n in problem.numbers.tolist()]
    if problem.about is None:
        landmark[problem.rows] = np.array([values.atPoint2(key) for key in keys]).reshape(-1, 2)
    else:
        landmark[problem.rows] = lines_of([values.atPose2(key) for key in keys])[0]
    return Start(poses_of(values, len(problem.motion) + 1), landmark)


def _as_start(result: Smoothed, start: Start, known: LandmarkMap | None) -> Start:
    """A solution as a start; landmarks that are not in it are unchanged, so that rejected observations may return."""
    landmark = start.landmark.copy()
    if result.map is not None:
        number = result.map.number
        landmark[number if known is None else known.rows(number)] = result.map.xy
    return Start(result.trajectory.pose, landmark, None if result.systematic is None else result.systematic.mean)


def _squares(problem: Problem, at: Start) -> Array:
    """Squared whitened residual of every observation, then of fixes and closures."""
    values = start_values(problem, at)
    if problem.calibrated is not None:
        problem = problem.held(problem.calibrated.errors(values))
    observed = [2.0 * sum(f.error(values) for f in s.measured) for s in problem.observations]
    return np.array([*observed, *(2.0 * p.factor.error(values) for p in problem.pose_factors)], float)

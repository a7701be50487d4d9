"""Batch smoothing: all poses and landmarks of a log from all its data, for given decisions; its chordal start.

Chordal start: relations state R_j = R_i M and t_j = t_i + R_i m. Without the constraint that R is a rotation the first
is linear, each row of R on its own; the solution is projected onto rotations (Martinec and Pajdla, "Robust rotation and
translation estimation in multiview reconstruction", CVPR 2007; Carlone et al., "Initialization techniques for 3D SLAM",
ICRA 2015).

Robust to wrong associations: graduated non-convexity selects the accepted observations (Yang, Antonante, Tzoumas and
Carlone, "Graduated Non-Convexity for Robust Spatial Perception", IEEE RA-L 5(2), 2020), with truncated least squares:
minimize the sum of min(d^2, c^2), d^2 the squared whitened residual of an observation. A round is one Gauss-Newton step
by sparse QR, for points, walls, fixes and closures alike.
"""

from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from association.expectation import gate_threshold
from association.truncated import truncated_square
from data.errors import UsageError
from data.inputs import Inputs, IntArray, LandmarkMap
from data.result import DISCARD
from data.se2 import Array, BoolArray, between, compose, pose_error
from graph.factors import LOSSES, ObservationFactors, known_landmark_factors, landmark_factors
from graph.optimum import STEP, Smoothed, optimize
from graph.pose_factors import PoseFactor, closure_factors, fix_factors
from graph.problem import Problem, Start, landmark_priors, refuse
from graph.qr.elimination import Rows, eliminate, solve
from graph.qr.rows import Linearizer
from graph.systematic import errors_of
from graph.walls import line_factors


def smooth(
    inputs: Inputs, decisions: IntArray, created: IntArray, start: Start, *, loss: str = "gaussian",
    rejected: BoolArray | None = None, with_shares: bool = False, enough: float = STEP,
) -> Smoothed:  # fmt: skip
    """Maximum a posteriori path (and map): a minimum reached from `start`.

    Inputs with a map: localization, decisions (M,) are map ids or `DISCARD`; landmarks of an uncertain map are
    estimated. Without: SLAM, decisions are landmark numbers, `NEW` or `DISCARD`, and `created` (M,) is the number of
    the landmark an observation initialized (-1: none). `loss`: gaussian, huber or cauchy, on measurements only; fixes
    and closures are such. `rejected` (F + K,): fixes, then closures, that take no part; None: all do. `with_shares`,
    `enough`: see `optimize`. Raises `UnderConstrained` (`NotConvergedError` if no minimum was reached), and DataError
    for a singular covariance.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss {loss!r}; known: {', '.join(LOSSES)}")
    problem = build(inputs, decisions, created, loss, rejected)
    found = optimize(problem, problem.values(start), loss=loss, with_shares=with_shares, enough=enough)
    cut = None if loss != "cauchy" else _far_closures(inputs, found.trajectory.pose, rejected)
    if cut is None:
        return found
    problem = build(inputs, decisions, created, loss, cut)
    end = end_of(found, start.landmark, inputs.map)
    again = optimize(problem, problem.values(end), loss=loss, with_shares=with_shares, enough=enough)
    done = again.closures
    if done is None:
        return again
    # no gate rejected them: it is the loss that gives them no weight
    by_loss = (cut if rejected is None else cut & ~rejected)[-len(done.used) :]
    return replace(again, closures=done._replace(used=done.used | by_loss))


def end_of(found: Smoothed, others: Array, known: LandmarkMap | None) -> Start:
    """A solution as a start; landmarks that are not in it as in `others` (L, 2), so that they may return."""
    places = others.copy()
    if found.map is not None:
        places[found.map.number if known is None else known.rows(found.map.number)] = found.map.xy
    return Start(found.trajectory.pose, places, None if found.systematic is None else found.systematic.mean)


CUT = 30.0
"""sigma. At Cauchy's optimum a closure further off is left out. There it has a pull of 3 % of a sigma, but two hundred
false ones add up: in grids of corridors with as many false loop closures as true ones they changed the path's error by
up to a third, cut by less than 2 %. Cut at 10, true ones were lost, too."""


def _far_closures(inputs: Inputs, pose: Array, rejected: BoolArray | None) -> BoolArray | None:
    """What takes no part (F + K,), with closures beyond `CUT` at poses (N, 3); None: there are none of these."""
    c, fixes = inputs.closures, 0 if inputs.fixes is None else len(inputs.fixes)
    if c is None:
        return None
    off = pose_error(between(pose[c.frame1], pose[c.frame2]), c.relative)
    square = np.einsum("ki,ki->k", off, np.linalg.solve(c.covariance, off[:, :, None])[:, :, 0])
    far = np.append(np.zeros(fixes, bool), square > CUT**2)
    out = far if rejected is None else far | rejected
    return out if (far if rejected is None else far & ~rejected).any() else None


def build(
    inputs: Inputs, decisions: IntArray, created: IntArray, loss: str = "gaussian", rejected: BoolArray | None = None
) -> Problem:
    """The factors of a log under given decisions."""
    refuse(inputs.systematic, inputs.map, inputs.sensor)
    errors, of_poses = errors_of(inputs.systematic, inputs.sensor, inputs.prior), _of_poses(inputs, loss, rejected)
    if of_poses:
        errors.refuse_pose_measurements()
    motion = errors.along(inputs.increments)
    number = np.where(created >= 0, created, decisions)
    used = np.flatnonzero(number >= 0)
    o, walls = inputs.observations, not inputs.sensor.sees_points
    sensors = [errors.frame.sensor(inputs.sensor)] if o.sensor is None else [*inputs.sensors]
    if len(sensors) > 1 and (motion.names or not all(s.sees_points for s in sensors)):
        raise UsageError("a log with several sensors: they must observe points, without systematic errors to estimate")
    exact, about = inputs.map is not None and inputs.map.sigma is None, inputs.prior.mean[:2]
    found = list[ObservationFactors]()
    for i, sensor in enumerate(sensors):
        rows = used if o.sensor is None else used[o.sensor[used] == i]
        seen = (sensor, o.z[rows], o.R[rows], o.frame[rows], number[rows])
        at = None
        if inputs.map is not None:
            there = inputs.map.rows(number[rows])
            if (there < 0).any():
                raise UsageError(f"decision {number[rows][there < 0][0]}: the map has no landmark of this id")
            at = inputs.map.xy[there]
        if walls:
            found += line_factors(*seen, about, loss, at)
        elif at is not None and exact:
            found += known_landmark_factors(*seen, at, len(found), loss)
        else:
            found += landmark_factors(*seen, loss)
    found.sort(key=lambda s: s.frame)
    priors = landmark_priors(inputs.map, np.unique(number[used]))
    return Problem(inputs.prior, motion, found, exact, about if walls else None, of_poses, priors)


def _of_poses(inputs: Inputs, loss: str, rejected: BoolArray | None) -> list[PoseFactor]:
    f, c = inputs.fixes, inputs.closures
    found = [] if f is None else fix_factors(f.frame.tolist(), f, f.sources, loss)
    found += [] if c is None else closure_factors(c, loss)
    if rejected is None:
        return found
    return [p.left_out() if out else p for p, out in zip(found, rejected.tolist(), strict=True)]


def chordal(ends: IntArray, M: Array, m: Array, turn: Array, shift: Array) -> tuple[Array, Array]:
    """Rotations (V, d, d) and translations (V, d) of poses 0 ... V - 1; the first of each connected part is the origin.

    Relations tie poses `ends` (n, 2), with measured rotations M (n, d, d) and translations m (n, d), and with
    information about the rotations, `turn` (n,), and about the translations, `shift` (n,), a number each.
    """
    d = m.shape[1]
    free = _free(ends, int(ends.max()) + 1)
    eye = np.tile(np.eye(d), (len(ends), 1, 1))
    # The nearest rotations to R' (V, d, d), transposed; a matrix without rank keeps to the identity.
    X = _solved(ends, free, M.transpose(0, 2, 1), eye, np.zeros((len(ends), d, d)), turn, np.eye(d))
    U, s, Vt = np.linalg.svd(X.transpose(0, 2, 1))
    U[:, :, -1] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    R: Array = U @ Vt
    lost = ~(s[:, -1] > 1e-9 * np.maximum(s[:, 0], 1.0)) if X.shape[1] == 2 else ~(s[:, 1] > 1e-9)
    R[lost] = np.eye(X.shape[1])
    ahead = np.einsum("nij,nj->ni", R[ends[:, 0]], m)[:, :, None]
    return R, _solved(ends, free, eye, eye, ahead, shift, np.zeros((d, 1)))[:, :, 0]


def chordal_path(inputs: Inputs) -> Array:
    """Poses (N, 3) of a log from its increments and closures, from the mean of its prior on."""
    n, steps, closures = len(inputs), inputs.increments, inputs.closures
    ends = np.stack([np.arange(n - 1), np.arange(1, n)], 1)
    relative, C = steps.mean[1:], steps.covariance[1:]
    if closures is not None:
        ends = np.concatenate([ends, np.stack([closures.frame1, closures.frame2], 1)])
        relative, C = np.concatenate([relative, closures.relative]), np.concatenate([C, closures.covariance])
    if not len(ends):
        return inputs.prior.mean[None].copy()
    c, s = np.cos(relative[:, 2]), np.sin(relative[:, 2])
    M = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
    R, t = chordal(ends, M, relative[:, :2], 1.0 / C[:, 2, 2], 2.0 / (C[:, 0, 0] + C[:, 1, 1]))
    return compose(inputs.prior.mean, np.column_stack([t, np.arctan2(R[:, 1, 0], R[:, 0, 0])]))


def _free(ends: IntArray, count: int) -> IntArray:
    """Number (count,) of each pose among those that are solved for; -1: the first of its part."""
    pairs = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (count, count))
    label = connected_components(pairs, directed=False)[1]
    free = np.ones(count, bool)
    free[np.unique(label, return_index=True)[1]] = False
    return np.where(free, np.cumsum(free) - 1, -1)


def _solved(ends: IntArray, free: IntArray, B: Array, C: Array, e: Array, weight: Array, first: Array) -> Array:
    """Unknowns (V, d, c) of  C x_j = B x_i + e  (n, d, c) in least squares; those that are not free are `first`."""
    n, d, c = e.shape
    root = np.sqrt(weight / max(float(weight.mean()), np.finfo(float).tiny))
    rows, columns, values = [], [], []
    b = root[:, None, None] * e
    at = d * np.arange(n)[:, None, None] + np.arange(d)[:, None]
    for side, block in ((0, -B), (1, C)):
        place, block = free[ends[:, side]], root[:, None, None] * block
        held = place < 0
        b[held] -= block[held] @ first
        rows.append(np.broadcast_to(at, block.shape)[~held].ravel())
        columns.append(np.broadcast_to(d * place[:, None, None] + np.arange(d), block.shape)[~held].ravel())
        values.append(block[~held].ravel())
    size = d * (int(free.max(initial=-1)) + 1)
    out = np.tile(first, (len(free), 1, 1)).astype(float)
    if size:
        A = csc_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (n * d, size))
        out[free >= 0] = np.asarray(spsolve((A.T @ A).tocsc(), A.T @ b.reshape(n * d, c))).reshape(-1, d, c)
    return out


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
        result = smooth(inputs, *kept, start, rejected=~believed[len(used) :])
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
    """The result with the chi-square and NIS that are expected where those beyond a threshold are left out."""
    each = np.array([truncated_square(gate_threshold(probability, int(d)), int(d)) for d in dims]).reshape(-1, 2)
    mean, variance = (each.sum(axis=0) / max(int(dims.sum()), 1)).tolist()
    fixes, closures = (None if of is None else of._replace(gate=probability) for of in (result.fixes, result.closures))
    return replace(result, gated=(mean, variance) if len(dims) else None, fixes=fixes, closures=closures)

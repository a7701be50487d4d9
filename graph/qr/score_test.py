"""Score test of systematic errors: the evidence for each hypothetical one, besides path and map.

Every hypothetical error has one unknown size, zero under the null hypothesis. Around the smoothed solution the sizes
are regression coefficients. Eliminating path and map from a column for each error leaves the derivative of the profile
log-likelihood and its covariance (Rao, "Large sample tests of statistical hypotheses concerning several parameters",
Proc. Cambridge Phil. Soc. 44, 1948). Systematic errors estimated by the smoother, with their priors, are profiled out
likewise: the log is corrected by them (`data.motion.systematic`), in the robot's own frame. Each has a column in prior
sigmas, and a prior.
"""

from typing import NamedTuple

import numpy as np

from data.inputs import Inputs, IntArray
from data.motion.systematic import BEARING, RANGE, all_errors, corrected_inputs, stated_all
from data.pose_measurements import GaussianMeasurement, closure_of, fixes_of
from data.result import Systematics
from data.se2 import Array, BoolArray, between, compose, pose_error, worlds_from_bodies
from data.sensors import RANGE_BEARING
from graph.factors import EXACT, UnderConstrained, root_information
from graph.qr import elimination
from graph.qr.rows import put_prior, with_drift
from graph.systematic import Motion, errors_of


class OfPoses(NamedTuple):
    """Fixes (F,) and closures (K,) besides the observations: which are used, and their derivatives by each error."""

    fixes: BoolArray  # (F,) used
    by_fixes: Array  # (F, 3, p) of z, by entry of (x, y, theta)
    closures: BoolArray  # (K,) used
    by_closures: Array  # (K, 3, p) of the relative pose


Blocks = tuple[IntArray, Array, Array, IntArray]
"""Variables, coefficients, right-hand sides and heights of blocks of rows, as of `Rows`."""


def blocks_of_poses(inputs: Inputs, path: Array, of: OfPoses, columns: int) -> Blocks:
    """Whitened rows of used fixes and closures at a path (N, 3): residual, minus effects, zeros up to `columns`."""
    found = list[tuple[GaussianMeasurement, tuple[int, ...], Array]]()
    if (f := inputs.fixes) is not None:
        each = zip(fixes_of(f, f.sources), f.frame.tolist(), of.by_fixes, of.fixes.tolist(), strict=True)
        found += [(m, (frame,), by) for m, frame, by, used in each if used]
    if (c := inputs.closures) is not None:
        for i in np.flatnonzero(of.closures).tolist():
            ends = int(c.frame1[i]), int(c.frame2[i])
            found.append((closure_of(c.relative[i], c.covariance[i], 0, 3, 6), ends, of.by_closures[i]))
    count = len(found)
    variable, height = np.full((count, 2), -1), np.zeros(count, np.int64)
    A, b = np.zeros((count, 3, 6)), np.zeros((count, 3, columns))
    for i, (m, frames, by) in enumerate(found):
        nu, H = m.innovation(path[list(frames)].ravel())
        root, d = np.linalg.inv(np.linalg.cholesky(m.R)), len(nu)
        variable[i, : len(frames)], height[i] = frames, d
        A[i, :d, : H.shape[1]], b[i, :d, 0] = root @ H, root @ nu
        b[i, :d, 1 : 1 + by.shape[1]] = -root @ by[list(m.entries)]
    return variable, A, b, height


class Estimated(NamedTuple):
    """Estimated errors besides path and map, in prior sigmas; there may be none."""

    motion: Array  # (N, 3, q) effect of a unit of each constant error on the increments
    observed: Array  # (m, 2, q) effect on the observations
    now: Array  # (q,) estimated sizes
    by_drift: Array  # (N, 3) effect of a unit of its knot's drift on an increment; without a drift unused
    steps: Array  # (K,) whitened ones of the estimated drift
    of: Motion


def estimated_errors(
    inputs: Inputs, found: Systematics | None, path: Array, frame: IntArray, z_hat: Array
) -> Estimated:
    """Of `inputs` with errors `found`, at a path (N, 3), for observations from frames (m,) expected at z_hat (m, 2)."""
    of = errors_of(None if found is None else inputs.systematic, inputs.sensor, inputs.prior).along(inputs.increments)
    if found is None:
        found = Systematics((), np.empty((len(path), 0)), np.empty((len(path), 0)))
    every, place, sigma = all_errors(found), of.place, of.sigma
    of_odometry = every.copy()
    of_odometry[:, [RANGE, BEARING]] = 0.0
    # the errors act on the smoothed motion (see `graph.systematic`), not on the stated one
    _, by_way, by_error = stated_all(between(path[:-1], path[1:]), of_odometry[1:], inputs.increments.mean[1:, 2] > 0.0)
    motion, observed = np.zeros((len(path), 3, len(place))), np.zeros((len(frame), 2, len(place)))
    motion[1:] = (np.linalg.inv(by_way) @ by_error)[:, :, place] * sigma
    motion[:, :, place >= RANGE] = 0.0
    size = 1.0 + every[frame, RANGE]
    for i in np.flatnonzero(place >= RANGE):
        if inputs.sensor.kind == RANGE_BEARING:
            more = np.eye(2)[place[i] - RANGE] * np.column_stack([z_hat[:, 0] / size, np.ones(len(frame))])
        elif place[i] == RANGE:
            more = z_hat / size[:, None]
        else:
            more = np.column_stack([-z_hat[:, 1], z_hat[:, 0]])
        observed[:, :, i] = more * sigma[i]
    at, now = of.constant, found.mean[-1] / sigma
    by_drift = motion[:, :, of.drift] if of.knots else np.zeros((len(path), 3))
    return Estimated(motion[:, :, at], observed[:, :, at], now[at], by_drift, of.drift_steps(found.mean), of)


def without_errors(left: Array, now: Array) -> Array:
    """Products (1 + p, 1 + p) of residuals and columns, with the estimated errors `now` (q,) eliminated. `left` (1 + p
    + q, ...): theirs come last, with the sign that columns have there. Each has its prior.
    """
    q, at = len(now), len(left) - len(now)
    with_prior = left.copy()
    with_prior[at:, at:] += np.eye(q)
    with_prior[0, at:] += now
    with_prior[at:, 0] += now
    with_prior[0, 0] += now @ now
    across = with_prior[:at, at:]
    return with_prior[:at, :at] - across @ np.linalg.solve(with_prior[at:, at:], across.T)


ALIKE = 1e-9  # share of an error's information that others leave if they explain it wholly: rounding
UNIDENTIFIABLE = 1e-16  # least share of a column's square that path and map must leave; less is rounding


class Score(NamedTuple):
    """Score of p systematic errors; zero for an error that the data cannot identify."""

    score: Array  # (p,) derivative of the profile log-likelihood by the size of each error, at size zero
    information: Array  # (p, p) covariance of the score under the null hypothesis

    @property
    def sigmas(self) -> Array:
        """Estimate of each error alone in units of its standard deviation (p,): N(0, 1) under the null hypothesis."""
        root = np.sqrt(np.diag(self.information))
        return np.divide(self.score, root, out=np.zeros_like(root), where=root > 0.0)

    def given(self, others: IntArray) -> "Score":
        """The score with the errors `others` (q,) estimated as well."""
        root = np.sqrt(np.diag(self.information))
        scale = np.where(root > 0.0, root, 1.0)
        score, correlation = self.score / scale, self.information / np.outer(scale, scale)
        # pseudo-inverse: the scales of odometry and of ranges, of which SLAM identifies one, may both be others
        inverse = np.linalg.pinv(correlation[np.ix_(others, others)], rcond=ALIKE, hermitian=True)
        across = correlation[:, others] @ inverse
        left = correlation - across @ correlation[others]
        identifiable = np.diag(left) > ALIKE
        identifiable[others] = False
        score = scale * (score - across @ score[others])
        left = 0.5 * (left + left.T) * np.outer(scale, scale)
        return Score(np.where(identifiable, score, 0.0), np.where(np.outer(identifiable, identifiable), left, 0.0))


def systematic(
    inputs: Inputs, number: IntArray, path: Array, landmarks: Array, motion: Array, observed: Array,
    found: Systematics | None = None, of_poses: OfPoses | None = None,
) -> Score:  # fmt: skip
    """Score of p hypothetical errors phi, linearized at a smoothed path (N, 3) with landmarks (L, 2), world frame.

    Model: stated increment k = true one + motion[k] phi + noise (body frame of k - 1), observation i = noise-free
    measurement + observed[i] phi + noise, the first pose according to the prior. `motion` (N, 3, p) and `observed` (M,
    2, p) are derivatives by a unit of each error. Those by distances, turns or ranges must come from the smoothed
    solution: measured values share the residuals' noise, which biases a scale (in the arena by 7 sigma). `number` (M,)
    is the row of `landmarks` of each observation, -1: not used; of inputs with a map it is the row there.

    `of_poses`: fixes and closures that the solution stands on as well, and what the errors do to them.

    `found` are the errors of `inputs.systematic` that were estimated. `motion` and `observed` are then of the corrected
    log, and an estimated error shows as far as its prior held it back.

    Raises UnderConstrained for a landmark or pose that the data do not determine, LinAlgError for a singular
    observation covariance.
    """
    left, size = _eliminated(inputs, number, path, landmarks, motion, observed, found, of_poses)[3:]
    identifiable = np.diag(left)[1:] > UNIDENTIFIABLE * size[1:]
    score = np.where(identifiable, -left[1:, 0], 0.0)
    return Score(score, np.where(np.outer(identifiable, identifiable), left[1:, 1:], 0.0))


def evidence(inputs: Inputs, number: IntArray, path: Array, landmarks: Array, of_poses: OfPoses) -> float:
    """Logarithm of the marginal likelihood of all data, up to a constant of the frames and the landmarks used.

    Path and map are integrated out around a smoothed solution (Laplace's method): minus half the least cost, minus the
    logarithm of the determinant of its triangle, and those of the stated noises. Arguments as of `systematic`.
    """
    nothing = np.zeros((len(path), 3, 0)), np.zeros((len(inputs.observations.frame), 2, 0))
    _, _, triangle, left, _ = _eliminated(inputs, number, path, landmarks, *nothing, None, of_poses)
    noises = [inputs.increments.covariance[1:], inputs.observations.R[number >= 0]]
    if inputs.fixes is not None:
        noises.append(inputs.fixes.covariance[of_poses.fixes])
    if inputs.closures is not None:
        noises.append(inputs.closures.covariance[of_poses.closures])
    eigenvalues = (np.linalg.eigvalsh(each) for each in noises)  # those of zero are left out
    stated = sum(float(np.log(size[size > 0.0]).sum()) for size in eigenvalues)
    return -0.5 * float(left[0, 0]) - float(np.log(np.abs(triangle.diagonal)).sum()) - 0.5 * stated


class Redundancy(NamedTuple):
    """Covariances of the residuals at the optimum, if all is as stated: R - H P H'. Zero where not used.

    Their shares of the stated variances are the redundancy numbers of geodesy (Baarda, "A testing procedure for use in
    geodetic networks", 1968); they add up to the degrees of freedom.
    """

    odometry: Array  # (N, 3, 3) of the increments; zero of the first frame
    observations: Array  # (M, 2, 2)
    successive: Array  # (q, 2, 2) between the observations of pairs
    fixes: Array  # (F,) redundancy numbers of all entries together
    closures: Array  # (K,) the same


def redundancy(
    inputs: Inputs, number: IntArray, path: Array, landmarks: Array, pairs: tuple[IntArray, IntArray],
    of_poses: OfPoses | None,
) -> Redundancy:  # fmt: skip
    """Of a smoothed solution; `pairs`: rows (q,), (q,) of a landmark in successive frames; rest as of `systematic`."""
    n, m, used = len(path), len(number), np.flatnonzero(number >= 0)
    nothing = np.zeros((n, 3, 0)), np.zeros((m, 2, 0))
    rows, s, triangle, _, _ = _eliminated(inputs, number, path, landmarks, *nothing, None, of_poses)
    at = np.full(m, -1)
    at[used] = n + np.arange(len(used))
    first, second = (at[each] for each in pairs)
    column = elimination.columns_of(s, rows.variable[:, :2], rows.dim)
    three = np.concatenate([column[first], column[second][:, :1]], axis=1).reshape(-1, 9)
    P, both = elimination.joint_covariances(s, triangle, [column.reshape(-1, 6), three])
    A = rows.A[:, :, :6]
    C = np.eye(3) - A @ P @ A.transpose(0, 2, 1)
    # (pose, landmark) of the first, and of the second: (next pose, landmark)
    across = -A[first] @ both[:, :6][:, :, np.array([6, 7, 8, 3, 4, 5])] @ A[second].transpose(0, 2, 1)
    odometry, observations = np.zeros((n, 3, 3)), np.zeros((m, 2, 2))
    back = np.linalg.inv(root_information(inputs.increments.covariance[1:])[0])
    odometry[1:] = back @ C[1:n] @ back.transpose(0, 2, 1)
    root = np.zeros((m, 2, 2))
    root[used] = np.linalg.cholesky(inputs.observations.R[used])
    observations[used] = root[used] @ C[n : n + len(used), :2, :2] @ root[used].transpose(0, 2, 1)
    successive = root[pairs[0]] @ across[:, :2, :2] @ root[pairs[1]].transpose(0, 2, 1)
    known = [np.zeros(0 if each is None else len(each)) for each in (inputs.fixes, inputs.closures)]
    if of_poses is not None:
        height = rows.height[n + len(used) :]
        inside = np.where(np.arange(3) < height[:, None], np.einsum("bii->bi", C[n + len(used) :]), 0.0).sum(axis=1)
        counts = int(of_poses.fixes.sum()), int(of_poses.closures.sum())
        inside = inside[len(inside) - sum(counts) :]
        known[0][of_poses.fixes], known[1][of_poses.closures] = inside[: counts[0]], inside[counts[0] :]
    return Redundancy(odometry, observations, successive, *known)


def _eliminated(
    inputs: Inputs, number: IntArray, path: Array, landmarks: Array, motion: Array, observed: Array,
    found: Systematics | None, of_poses: OfPoses | None,
) -> tuple[elimination.Rows, elimination.Structure, elimination.Triangle, Array, Array]:  # fmt: skip
    """Products (1 + p, 1 + p) of residuals and columns left without estimated errors, and squares (1 + p,) before; data
    first, arguments as of `systematic`; blocks: frames, used observations, an uncertain map, fixes and closures.
    """
    n, p, stated = len(path), motion.shape[2], inputs
    inputs = corrected_inputs(inputs, found)
    used = np.flatnonzero(number >= 0)
    frame, row, sensor = inputs.observations.frame[used], number[used], inputs.sensor_of(used)
    seen, slot = np.unique(row, return_inverse=True)
    known, m = inputs.map, len(used)
    free = known is None or known.sigma is not None  # landmarks are variables, in an uncertain map with priors
    z_hat, Hx, Hl = sensor.linearize(path[frame], landmarks[row])
    along = estimated_errors(stated, found, path, frame, z_hat)
    motion = np.concatenate([motion, along.motion], axis=2)
    observed = np.concatenate([observed[used], along.observed], axis=2)
    variable = np.full((n + m, 2), -1)
    variable[:n, 0], variable[1:n, 1] = np.arange(n), np.arange(n - 1)
    variable[n:, 0] = frame
    A, b = np.zeros((n + m, 3, 6)), np.zeros((n + m, 3, 1 + motion.shape[2]))
    F, B, moved = _chain(inputs, path)
    # whitened increments; the first pose is that of the prior plus U z with z ~ N(0, I)
    white = root_information(inputs.increments.covariance[1:])[0] @ B[1:].transpose(0, 2, 1)
    A[1:n, :, :3], A[1:n, :, 3:] = white, -white @ F[1:]
    b[1:n, :, 0] = np.einsum("nij,nj->ni", white, moved[1:])
    b[1:n, :, 1:] = -white @ B[1:] @ motion[1:]
    by_drift = np.einsum("nij,nj->ni", white @ B[1:], along.by_drift[1:])
    white = np.linalg.inv(np.linalg.cholesky(inputs.observations.R[used]))
    A[n:, :2, :3] = white @ Hx
    b[n:, :2, 0] = np.einsum("mij,mj->mi", white, sensor.residual(inputs.observations.z[used], z_hat))
    b[n:, :2, 1:] = -white @ observed
    if free:
        variable[n:, 1] = n + slot
        A[n:, :2, 3:5] = white @ Hl
    blocks: list[Blocks] = [(variable, A, b, np.repeat([3, 2], [n, m]))]
    if known is not None and known.sigma is not None:
        root = 1.0 / np.maximum(known.sigma[seen], EXACT)
        own, right = np.zeros((len(seen), 3, 6)), np.zeros((len(seen), *b.shape[1:]))
        own[:, :2, :2] = root[:, :, None] * np.eye(2)
        right[:, :2, 0] = root * (known.xy[seen] - landmarks[seen])
        places = np.stack([n + np.arange(len(seen)), np.full(len(seen), -1)], 1)
        blocks.append((places, own, right, np.full(len(seen), 2)))
    if of_poses is not None:
        blocks.append(blocks_of_poses(inputs, path, of_poses, b.shape[2]))  # estimated errors do not act on these
    variable, A, b, height = (np.concatenate(each) for each in zip(*blocks, strict=True))
    variance, axes = np.linalg.eigh(inputs.prior.covariance)
    put_prior(variable, A, b, moved[0], np.zeros(3), axes * np.sqrt(np.maximum(variance, 0.0)))
    size = np.einsum("bij,bij->j", b[:, :, : 1 + p], b[:, :, : 1 + p])
    dim, K = np.repeat([3, 2], [n, len(seen) * free]), along.of.knots
    variable, height, dim = with_drift(variable, height, dim, along.of.of, K)
    if K:
        A, b = (np.concatenate([each, np.zeros((K, *each.shape[1:]))]) for each in (A, b))
        A = np.concatenate([A, np.zeros((len(A), 3, 1))], axis=2)
        A[1:n, :, 6] = by_drift
        A[-K:, 0, 0], A[-K:, 0, 3] = along.of.drift_rows
        b[-K:, 0, 0] = -along.steps
    # with closures no variable counts as a pose of a bare chain, whose order would fill in
    chain = 0 if of_poses is not None and of_poses.closures.any() else n
    order = elimination.ordering(variable, chain, len(dim), along.of.first_of if K else elimination.NO_DRIFT)
    rows, s = elimination.Rows(variable, A, b, height, dim), elimination.structure(variable, dim, order)
    triangle = elimination.eliminate(rows, s)
    if triangle.free >= 0:
        free_at = triangle.free
        name = f"pose of frame {free_at}" if free_at < n else f"landmark in row {seen[free_at - n]}"
        raise UnderConstrained(f"{name} is not determined by the observations")
    return rows, s, triangle, without_errors(triangle.left, along.now), size


def _chain(inputs: Inputs, path: Array) -> tuple[Array, Array, Array]:
    """Jacobians F to the pose before, B to the increment (N, 3, 3); deviations (N, 3) from `path`, the prior first."""
    n = len(path)
    F, B, moved = np.tile(np.eye(3), (n, 1, 1)), np.tile(np.eye(3), (n, 1, 1)), np.empty((n, 3))
    F[1:, 0, 2], F[1:, 1, 2] = path[:-1, 1] - path[1:, 1], path[1:, 0] - path[:-1, 0]
    B[1:] = worlds_from_bodies(path[:-1, 2])
    moved[0] = pose_error(inputs.prior.mean, path[0])
    moved[1:] = pose_error(compose(path[:-1], inputs.increments.mean[1:]), path[1:])
    return F, B, moved

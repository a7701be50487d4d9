"""Fixes and closures in a smoother: a linear world solved densely, gtsam's own optimum, and each one's innovation."""

from dataclasses import replace

import numpy as np
import pytest

from data import se2
from data.errors import DataError, UsageError
from data.inputs import Increments, Inputs, Observations, Prior, Systematic
from data.pose_measurements import Closures, Fixes, FixKind, FixSource, expected_closure, expected_fix
from data.se2 import dead_reckoned
from data.sensors import RelativePoint
from graph.batch import smooth
from graph.problem import Start
from tests.graph.poses.worlds import corridors, random_false, structured_false

NOTHING = np.empty(0, np.int64)
SOURCES = (FixSource("centre"), FixSource("antenna", (0.4, -0.3), 0.2))
M = np.array([[0.02, 0.006, 0.001], [0.006, 0.01, -0.002], [0.001, -0.002, 0.004]])
C = np.array([[0.05, 0.01, 0.004], [0.01, 0.03, 0.002], [0.004, 0.002, 0.01]])
TIES = [(0, 9), (14, 3), (5, 19), (2, 19)]
FIXED = [(3, FixKind.POSITION, 1), (7, FixKind.HEADING, 1), (11, FixKind.POSE, 1), (16, FixKind.POSITION, 0)]


def fixes_of(truth, fixed, rng, scale=1.0):
    """Fixes drawn from true poses; `scale` of their noise."""
    z, covariance = np.zeros((len(fixed), 3)), np.zeros((len(fixed), 3, 3))
    for i, (k, kind, source) in enumerate(fixed):
        rows = list({FixKind.POSITION: (0, 1), FixKind.HEADING: (2,), FixKind.POSE: (0, 1, 2)}[kind])
        covariance[i][np.ix_(rows, rows)] = C[np.ix_(rows, rows)]
        z[i, rows] = expected_fix(truth[k], kind, SOURCES[source])[0]
        z[i, rows] += scale * rng.multivariate_normal(np.zeros(len(rows)), C[np.ix_(rows, rows)])
    frame, kind, source = (np.array(each, np.int64) for each in zip(*fixed, strict=True))
    return Fixes(frame, kind, source, z, covariance, SOURCES)


def closures_of(truth, ties, rng, scale=1.0):
    ties = sorted(ties, key=max)
    relative = np.array([se2.between(truth[a], truth[b]) for a, b in ties])
    relative += scale * rng.multivariate_normal(np.zeros(3), C, len(ties))
    first, second = np.array(ties, np.int64).T
    return Closures(first, second, relative, np.tile(C, (len(ties), 1, 1)), np.zeros(len(ties), np.int64), ("loops",))


def drive(frames=20, seed=0, scale=1.0):
    """Inputs without landmarks, and true poses: odometry, fixes of every kind, closures in both directions."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((frames, 3))
    for k in range(1, frames):
        truth[k] = se2.compose(truth[k - 1], np.array([0.5, 0.05, 0.3]))
    steps = np.zeros((frames, 3))
    steps[1:] = se2.between(truth[:-1], truth[1:]) + scale * rng.multivariate_normal(np.zeros(3), M, frames - 1)
    covariance = np.tile(M, (frames, 1, 1))
    covariance[0] = 0.0
    start = truth[0] + scale * rng.multivariate_normal(np.zeros(3), C)
    nothing = Observations(NOTHING, np.empty((0, 2)), np.empty((0, 2, 2)))
    inputs = Inputs(
        Prior(start, C), np.arange(frames, dtype=float), Increments(steps, covariance), nothing, RelativePoint()
    )
    fixes, closures = fixes_of(truth, FIXED, rng, scale), closures_of(truth, TIES, rng, scale)
    return replace(inputs, fixes=fixes, closures=closures), truth


def reckoned(inputs):
    return Start(se2.dead_reckoned(inputs.prior.mean, inputs.increments.mean), np.empty((0, 2)))


def found(inputs, **options):
    return smooth(inputs, NOTHING, NOTHING, reckoned(inputs), **options)


def dense(inputs, path, without=None):
    """One step of dense least squares of additive errors from a path: the path after it, and its whole covariance."""
    n = len(path)
    A, b = [], []

    def add(covariance, error, **blocks):
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        row = np.zeros((len(error), 3 * n))
        for k, J in blocks.items():
            row[:, 3 * int(k[1:]) : 3 * int(k[1:]) + 3] += J
        A.append(W @ row)
        b.append(W @ error)

    add(inputs.prior.covariance, se2.pose_error(inputs.prior.mean, path[0]), x0=np.eye(3))
    for k in range(1, n):
        z, J1, J2 = expected_closure(path[k - 1], path[k])
        error = se2.pose_error(inputs.increments.mean[k], z)
        add(inputs.increments.covariance[k], error, **{f"x{k - 1}": J1, f"x{k}": J2})
    for i, k in enumerate(inputs.fixes.frame.tolist()):
        if ("fix", i) != without:
            error, J, covariance = fix_error(inputs, i, path[k])
            add(covariance, error, **{f"x{k}": J})
    for i, (a, c) in enumerate(zip(inputs.closures.frame1.tolist(), inputs.closures.frame2.tolist(), strict=True)):
        if ("closure", i) != without:
            z, J1, J2 = expected_closure(path[a], path[c])
            error = se2.pose_error(inputs.closures.relative[i], z)
            add(inputs.closures.covariance[i], error, **{f"x{a}": J1, f"x{c}": J2})
    A, b = np.concatenate(A), np.concatenate(b)
    P = np.linalg.inv(A.T @ A)
    return path + (P @ A.T @ b).reshape(n, 3), P


def fix_error(inputs, i, pose):
    f = inputs.fixes
    z, J = expected_fix(pose, f.kind[i], f.sources[f.source[i]])
    rows = np.flatnonzero(np.diag(f.covariance[i]))
    error = f.z[i, rows] - z
    if rows[-1] == 2:
        error[-1] = se2.wrap_angle(error[-1])
    return error, J, f.covariance[i][np.ix_(rows, rows)]


def test_without_noise_the_covariances_are_those_of_dense_least_squares_and_the_path_is_the_true_one():
    inputs, truth = drive(scale=0.0)
    result = found(inputs)
    assert np.abs(se2.pose_error(result.trajectory.pose, truth)).max() < 1e-9
    P = dense(inputs, truth)[1]
    blocks = np.array([P[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(truth))])
    np.testing.assert_allclose(result.trajectory.covariance, blocks, atol=1e-12)
    assert result.dof == 2 + 1 + 3 + 2 + 3 * 4
    assert result.cost < 1e-12


@pytest.mark.parametrize("kind", ["fix", "closure"])
def test_an_innovation_after_all_data_is_that_against_the_estimate_without_the_measurement(kind):
    """For errors so small that everything is linear."""
    inputs, truth = drive(scale=1e-4)
    result = found(inputs)
    for i in range(4):
        path, P = dense(inputs, truth, without=(kind, i))
        if kind == "fix":
            k = inputs.fixes.frame[i]
            error, J, R = fix_error(inputs, i, path[k])
            H = np.zeros((len(error), len(P)))
            H[:, 3 * k : 3 * k + 3] = J
        else:
            a, c = inputs.closures.frame1[i], inputs.closures.frame2[i]
            z, J1, J2 = expected_closure(path[a], path[c])
            error, R, H = (
                se2.pose_error(inputs.closures.relative[i], z), inputs.closures.covariance[i], np.zeros((3, len(P))),
            )  # fmt: skip
            H[:, 3 * a : 3 * a + 3], H[:, 3 * c : 3 * c + 3] = J1, J2
        S = R + H @ P @ H.T
        of = result.fixes if kind == "fix" else result.closures
        assert of.used.all()
        assert of.dof[i] == len(error)
        assert of.nis[i] == pytest.approx(error @ np.linalg.solve(S, error), rel=1e-3)
        white = np.linalg.solve(np.linalg.cholesky(S), error)
        np.testing.assert_allclose(of.white[i][np.isfinite(of.white[i])], white, atol=1e-3 * np.abs(white).max())
        out = np.arange(4) == i  # one that is left out has the same innovation
        left = found(inputs, rejected=np.append(out & (kind == "fix"), out & (kind != "fix")))
        alone = left.fixes if kind == "fix" else left.closures
        assert alone.used.tolist() == (~out).tolist()
        assert alone.nis[i] == pytest.approx(of.nis[i], rel=1e-3)
        assert left.dof == result.dof - len(error)


def small(seed):
    """A tenth of the sigmas everywhere, drawn and stated: nearly linear."""
    inputs, _ = drive(seed=seed, scale=0.1)
    parts = {
        name: replace(getattr(inputs, name), covariance=0.01 * getattr(inputs, name).covariance)
        for name in ("prior", "increments", "fixes", "closures")
    }
    return replace(inputs, **parts)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_a_robust_loss_reaches_fixes_and_closures(loss):
    inputs, truth = drive(seed=1)
    relative, z = inputs.closures.relative.copy(), inputs.fixes.z.copy()
    relative[1, :2] += 4.0
    z[0, :2] -= 5.0
    wrong = replace(inputs, closures=replace(inputs.closures, relative=relative), fixes=replace(inputs.fixes, z=z))
    plain, robust = found(wrong), found(wrong, loss=loss)
    error = [np.abs(se2.pose_error(r.trajectory.pose, truth)[:, :2]).max() for r in (plain, robust)]
    assert error[1] < 0.5 * error[0]
    assert robust.closures.nis.argmax() == 1
    assert robust.fixes.nis.argmax() == 0
    assert robust.closures.nis[1] > 30.0


def test_singular_covariances_and_errors_of_the_sensor_are_refused():
    inputs, _ = drive()
    covariance = inputs.closures.covariance.copy()
    covariance[2] = 0.0
    with pytest.raises(DataError, match=r"closure of loops between frames 5 and 19.*singular"):
        found(replace(inputs, closures=replace(inputs.closures, covariance=covariance)))
    with pytest.raises(UsageError, match="beside fixes or closures"):
        found(replace(inputs, systematic=Systematic(("bearing",), np.array([0.02]))))


def start(world):
    return dead_reckoned(world.truth[0], world.motion)


def test_a_first_pose_that_is_known_exactly_stays_and_has_no_covariance():
    world = corridors(0, 60, loops=20, blocks=1)
    found = world.optimum(start(world)).trajectory
    np.testing.assert_allclose(found.pose[0], world.truth[0], atol=1e-12)
    assert np.abs(found.covariance[0]).max() == 0.0
    assert np.linalg.eigvalsh(found.covariance[1:]).min() > 0.0


@pytest.mark.parametrize("false", [random_false, structured_false])
def test_as_many_false_loop_closures_as_half_the_true_ones_change_the_robust_paths_by_less_than_5_percent(false):
    before = {"gaussian": [], "cauchy": [], "gnc": []}
    after = {"gaussian": [], "cauchy": [], "gnc": []}
    for seed in range(2):
        world = corridors(seed, 110, loops=50, drift=3.0, blocks=2)
        wrong = world.with_loops(*false(world, np.random.default_rng(seed), 25))
        for w, errors in ((world, before), (wrong, after)):
            for loss in ("gaussian", "cauchy"):
                errors[loss].append(world.rmse(w.optimum(start(w), loss=loss).trajectory.pose))
            found, believed = w.graduated(start(w))
            errors["gnc"].append(world.rmse(found.trajectory.pose))
            assert not believed[50:].any()
            assert believed[:50].mean() > 0.9
    for loss in ("cauchy", "gnc"):
        np.testing.assert_allclose(after[loss], before[loss], rtol=0.05)
    assert min(after["gaussian"]) > 5.0 * max(before["gaussian"])

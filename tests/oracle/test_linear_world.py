"""A world in which everything is linear and Gaussian, solved by bare gtsam linear algebra: all estimators must agree.

The heading is known exactly and the sensor is Cartesian, so pose and landmarks are plain points. The oracle shares no
code with the package: points, rotation matrices, a `GaussianFactorGraph`.

Where errors are so small that every model is linear, filters end where the smoothers do; a test per measurement.
"""

import gtsam
import numpy as np
import pytest

from data.inputs import Increments, Prior
from data.pose_measurements import FixKind
from data.result import NEW
from ekf.whole_run import run_filter
from eval.replay.run import compare
from eval.replay.settings import FILTERS, Setup
from graph.batch import smooth
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.builders.estimators import drive
from tests.builders.logs import increments_of, inputs_of as build, observations_of
from tests.ekf.pose_oracle import closures_of, fixes_of, wandering

FRAMES, LANDMARKS = 50, 7
M = np.array([[0.02, 0.006], [0.006, 0.01]])
R = np.array([[0.03, -0.008], [-0.008, 0.012]])
P0 = np.array([[0.2, 0.05], [0.05, 0.1]])


def x(k):
    return gtsam.symbol("x", k)


def l(j):  # noqa: E743
    return gtsam.symbol("l", j)


@pytest.fixture(scope="module")
def world():
    """(motions, headings, observations (frame, landmark, z), prior mean)."""
    rng = np.random.default_rng(4)
    landmarks = rng.uniform(-6.0, 6.0, (LANDMARKS, 2))
    turn = rng.uniform(-0.4, 0.6, FRAMES)
    turn[0] = 0.0
    heading = 0.7 + np.cumsum(turn)
    at, start = np.array([1.0, 2.0]), np.array([1.0, 2.0]) + rng.multivariate_normal(np.zeros(2), P0)
    motions, seen = [np.zeros(2)], []
    for k in range(FRAMES):
        if k:
            d = rng.normal(0.0, 0.6, 2)
            at = at + rotation(heading[k - 1]) @ d
            motions.append(d + rng.multivariate_normal(np.zeros(2), M))
        for j in range(LANDMARKS):
            if rng.random() < 0.4:
                z = rotation(heading[k]).T @ (landmarks[j] - at) + rng.multivariate_normal(np.zeros(2), R)
                seen.append((k, j, z))
    return np.array(motions), turn, heading, seen, start


def rotation(a):
    return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])


@pytest.fixture(scope="module")
def oracle(world):
    """Path (N, 2) with covariances, map in order of first observation with covariances, and twice the minimal error."""
    motions, _, heading, seen, start = world
    graph, one = gtsam.GaussianFactorGraph(), np.eye(2)

    def add(covariance, b, *terms):
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        whitened = [part for key, A in terms for part in (key, W @ A)]
        graph.add(gtsam.JacobianFactor(*whitened, W @ b, gtsam.noiseModel.Unit.Create(2)))

    add(P0, start, (x(0), one))
    for k in range(1, FRAMES):
        C = rotation(heading[k - 1])
        add(C @ M @ C.T, C @ motions[k], (x(k - 1), -one), (x(k), one))
    for k, j, z in seen:
        C = rotation(heading[k]).T
        add(R, z, (x(k), -C), (l(j), C))
    solution = graph.optimize()
    marginals = gtsam.Marginals(graph, solution)
    order = list(dict.fromkeys(j for _, j, _ in seen))

    def read(keys):
        return np.array([solution.at(k) for k in keys]), np.array([marginals.marginalCovariance(k) for k in keys])

    return *read([x(k) for k in range(FRAMES)]), *read([l(j) for j in order]), 2.0 * graph.error(solution)


def inputs_of(world, heading_variance):
    motions, turn, heading, seen, start = world
    motion = np.zeros((3, 3))
    motion[:2, :2], motion[2, 2] = M, heading_variance
    prior = np.zeros((3, 3))
    prior[:2, :2] = P0
    frame = np.array([k for k, _, _ in seen])
    z = np.array([z for _, _, z in seen])
    number, decisions, created = {}, [], []
    for _, j, _ in seen:
        decisions.append(number.get(j, NEW))
        created.append(-1 if j in number else len(number))
        number.setdefault(j, len(number))
    increments = increments_of(np.column_stack([motions, turn]), motion)
    inputs = build(increments, observations_of(frame, z, R), start=[*start, heading[0]], spread=prior)
    return inputs, np.array(decisions), np.array(created)


def test_ekf_slam_ends_where_the_linear_solution_does(world, oracle):
    path, path_covariance, landmarks, landmark_covariance, chi_square = oracle
    inputs, decisions, created = inputs_of(world, 0.0)
    run = run_filter(inputs, decisions)
    np.testing.assert_allclose(run.pose[-1, :2], path[-1], atol=1e-6)
    np.testing.assert_allclose(run.covariance[-1, :2, :2], path_covariance[-1], atol=1e-6)
    np.testing.assert_allclose(run.map.xy, landmarks, atol=1e-6)
    np.testing.assert_allclose(run.map.covariance, landmark_covariance, atol=1e-6)
    # the innovations of a filter carry the same chi-square as the residuals of the smoother
    assert run.nis.sum() == pytest.approx(chi_square, abs=1e-6)
    assert run.dof.sum() == 2 * len(decisions) - 2 * (created >= 0).sum()


def test_batch_and_isam2_find_the_linear_solution(world, oracle):
    """Their increments cannot be exact, so the heading gets 1e-6 rad of freedom in each step."""
    path, path_covariance, landmarks, landmark_covariance, chi_square = oracle
    inputs, decisions, created = inputs_of(world, 1e-12)
    run = run_filter(inputs, decisions)
    batch = smooth(inputs, decisions, created, Start(run.pose, run.map.xy))
    assert batch.cost == pytest.approx(chi_square, abs=1e-4)
    s = Isam2Smoother(inputs.prior, inputs.sensor, threshold=1e-6, skip=1)
    drive(s, inputs, decisions)
    online, finished = s.estimate(), s.finish()
    np.testing.assert_allclose(online.mean[:2], path[-1], atol=1e-6)
    np.testing.assert_allclose(online.covariance[:2, :2], path_covariance[-1], atol=1e-6)
    for trajectory, state in ((batch.trajectory, batch.map), (finished.final, finished.map)):
        np.testing.assert_allclose(trajectory.pose[:, :2], path, atol=1e-6)
        np.testing.assert_allclose(trajectory.covariance[:, :2, :2], path_covariance, atol=1e-6)
        np.testing.assert_allclose(state.xy, landmarks, atol=1e-6)
        np.testing.assert_allclose(state.covariance, landmark_covariance, atol=1e-6)


SCALE, SMALL_FRAMES = 3e-5, 16


def small_inputs(kind):
    rng = np.random.default_rng(4)
    prior = Prior(np.array([1.0, 2.0, 0.4]), SCALE**2 * np.diag([0.09, 0.06, 0.04]))
    motions, fixes, closures, sources = wandering(rng, SMALL_FRAMES, prior, SCALE)
    mean = np.array([np.zeros(3), *(m.mean for m in motions[1:])])
    covariance = np.array([np.zeros((3, 3)), *(m.covariance for m in motions[1:])])
    rows = [row for row in fixes if row[1].name.lower() == kind]
    return build(
        Increments(mean, covariance), observations_of([], [], label=[]), start=prior.mean, spread=prior.covariance,
        fixes=fixes_of(rows, sources) if rows else None, closures=closures_of(closures) if kind == "closure" else None,
    )  # fmt: skip


@pytest.mark.parametrize("kind", [*(kind.name.lower() for kind in FixKind), "closure"])
def test_a_filter_ends_where_the_smoothers_do(kind):
    inputs = small_inputs(kind)
    assert (inputs.fixes is None) == (kind == "closure")
    names = (*FILTERS, "isam2", "batch")
    *filters, isam2, batch = compare(inputs, "slam", names, setup=Setup(gate_poses=None))
    bare = compare(small_inputs("nothing"), "slam", ["ekf"])[0].online.covariance[-1]
    last, P = batch.final.pose[-1], batch.final.covariance[-1]
    assert np.trace(P) < 0.9 * np.trace(bare), "it says something"
    for run in (*filters, isam2):
        assert run.failure is None
        np.testing.assert_allclose(run.online.pose[-1], last, atol=1e-9 * np.sqrt(P.trace()) + 1e-11)
        np.testing.assert_allclose(run.online.covariance[-1], P, atol=1e-5 * P.trace())

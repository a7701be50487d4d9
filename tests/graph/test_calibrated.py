"""Batch smoothing with systematic errors: the optimum and covariances of dense least squares, and what they mean."""

import numpy as np
import pytest
from scipy import stats

from data import se2
from data.inputs import ERRORS
from data.sensors import RangeBearing, RelativePoint
from graph import optimum
from graph.batch import build, smooth
from graph.optimum import NotConvergedError, optimize
from graph.problem import Start
from graph.qr.rows import Linearizer
from tests.graph.calibrating import Dense, erring, errors_of
from tests.graph.worlds import OFF_CENTRE, SENSORS, both_tasks

ODOMETRY = [n for n in ERRORS if n not in ("range", "bearing")]


def sigmas(covariance):
    return np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))


def compare(inputs, decisions, created, start):
    found = smooth(inputs, decisions, created, start)
    oracle = Dense(inputs, decisions, created)
    cost, x, P = oracle.solved(start)
    poses, xy = oracle.state(x)
    assert found.cost == pytest.approx(cost, rel=1e-6)
    s = sigmas(found.trajectory.covariance)
    known = s > 1e-9
    off = np.abs(se2.pose_error(found.trajectory.pose, poses))
    assert (off[known] / s[known]).max() < 1e-3
    assert off[~known].max(initial=0.0) < 1e-9
    q, n = len(oracle.constant), len(inputs)
    at = q + oracle.knots
    for k in range(1, n):
        own = P[at + 3 * k : at + 3 * k + 3, at + 3 * k : at + 3 * k + 3]
        np.testing.assert_allclose(found.trajectory.covariance[k] / np.outer(s[k], s[k]), own / np.outer(s[k], s[k]),
                                   atol=2e-4)  # fmt: skip
    first = oracle.first_pose_covariance(x, P)
    np.testing.assert_allclose(found.trajectory.covariance[0], first, atol=2e-4 * first.max() + 1e-15)
    for j in range(oracle.landmarks):
        i = at + 3 * n + 2 * j
        np.testing.assert_allclose(found.map.covariance[j], P[i : i + 2, i : i + 2], rtol=2e-3, atol=1e-7)
        assert np.abs(found.map.xy[j] - xy[j]).max() < 1e-3 * np.sqrt(P[i, i])
    e = oracle.errors(x)
    for i, name in enumerate(inputs.systematic.names):
        np.testing.assert_allclose(found.systematic.mean[:, i], e[name], atol=1e-3 * inputs.systematic.sigma[i])
        which = q + oracle.of if name == "drift" else np.full(n, oracle.constant.index(name))
        expected = np.sqrt(np.diag(P)[which]) * inputs.systematic.sigma[i]
        np.testing.assert_allclose(found.systematic.sigma[:, i], expected, rtol=1e-3)
    return found


@pytest.mark.parametrize("task", ["slam", pytest.param("localization", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", [RangeBearing, pytest.param(RelativePoint, marks=pytest.mark.slow)])
def test_all_errors_at_once_have_the_optimum_and_the_covariances_of_dense_least_squares(task, kind):
    """A sensor that is mounted off the robot's centre; a drift of several knots."""
    world = erring(kind(max_range=8.0, **OFF_CENTRE), task, errors_of(ERRORS), frames=12, landmarks=3)[:4]
    assert len(np.unique(compare(*world).systematic.mean[:, list(ERRORS).index("drift")])) > 3


@pytest.mark.slow
@both_tasks
@pytest.mark.parametrize("P0", [np.zeros((3, 3)), np.diag([0.01, 0.0, 0.02])], ids=["exact", "y exact"])
def test_a_prior_that_knows_the_first_pose_exactly_is_one_of_the_robot_not_of_its_sensor(task, P0):
    sensor = RelativePoint(max_range=8.0, **OFF_CENTRE)
    world = erring(sensor, task, errors_of(["scale", "range", "bearing"]), frames=10, landmarks=3, P0=P0)
    found = compare(*world[:4])
    if not P0.any():
        np.testing.assert_allclose(found.trajectory.pose[0], world[0].prior.mean, atol=1e-12)
        assert found.trajectory.covariance[0].max() < 1e-20


@both_tasks
@pytest.mark.parametrize("kind", [RangeBearing, RelativePoint])
@pytest.mark.parametrize(
    "names",
    [tuple(ERRORS), ("scale", "bearing"), ("range",), ("curvature",)],
    ids=["all", "bearing", "range", "odometry"],
)
def test_with_the_true_errors_a_log_without_noise_is_met_exactly_by_the_truth(task, kind, names):
    inputs, decisions, created, start, errors = erring(
        kind(max_range=8.0, **OFF_CENTRE), task, errors_of(names), frames=8, landmarks=4, noise=0.0
    )
    problem = build(inputs, decisions, created)
    xy = inputs.map.xy if task == "localization" else start.landmark
    values, n = problem.values(Start(start.pose, xy, errors)), len(inputs)
    assert np.abs(Linearizer(problem)(values).b[: n + len(problem.observations), :, 0]).max() < 1e-6
    back = problem.start_of(values, np.zeros_like(xy))
    for there, here in ((back.pose, start.pose), (back.landmark, xy * (task == "slam")), (back.errors, errors)):
        np.testing.assert_allclose(there, here, atol=1e-9)


@both_tasks
def test_looser_increments_and_a_bad_start_lead_to_the_same_optimum(task, monkeypatch):
    inputs, decisions, created, start, _ = erring(SENSORS["relative point"], task, errors_of(ERRORS), frames=40)
    direct = smooth(inputs, decisions, created, start)
    found = optimize(build(inputs, decisions, created).loosened(0.3),
                     build(inputs, decisions, created).values(start))  # fmt: skip
    assert found.cost < direct.cost
    monkeypatch.setattr(optimum, "SUSPECT", 0.0)  # so that looser increments are tried
    bad = Start(start.pose + [0.3, -0.2, 0.1], start.landmark + 0.3, np.tile(inputs.systematic.sigma, (40, 1)))
    again = smooth(inputs, decisions, created, bad)
    assert np.abs(se2.pose_error(direct.trajectory.pose, again.trajectory.pose)).max() < 1e-5
    np.testing.assert_allclose(again.systematic.mean, direct.systematic.mean, atol=5e-6)
    assert again.iterations > direct.iterations


def test_a_search_that_is_cut_short_counts_the_steps_of_the_errors(monkeypatch):
    inputs, decisions, created, start, _ = erring(SENSORS["relative point"], "slam", errors_of(ERRORS), frames=40)
    monkeypatch.setattr(optimum, "MOST", 1)
    with pytest.raises(NotConvergedError, match="sigma are left"):
        smooth(inputs, decisions, created, start)


def simulated(seeds, task, names, frames=40):
    """(chi-square less dof, squared errors in sigmas of all systematic errors, pose NEES at the end), by seed."""
    chi, squares, nees = [], [], []
    for seed in seeds:
        inputs, decisions, created, start, errors = erring(
            SENSORS["relative point"], task, errors_of(names), seed=seed, frames=frames
        )
        found = smooth(inputs, decisions, created, start)
        chi.append(found.cost - found.dof)
        squares.append((found.systematic.mean[-1] - errors[-1]) ** 2 / found.systematic.sigma[-1] ** 2)
        off = se2.pose_error(found.trajectory.pose[-1], start.pose[-1])
        nees.append(off @ np.linalg.solve(found.trajectory.covariance[-1], off))
    return np.array(chi), np.array(squares), np.array(nees)


def plausible(chi, squares, nees, level):
    """Student's t for the chi-square; chi-square of what is beyond its sigma, by error and for the last pose."""
    half = stats.t.ppf(1 - level / 2, len(chi) - 1) * np.std(chi, ddof=1) / np.sqrt(len(chi))
    assert abs(np.mean(chi)) < half
    for total, dof in [*((column.sum(), len(chi)) for column in squares.T), (nees.sum(), 3 * len(chi))]:
        assert level / 2 < stats.chi2.sf(total, dof) < 1 - level / 2


@pytest.mark.slow
@both_tasks
@pytest.mark.parametrize("names", [ODOMETRY, ERRORS], ids=["odometry", "all"])
def test_so_they_are_over_fifty_seeds(task, names):
    chi, squares, nees = simulated(range(100, 150), task, names, frames=80)
    plausible(chi, squares, nees, level=1e-3)
    assert 0.9 < np.mean(squares < stats.chi2.ppf(0.95, 1)) < 0.99

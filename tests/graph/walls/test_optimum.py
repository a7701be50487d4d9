"""Walls in the graph: the optimum is that of dense least squares, frame by frame as in batch."""

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.errors import DataError, UsageError
from data.inputs import FrameObservations, Prior, Systematic
from data.result import NEW
from data.sensors import Line
from eval.referee.consistency import CONSISTENT, nees, verdict
from graph.bare_loop import bare_isam2
from graph.batch import gnc, smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.builders.logs import increments_of, inputs_of, observations_of
from tests.graph.driving import TIGHT, both_tasks, drive, for_task, lagged, parted
from tests.graph.walls import worlds
from tests.quick import slow

ODOMETRY = Systematic(("scale", "curvature"), np.array([0.05, 0.05]))


@pytest.mark.parametrize("name", worlds.SENSORS)
@both_tasks
def test_the_optimum_and_its_covariance_are_those_of_dense_least_squares(name, task):
    inputs, result, decisions, (pose, lines, C, cost) = worlds.exactly(name, task)
    n = len(inputs)
    assert np.abs(se2.pose_error(result.trajectory.pose, pose)).max() < 1e-6
    assert (
        worlds.differ(result.trajectory.covariance, [C[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)]) < 1e-4
    )
    assert result.cost == pytest.approx(cost, abs=1e-6)
    assert result.dof == 2 * len(decisions) - (0 if task == "localization" else 2 * len(lines))
    if task == "slam":
        np.testing.assert_allclose(result.map.xy, lines, atol=1e-6)
        of_walls = [C[k : k + 2, k : k + 2] for k in range(3 * n, len(C), 2)]
        assert worlds.differ(result.map.covariance, of_walls) < 1e-4


def test_a_run_far_from_the_origin_is_the_same_run():
    """Where rho depends on alpha by kilometres: covariances of the same lines about a distant origin."""
    inputs, truth = worlds.walled(worlds.SENSORS["centred"])
    inputs = inputs.without_map()
    away = np.array([3000.0, -2000.0, 0.0])
    moved = replace(inputs, prior=replace(inputs.prior, mean=inputs.prior.mean + away))
    result, (decisions, created, walls) = worlds.solved(inputs, truth)
    normal = np.stack([np.cos(walls[:, 1]), np.sin(walls[:, 1])], 1)
    there = np.column_stack([walls[:, 0] + normal @ away[:2], walls[:, 1]])
    far = smooth(moved, decisions, created, Start(truth + away, there))
    np.testing.assert_allclose(far.trajectory.pose, result.trajectory.pose + away, atol=1e-6)
    assert worlds.differ(far.trajectory.covariance, result.trajectory.covariance) < 1e-6
    alpha = result.map.xy[:, 1]
    J = np.tile(np.eye(2), (len(walls), 1, 1))
    J[:, 0, 1] = np.cos(alpha) * away[1] - np.sin(alpha) * away[0]
    assert worlds.differ(far.map.covariance, J @ result.map.covariance @ J.transpose(0, 2, 1)) < 1e-6
    np.testing.assert_allclose(far.map.xy[:, 0], result.map.xy[:, 0] + np.cos(alpha) * 3000 - np.sin(alpha) * 2000)


@pytest.mark.parametrize(("task", "systematic"), [
    ("localization", None), slow("slam", None), slow("slam", ODOMETRY),
])  # fmt: skip
def test_wrong_readings_are_told_from_right_ones(task, systematic):
    inputs, truth = worlds.walled(worlds.SENSORS["off centre"], frames=30, seed=3)
    o, rng = inputs.observations, np.random.default_rng(0)
    bad = np.zeros(len(o.z), np.bool_)
    bad[20::12] = True
    z = o.z.copy()
    z[bad] += rng.choice([-1.0, 1.0], (bad.sum(), 2)) * rng.uniform([0.3, 0.2], [1.0, 0.6], (bad.sum(), 2))
    z[:, 0] = np.abs(z[:, 0])
    inputs = for_task(replace(inputs, observations=replace(o, z=z), systematic=systematic), task)
    clean = for_task(replace(inputs, observations=replace(o, z=z, label=np.where(bad, -1, o.label))), task)
    decisions, created = known_decisions(inputs)
    assert (created[bad] < 0).all()
    walls = worlds.in_order(inputs, created) if task == "slam" else np.empty((0, 2))
    result, accepted = gnc(inputs, decisions, created, Start(truth, walls))
    assert not accepted[bad].any()
    assert accepted[~bad].mean() > 0.95
    without, _ = worlds.solved(clean, truth)
    plain = smooth(inputs, decisions, created, Start(truth, walls))
    robust = smooth(inputs, decisions, created, Start(truth, walls), loss="huber")
    assert plain.cost > 10.0 * plain.dof
    gap = [np.abs(r.trajectory.pose - without.trajectory.pose).max() for r in (result, robust, plain)]
    assert gap[0] < 0.05
    assert gap[1] < 0.1 < gap[2]


@pytest.mark.parametrize("names", [("range",), ("scale", "bearing")])
def test_errors_of_the_sensor_are_refused(names):
    inputs, truth = worlds.walled(worlds.SENSORS["centred"])
    systematic = Systematic(names, np.full(len(names), 0.1))
    with pytest.raises(UsageError, match="sensor of points"):
        worlds.solved(replace(inputs, systematic=systematic), truth)
    with pytest.raises(UsageError, match="sensor of points"):
        Isam2Smoother(inputs.prior, inputs.sensor, systematic=systematic)
    with pytest.raises(UsageError, match="sensor of points"):
        FixedLagSmoother(inputs.prior, inputs.sensor, lag=3.0, systematic=systematic)


def test_a_reading_without_information_is_refused():
    inputs, truth = worlds.walled(worlds.SENSORS["centred"], frames=10)
    R = inputs.observations.R.copy()
    R[3] = [[1e-4, 2e-4], [2e-4, 4e-4]]
    bad = replace(inputs, observations=replace(inputs.observations, R=R))
    with pytest.raises(DataError, match="not positive definite"):
        worlds.solved(bad, truth)
    decisions, created = known_decisions(bad.without_map())
    with pytest.raises(ValueError, match="points"):
        bare_isam2(inputs.without_map(), decisions, created)


INDEPENDENT = np.diag([1e-4, 4e-4])


@worlds.every_sensor
@both_tasks
def test_as_it_comes_it_is_near_the_batch_solution_and_ends_with_it(sensor, task):
    inputs, truth = worlds.walled(sensor)
    inputs = for_task(inputs, task)
    result, (decisions, *_) = worlds.solved(inputs, truth)
    s, pose, P, _ = drive(inputs, decisions)
    short, recent, _, _ = drive(inputs, decisions, smoother=lagged(inputs, 10.0))
    assert worlds.sigmas_off(pose[-1], result) < 0.2
    assert worlds.sigmas_off(recent[-1], result) < 0.3
    assert worlds.differ(P[-1], result.trajectory.covariance[-1]) < 0.2
    end = s.finish()
    assert np.abs(se2.pose_error(end.final.pose, result.trajectory.pose)).max() < 1e-5
    assert worlds.differ(end.final.covariance, result.trajectory.covariance) < 1e-4
    assert end.total_nis[0] == pytest.approx(result.cost, abs=1e-6)
    assert end.total_nis[1] == result.dof
    if task == "slam":
        assert worlds.differ(worlds.named_like(end.map, result.map).covariance, result.map.covariance) < 1e-4
    left = len(short._engine.values().keys())  # what left the window took its own variables along
    assert left <= 12 + (0 if task == "localization" else len(worlds.WALLS)) + 12 * len(worlds.WALLS)
    assert left < len(s._engine.values().keys()) / 2


@pytest.mark.parametrize("R", [worlds.R_ROOM, np.diag(np.diag(worlds.R_ROOM))], ids=["correlated", "independent"])
def test_along_a_corridor_only_odometry_says_where_the_robot_is(R):
    """A factor between the poses of robot and wall claims half the sigma: it takes errors of direction for a place."""
    n, rng = 150, np.random.default_rng(0)
    truth = np.column_stack([0.2 * np.arange(n), np.zeros((n, 2))])
    walls, Q = np.array([[1.0, 0.5 * np.pi], [1.2, -0.5 * np.pi]]), np.diag([0.02, 0.005, 0.01]) ** 2
    way = se2.between(truth[:-1], truth[1:]) + rng.multivariate_normal(np.zeros(3), Q, n - 1)
    sensor, frame, label = Line(max_range=8.0), np.repeat(np.arange(n), 2), np.tile([0, 1], n)
    z = sensor.predict(truth[frame], walls[label]) + rng.multivariate_normal(np.zeros(2), R, 2 * n)
    steps = increments_of(np.vstack([np.zeros(3), way]), Q)
    inputs = inputs_of(steps, observations_of(frame, z, R, label), sensor, start=truth[0], spread=1e-4)
    decisions, _ = known_decisions(inputs)
    for smoother in (Isam2Smoother(inputs.prior, sensor), lagged(inputs, 30.0)):
        P = drive(inputs, decisions, smoother=smoother)[2][-1]
        assert np.sqrt(P[0, 0]) == pytest.approx(np.hypot(0.02 * np.sqrt(n - 1), 0.01), rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("name", worlds.SENSORS)
@both_tasks
def test_it_expects_what_dense_least_squares_expects(name, task):
    inputs, _, decisions, (pose, lines, C, _) = worlds.exactly(name, task)
    sensor, last = inputs.sensor, len(inputs) - 1
    s, *_ = drive(inputs, decisions, **TIGHT)
    expected = s.expect(inputs.frame_observations(last))
    lines = inputs.map.xy if task == "localization" else lines
    assert len(expected.number) >= 3
    seen = lines[expected.number]
    z_hat = sensor.predict(pose[-1], seen)
    np.testing.assert_allclose(sensor.residual(expected.z_hat, z_hat), 0.0, atol=1e-5)

    def moved(x):
        at, names = x[:3], x[3:].reshape(-1, 2) if task == "slam" else seen
        return sensor.residual(sensor.predict(at, names), z_hat).ravel()

    x = np.concatenate([pose[-1], seen.ravel() if task == "slam" else []])
    H = np.column_stack([(moved(x + h) - moved(x - h)) / 2e-6 for h in 1e-6 * np.eye(len(x))])
    of = np.arange(3 * last, 3 * last + 3)
    if task == "slam":
        of = np.concatenate([of, (3 * last + 3 + 2 * expected.number[:, None] + np.arange(2)).ravel()])
    S = H @ C[np.ix_(of, of)] @ H.T
    every = np.arange(len(seen))
    assert worlds.differ(expected.joint(every), S) < 1e-3
    assert worlds.differ(expected.HPHt, [S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in every]) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("landmark", [1, 4])
@pytest.mark.parametrize("later", [False, True], ids=["to the first", "to the second"])
def test_walls_that_are_one_are_joined_whatever_their_names(landmark, later):
    """The robot sees both sides of one of them, so that the second may be named the other way round."""
    inputs, _ = worlds.walled(worlds.SENSORS["off centre"], frames=30)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    whole, *_ = drive(inputs, decisions, **TIGHT)
    apart, new = parted(inputs, decisions, created, landmark, 15)
    pair = np.array([landmark]), np.array([new])
    merged, kept = pair if later else pair[::-1]
    s, *_ = drive(inputs, apart, **TIGHT)
    names = dict(zip(s.numbers.tolist(), s.landmarks().xy[:, 1], strict=True))
    assert (np.cos(names[landmark] - names[new]) < 0.0) == (landmark == 4)
    s.merge(merged, kept)
    for a, b in zip(s.estimate(), whole.estimate(), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    lag, *_ = drive(inputs, apart, smoother=lagged(inputs, 1000.0, **TIGHT))
    before = len(lag._engine.values().keys())
    lag.merge(merged, kept)
    for a, b in zip(lag.estimate(), whole.estimate(), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-4)
    assert len(lag._engine.values().keys()) < before - 1  # with the points that it was seen from


def test_a_new_wall_is_where_the_reading_has_it():
    """Before anything else is known, (rho, alpha) and its covariance are those of the inverse measurement."""
    sensor = worlds.SENSORS["off centre"]
    prior = Prior(np.array([3.0, -2.0, 2.5]), np.diag([0.02, 0.03, 0.01]))
    for R in (INDEPENDENT, np.array([[1e-4, -1.2e-4], [-1.2e-4, 4e-4]])):
        s = Isam2Smoother(prior, sensor)
        z = np.array([[2.0, -2.8], [4.0, 0.3]])
        s.update(FrameObservations(z, np.tile(R, (2, 1, 1))), np.array([NEW, NEW]))
        found, (line, Gx, Gz) = s.landmarks(), sensor.inverse(prior.mean, z)
        np.testing.assert_allclose(found.xy, line, atol=1e-6)
        C = Gx @ prior.covariance @ Gx.transpose(0, 2, 1) + Gz @ R @ Gz.transpose(0, 2, 1)
        assert worlds.differ(found.covariance, C) < 1e-4


@pytest.mark.slow
def test_claimed_covariances_are_those_of_the_errors():
    means = {"isam2": [], "batch": [], "fixed lag": []}
    for seed in range(50):
        inputs, truth = worlds.drive_in_a_room(seed)
        inputs = inputs.without_map()
        decisions, created = known_decisions(inputs)
        s, pose, P, _ = drive(inputs, decisions)
        means["isam2"].append(nees(pose, P, truth, "pose").mean())
        path = smooth(inputs, decisions, created, Start(pose, s.landmarks().xy)).trajectory
        means["batch"].append(nees(path.pose, path.covariance, truth, "pose").mean())
        _, pose, P, _ = drive(inputs, decisions, smoother=lagged(inputs, 20.0))
        means["fixed lag"].append(nees(pose, P, truth, "pose").mean())
    found = {name: verdict(np.array(values), 3) for name, values in means.items()}
    assert {name: v.word for name, v in found.items()} == dict.fromkeys(means, CONSISTENT), found
    assert all(v.power > 0.5 for v in found.values()), found

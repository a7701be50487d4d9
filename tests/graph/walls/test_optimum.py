"""Walls in the graph: the optimum is that of dense least squares, frame by frame as in batch."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from association.decide import known_decisions
from data import se2
from data.errors import DataError, UsageError
from data.inputs import FrameObservations, Increments, Prior, Systematic
from data.result import NEW, MapState
from data.sensors import Line
from eval.referee.consistency import CONSISTENT, nees, verdict
from graph.bare_loop import bare_isam2
from graph.batch import gnc, smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.builders.logs import increments_of, inputs_of, map_of, observations_of
from tests.graph.calibrating import logarithm
from tests.graph.worlds import OFF_CENTRE, TIGHT, both_tasks, circle, drive, for_task, lagged, order_of_creation, parted
from tests.quick import slow
from wings.robot.simulated import room

SENSORS = {"centred": Line(max_range=8.0), "off centre": Line(max_range=8.0, **OFF_CENTRE)}
WALLS = np.array([[6.0, 0.2], [5.0, 1.7], [7.0, 3.0], [4.0, -2.0], [1.5, -0.9]])
"""The robot drives through the last one, and sees it from both sides."""
every_sensor = pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
R = np.array([[1e-4, 8e-5], [8e-5, 4e-4]])
R_ROOM = np.array([[0.007**2, 0.4 * 0.007 * 0.02], [0.4 * 0.007 * 0.02, 0.02**2]])


def walled(sensor, *, frames=50, see=0.5, R=R, walls=WALLS, **more):
    """(Inputs with a map of walls and labels, true poses): see `circle`."""
    return circle(sensor, frames=frames, see=see, R=R, landmarks=walls, **more)[:2]


def least_squares_solution(inputs, decisions, created, start, walls):
    """Poses (N, 3), walls (L, 2), their joint covariance, and the cost: scipy's, with numeric derivatives only."""
    n, slam = len(inputs), inputs.map is None
    o, number = inputs.observations, np.where(created >= 0, created, decisions)
    used = np.flatnonzero(number >= 0)
    measured = inputs.increments.mean[1:]
    turned = np.array([se2.world_from_body(turn) for turn in measured[:, 2]])
    white = np.linalg.cholesky(np.linalg.inv(inputs.increments.covariance[1:])).transpose(0, 2, 1) @ turned
    turned_0 = se2.world_from_body(inputs.prior.mean[2])
    white_z = np.linalg.cholesky(np.linalg.inv(o.R[used])).transpose(0, 2, 1)
    white_0 = np.linalg.cholesky(np.linalg.inv(inputs.prior.covariance)).T

    def residuals(x):
        pose = x[: 3 * n].reshape(n, 3)
        lines = x[3 * n :].reshape(-1, 2)[number[used]] if slam else inputs.map.positions(number[used])
        # gtsam's residual: the logarithm of what was measured and what is
        gone = logarithm(se2.between(measured, se2.between(pose[:-1], pose[1:])))
        first = white_0 @ turned_0 @ logarithm(se2.between(inputs.prior.mean[None], pose[:1]))[0]
        z_hat = inputs.sensor.predict(pose[o.frame[used]], lines)
        nu = inputs.sensor.residual(o.z[used], z_hat)
        # of the other name the distance counts the other way, and so does its error
        renamed = np.abs(se2.wrap_angle(o.z[used, 1] - z_hat[:, 1])) > 0.5 * np.pi
        nu[renamed, 0] *= -1.0
        return np.concatenate(
            [first, np.einsum("kij,kj->ki", white, gone).ravel(), np.einsum("mij,mj->mi", white_z, nu).ravel()]
        )

    x0 = np.concatenate([start.ravel(), walls.ravel() if slam else []])
    found = least_squares(residuals, x0, jac="3-point", method="trf", xtol=1e-15, ftol=1e-15, gtol=1e-12, x_scale="jac")
    C = np.linalg.inv(found.jac.T @ found.jac)
    return found.x[: 3 * n].reshape(n, 3), found.x[3 * n :].reshape(-1, 2), C, 2.0 * found.cost


@cache
def exactly(name, task):
    """Inputs of a short run with a sensor, the batch solution, decisions, and what `least_squares_solution` finds."""
    inputs, truth = walled(SENSORS[name], frames=20)
    inputs = for_task(inputs, task)
    result, (decisions, created, walls) = solved(inputs, truth)
    return inputs, result, decisions, least_squares_solution(inputs, decisions, created, truth, walls)


def in_order(inputs, created):
    return WALLS[order_of_creation(inputs, None, created)]


def solved(inputs, truth, loss="gaussian"):
    decisions, created = known_decisions(inputs)
    walls = in_order(inputs, created) if inputs.map is None else np.empty((0, 2))
    return smooth(inputs, decisions, created, Start(truth, walls), loss=loss), (decisions, created, walls)


def sigmas_off(pose, result, frame=-1):
    """Distance of a pose (3,) from that of a solution, in its sigmas."""
    e = se2.pose_error(pose, result.trajectory.pose[frame])
    return float(np.sqrt(e @ np.linalg.solve(result.trajectory.covariance[frame], e)))


def named_like(walls, others):
    """A map of walls, each by that of its two names which a map of the same walls has."""
    opposite = np.cos(walls.xy[:, 1] - others.xy[:, 1]) < 0.0
    sign = np.where(opposite, -1.0, 1.0)
    lines = np.column_stack([sign * walls.xy[:, 0], se2.wrap_angle(walls.xy[:, 1] + np.pi * opposite)])
    C = walls.covariance.copy()
    C[:, 0, 1], C[:, 1, 0] = sign * C[:, 0, 1], sign * C[:, 1, 0]
    return MapState(walls.number, lines, C)


def differ(a, b):
    """Largest difference of covariances (n, k, k), in units of the sigmas of `b`."""
    a, b = (np.asarray(each).reshape(-1, *np.shape(each)[-2:]) for each in (a, b))
    sigma = np.sqrt(np.diagonal(b, axis1=1, axis2=2))
    return float(np.abs((a - b) / (sigma[:, :, None] * sigma[:, None, :])).max(initial=0.0))


SLIP, BASE, RATE = 0.005, 0.235, 4
"""Of the simulated robot: m of wheel slip after a metre; m between the wheels; frames a second."""


def drive_in_a_room(seed, *, seconds=300, sensor=None, R=R_ROOM, every=4, reach=4.0):
    """(Inputs with a map and labels, true poses): laps of room 0, walls seen every so many frames up to `reach` m, from
    their front where the foot of the perpendicular is on them.
    """
    rng = np.random.default_rng(seed)
    segments = room(0).segments
    a, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.hypot(*along.T)
    front = np.stack([along[:, 1], -along[:, 0]], 1) / length[:, None]  # away from the robot's side of the outer walls
    front[4:] *= -1.0  # of the boxes' sides, which it sees from outside: towards their inside
    walls = np.stack([np.sum(front * a, 1), np.arctan2(front[:, 1], front[:, 0])], 1)
    n = seconds * RATE
    at = np.linspace(0.0, 0.0095 * n / RATE * 2 * np.pi, n) + 0.3
    xy = np.stack([5.0 + 4.2 * np.cos(at), 3.0 + 2.3 * np.sin(at)], 1)
    truth = np.column_stack([xy, np.arctan2(2.3 * np.cos(at), -4.2 * np.sin(at))])
    way = se2.between(truth[:-1], truth[1:])
    covariance = np.zeros((n, 3, 3))
    mean = np.zeros((n, 3))
    for k, step in enumerate(way, 1):
        wheel = SLIP**2 * np.hypot(step[0], step[1])
        turned, half = step[2] / 2.0, 0.5 * np.hypot(step[0], step[1])
        J = np.array([[0.5, 0.5], [0.5 * turned, 0.5 * turned], [-1.0 / BASE, 1.0 / BASE]])
        J[1] += half * J[2] * np.cos(turned)
        J[0] -= half * J[2] * np.sin(turned)
        covariance[k] = wheel * J @ J.T + 1e-10 * np.eye(3)
        mean[k] = step + rng.multivariate_normal(np.zeros(3), covariance[k])
    frame, label = np.meshgrid(np.arange(0, n, every), np.arange(len(walls)), indexing="ij")
    frame, label = frame.ravel(), label.ravel()
    p = truth[frame, :2]
    foot = np.sum((p - a[label]) * along[label], 1) / length[label]
    distance = walls[label, 0] - np.sum(front[label] * p, 1)
    seen = (foot > 0.0) & (foot < length[label]) & (distance > 0.05) & (distance < reach)
    frame, label = frame[seen], label[seen]
    sensor = Line(max_range=reach) if sensor is None else sensor
    z = sensor.predict(truth[frame], walls[label]) + rng.multivariate_normal(np.zeros(2), R, len(frame))
    z[:, 1] = se2.wrap_angle(z[:, 1])
    P0 = np.diag([1e-4, 1e-4, 1e-4])
    start = truth[0] + rng.multivariate_normal(np.zeros(3), P0)
    steps, seen = Increments(mean, covariance), observations_of(frame, z, R, label)
    return inputs_of(steps, seen, sensor, map_of(walls), start=start, spread=P0, time=np.arange(n) / RATE), truth


ODOMETRY = Systematic(("scale", "curvature"), np.array([0.05, 0.05]))


@pytest.mark.parametrize("name", SENSORS)
@both_tasks
def test_the_optimum_and_its_covariance_are_those_of_dense_least_squares(name, task):
    inputs, result, decisions, (pose, lines, C, cost) = exactly(name, task)
    n = len(inputs)
    assert np.abs(se2.pose_error(result.trajectory.pose, pose)).max() < 1e-6
    assert differ(result.trajectory.covariance, [C[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)]) < 1e-4
    assert result.cost == pytest.approx(cost, abs=1e-6)
    assert result.dof == 2 * len(decisions) - (0 if task == "localization" else 2 * len(lines))
    if task == "slam":
        np.testing.assert_allclose(result.map.xy, lines, atol=1e-6)
        of_walls = [C[k : k + 2, k : k + 2] for k in range(3 * n, len(C), 2)]
        assert differ(result.map.covariance, of_walls) < 1e-4


def test_a_run_far_from_the_origin_is_the_same_run():
    """Where rho depends on alpha by kilometres: covariances of the same lines about a distant origin."""
    inputs, truth = walled(SENSORS["centred"])
    inputs = inputs.without_map()
    away = np.array([3000.0, -2000.0, 0.0])
    moved = replace(inputs, prior=replace(inputs.prior, mean=inputs.prior.mean + away))
    result, (decisions, created, walls) = solved(inputs, truth)
    normal = np.stack([np.cos(walls[:, 1]), np.sin(walls[:, 1])], 1)
    there = np.column_stack([walls[:, 0] + normal @ away[:2], walls[:, 1]])
    far = smooth(moved, decisions, created, Start(truth + away, there))
    np.testing.assert_allclose(far.trajectory.pose, result.trajectory.pose + away, atol=1e-6)
    assert differ(far.trajectory.covariance, result.trajectory.covariance) < 1e-6
    alpha = result.map.xy[:, 1]
    J = np.tile(np.eye(2), (len(walls), 1, 1))
    J[:, 0, 1] = np.cos(alpha) * away[1] - np.sin(alpha) * away[0]
    assert differ(far.map.covariance, J @ result.map.covariance @ J.transpose(0, 2, 1)) < 1e-6
    np.testing.assert_allclose(far.map.xy[:, 0], result.map.xy[:, 0] + np.cos(alpha) * 3000 - np.sin(alpha) * 2000)


@pytest.mark.parametrize(("task", "systematic"), [
    ("localization", None), slow("slam", None), slow("slam", ODOMETRY),
])  # fmt: skip
def test_wrong_readings_are_told_from_right_ones(task, systematic):
    inputs, truth = walled(SENSORS["off centre"], frames=30, seed=3)
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
    walls = in_order(inputs, created) if task == "slam" else np.empty((0, 2))
    result, accepted = gnc(inputs, decisions, created, Start(truth, walls))
    assert not accepted[bad].any()
    assert accepted[~bad].mean() > 0.95
    without, _ = solved(clean, truth)
    plain = smooth(inputs, decisions, created, Start(truth, walls))
    robust = smooth(inputs, decisions, created, Start(truth, walls), loss="huber")
    assert plain.cost > 10.0 * plain.dof
    gap = [np.abs(r.trajectory.pose - without.trajectory.pose).max() for r in (result, robust, plain)]
    assert gap[0] < 0.05
    assert gap[1] < 0.1 < gap[2]


@pytest.mark.parametrize("names", [("range",), ("scale", "bearing")])
def test_errors_of_the_sensor_are_refused(names):
    inputs, truth = walled(SENSORS["centred"])
    systematic = Systematic(names, np.full(len(names), 0.1))
    with pytest.raises(UsageError, match="sensor of points"):
        solved(replace(inputs, systematic=systematic), truth)
    with pytest.raises(UsageError, match="sensor of points"):
        Isam2Smoother(inputs.prior, inputs.sensor, systematic=systematic)
    with pytest.raises(UsageError, match="sensor of points"):
        FixedLagSmoother(inputs.prior, inputs.sensor, lag=3.0, systematic=systematic)


def test_a_reading_without_information_is_refused():
    inputs, truth = walled(SENSORS["centred"], frames=10)
    R = inputs.observations.R.copy()
    R[3] = [[1e-4, 2e-4], [2e-4, 4e-4]]
    bad = replace(inputs, observations=replace(inputs.observations, R=R))
    with pytest.raises(DataError, match="not positive definite"):
        solved(bad, truth)
    decisions, created = known_decisions(bad.without_map())
    with pytest.raises(ValueError, match="points"):
        bare_isam2(inputs.without_map(), decisions, created)


INDEPENDENT = np.diag([1e-4, 4e-4])


@every_sensor
@both_tasks
def test_as_it_comes_it_is_near_the_batch_solution_and_ends_with_it(sensor, task):
    inputs, truth = walled(sensor)
    inputs = for_task(inputs, task)
    result, (decisions, *_) = solved(inputs, truth)
    s, pose, P, _ = drive(inputs, decisions)
    short, recent, _, _ = drive(inputs, decisions, smoother=lagged(inputs, 10.0))
    assert sigmas_off(pose[-1], result) < 0.2
    assert sigmas_off(recent[-1], result) < 0.3
    assert differ(P[-1], result.trajectory.covariance[-1]) < 0.2
    end = s.finish()
    assert np.abs(se2.pose_error(end.final.pose, result.trajectory.pose)).max() < 1e-5
    assert differ(end.final.covariance, result.trajectory.covariance) < 1e-4
    assert end.total_nis[0] == pytest.approx(result.cost, abs=1e-6)
    assert end.total_nis[1] == result.dof
    if task == "slam":
        assert differ(named_like(end.map, result.map).covariance, result.map.covariance) < 1e-4
    left = len(short._engine.values().keys())  # what left the window took its own variables along
    assert left <= 12 + (0 if task == "localization" else len(WALLS)) + 12 * len(WALLS)
    assert left < len(s._engine.values().keys()) / 2


@pytest.mark.parametrize("R", [R_ROOM, np.diag(np.diag(R_ROOM))], ids=["correlated", "independent"])
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
@pytest.mark.parametrize("name", SENSORS)
@both_tasks
def test_it_expects_what_dense_least_squares_expects(name, task):
    inputs, _, decisions, (pose, lines, C, _) = exactly(name, task)
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
    assert differ(expected.joint(every), S) < 1e-3
    assert differ(expected.HPHt, [S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in every]) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("landmark", [1, 4])
@pytest.mark.parametrize("later", [False, True], ids=["to the first", "to the second"])
def test_walls_that_are_one_are_joined_whatever_their_names(landmark, later):
    """The robot sees both sides of one of them, so that the second may be named the other way round."""
    inputs, _ = walled(SENSORS["off centre"], frames=30)
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
    sensor = SENSORS["off centre"]
    prior = Prior(np.array([3.0, -2.0, 2.5]), np.diag([0.02, 0.03, 0.01]))
    for R in (INDEPENDENT, np.array([[1e-4, -1.2e-4], [-1.2e-4, 4e-4]])):
        s = Isam2Smoother(prior, sensor)
        z = np.array([[2.0, -2.8], [4.0, 0.3]])
        s.update(FrameObservations(z, np.tile(R, (2, 1, 1))), np.array([NEW, NEW]))
        found, (line, Gx, Gz) = s.landmarks(), sensor.inverse(prior.mean, z)
        np.testing.assert_allclose(found.xy, line, atol=1e-6)
        C = Gx @ prior.covariance @ Gx.transpose(0, 2, 1) + Gz @ R @ Gz.transpose(0, 2, 1)
        assert differ(found.covariance, C) < 1e-4


@pytest.mark.slow
def test_claimed_covariances_are_those_of_the_errors():
    means = {"isam2": [], "batch": [], "fixed lag": []}
    for seed in range(50):
        inputs, truth = drive_in_a_room(seed)
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

"""Worlds of walls for the smoothers' tests, and their exact solution by other means."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from association.decide import known_decisions
from data import se2
from data.inputs import Increments
from data.result import MapState
from data.sensors import Line
from graph.batch import smooth
from graph.problem import Start
from tests.builders.logs import inputs_of, map_of, observations_of
from tests.graph.calibrating import logarithm
from tests.graph.driving import for_task
from tests.graph.worlds import OFF_CENTRE, circle, order_of_creation
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

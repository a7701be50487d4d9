"""An ideal world of walls: the robot's 10 x 6 m room, a smooth path, slipping wheels, walls read with stated noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior, floor_covariances
from data.log import Log
from data.robot.body import WHEEL_BASE
from data.robot.simulated.physics import Physics
from data.robot.simulated.room import room
from data.se2 import compose, wrap_angle
from data.sensors import Line
from data.truth import Truth

PERIOD = 0.25
SPEED = 0.25
REACH = 4.0
SHARE = 0.17
"""Of the frames in which a wall is in view, those that read it: once in 1.5 s."""
R = np.array([[0.007**2, 0.5 * 0.007 * 0.02], [0.5 * 0.007 * 0.02, 0.02**2]])


@dataclass(frozen=True)
class World:
    """Origin (x, y) m of the world's frame in the room, seconds it lasts, sigmas of the prior, how fast wheels slip."""

    origin: tuple[float, float] = (0.0, 0.0)
    turned: float = 0.0
    seconds: float = 300.0
    prior: tuple[float, float] = (0.01, 0.01)
    slip: float = Physics().slip


def walls(world: World = World()):
    """Segments (W, 2, 2) and lines (W, 2) of rho, alpha, all about the world's origin."""
    c, s = math.cos(world.turned), math.sin(world.turned)
    segments = (room(0).segments - np.array(world.origin)) @ np.array([[c, s], [-s, c]])
    way = segments[:, 1] - segments[:, 0]
    alpha = np.arctan2(-way[:, 0], way[:, 1])
    rho = np.cos(alpha) * segments[:, 0, 0] + np.sin(alpha) * segments[:, 0, 1]
    return segments, np.stack([rho, alpha], 1)


def path(world: World, rng):
    """True poses (N, 3): round the room a metre from its walls, round the corners on an arc, either way round."""
    r, x0, x1, y0, y1 = 0.8, 1.0, 9.0, 0.9, 5.1
    sides = [x1 - x0 - 2 * r, y1 - y0 - 2 * r] * 2
    pose, poses, left, corner = np.array([x0 + r, y0, 0.0]), [], sides[0], False
    k = 0
    for _ in range(int(world.seconds / PERIOD)):
        poses.append(pose)
        way = SPEED * PERIOD
        while way > 0.0:
            step = min(way, left)
            turn = step / r if corner else 0.0
            s = step * np.sinc(turn / 2.0 / np.pi)
            pose = compose(pose, np.array([s * math.cos(turn / 2), s * math.sin(turn / 2), turn]))
            way, left = way - step, left - step
            if left <= 1e-12:
                corner = not corner
                k += not corner
                left = 0.5 * math.pi * r if corner else sides[k % 4]
    poses = np.array(poses)
    if rng.random() < 0.5:  # mirrored: the other way round
        poses = poses * [1.0, -1.0, -1.0] + [0.0, 6.0, 0.0]
        if False:
            pass
    c, s = math.cos(world.turned), math.sin(world.turned)
    xy = (poses[:, :2] - np.array(world.origin)) @ np.array([[c, s], [-s, c]]).T.T
    return np.column_stack([xy, wrap_angle(poses[:, 2] - world.turned)])


def odometry(truth, slip, rng):
    """Increments by wheels each of which slips by `slip` sqrt(way), with the covariance of that."""
    mean, covariance = np.zeros_like(truth), np.zeros((len(truth), 3, 3))
    for k in range(1, len(truth)):
        turn = float(wrap_angle(truth[k, 2] - truth[k - 1, 2]))
        way = float(np.hypot(*(truth[k, :2] - truth[k - 1, :2]))) / np.sinc(turn / 2.0 / np.pi)
        wheels = np.array([way - 0.5 * WHEEL_BASE * turn, way + 0.5 * WHEEL_BASE * turn])
        wheels = wheels + slip * np.sqrt(np.abs(wheels)) * rng.standard_normal(2)
        way, turn = 0.5 * wheels.sum(), (wheels[1] - wheels[0]) / WHEEL_BASE
        c, s, a = math.cos(turn / 2), math.sin(turn / 2), np.sinc(turn / 2.0 / np.pi)
        da = 0.0 if abs(turn) < 1e-6 else (math.cos(turn / 2) - a) / turn
        mean[k] = way * a * c, way * a * s, turn
        J = np.array([[a * c, way * (da * c - 0.5 * a * s)], [a * s, way * (da * s + 0.5 * a * c)], [0.0, 1.0]])
        J = J @ np.array([[0.5, 0.5], [-1.0 / WHEEL_BASE, 1.0 / WHEEL_BASE]])
        covariance[k] = J @ np.diag(slip**2 * np.abs(wheels)) @ J.T
    covariance, floored = floor_covariances(covariance, 1e-10)
    return Increments(mean, covariance), floored


def in_view(pose, segments, lines):
    """Walls (W,) whose foot is on the segment, within reach, and not behind another wall."""
    n = np.stack([np.cos(lines[:, 1]), np.sin(lines[:, 1])], 1)
    d = lines[:, 0] - n @ pose[:2]
    foot = pose[:2] + d[:, None] * n
    a, b = segments[:, 0], segments[:, 1]
    along = ((foot - a) * (b - a)).sum(1) / ((b - a) ** 2).sum(1)
    seen = (along > 0.0) & (along < 1.0) & (np.abs(d) < REACH)
    for w in np.flatnonzero(seen):
        side = (pose[:2] - a) @ n[w] - 0.0
        other = (n @ (foot[w] - pose[:2])) / np.where(np.abs(d) < 1e-12, 1e-12, d)  # > 1: beyond the other line
        t = 1.0 / np.where(np.abs(other) < 1e-12, 1e-12, other)
        hit = pose[:2] + t[:, None] * (foot[w] - pose[:2])
        at = ((hit - a) * (b - a)).sum(1) / ((b - a) ** 2).sum(1)
        blocked = (t > 0.0) & (t < 1.0 - 1e-9) & (at >= 0.0) & (at <= 1.0)
        seen[w] = not blocked.any()
        del side
    return seen


def line_log(seed, world: World = World()):
    """A log of the world, with the map and the true wall of every reading."""
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    segments, lines = walls(world)
    truth = path(world, rngs[0])
    increments, floored = odometry(truth, world.slip, rngs[1])
    L, sensor = np.linalg.cholesky(R), Line(max_range=REACH)
    frame, z, which = [], [], []
    for k, pose in enumerate(truth):
        for w in np.flatnonzero(in_view(pose, segments, lines)):
            if rngs[2].random() < SHARE:
                frame.append(k)
                which.append(w)
                z.append(sensor.predict(pose, lines[w : w + 1])[0] + L @ rngs[2].standard_normal(2))
    z = np.array(z)
    z[:, 1] = wrap_angle(z[:, 1])
    sigma = np.array([world.prior[0], world.prior[0], world.prior[1]])
    mean = truth[0] + sigma * rngs[3].standard_normal(3)
    known = LandmarkMap(np.arange(len(lines)), lines)
    inputs = Inputs(
        Prior(mean, np.diag(sigma**2)), PERIOD * np.arange(len(truth)), increments,
        Observations(np.array(frame), z, np.tile(R, (len(z), 1, 1))), sensor, known, floored=floored,
    )  # fmt: skip
    return Log(f"walls:{seed}", inputs, Truth(truth, known, np.array(which)))

"""An ideal world of walls: the robot's 10 x 6 m room, a smooth path, slipping wheels, walls read with stated noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.se2 import compose, wrap_angle
from data.sensors import Line
from data.truth import Truth
from wings.robot.packets import WHEEL_BASE
from wings.robot.simulated.physics import Physics
from wings.robot.simulated.room import room

PERIOD = 0.25
SPEED = 0.25
REACH = 4.0
SHARE = 0.17
"""Of the frames in which a wall is in view, those that read it: once in 1.5 s."""
R = np.array([[0.007**2, 0.5 * 0.007 * 0.02], [0.5 * 0.007 * 0.02, 0.02**2]])
CORNER = 0.8


@dataclass(frozen=True)
class World:
    """Where its origin is in the room [m], s that it lasts, sigmas of the first pose [m, rad], how wheels slip, and how
    many times as large as the room it is.
    """

    origin: tuple[float, float] = (0.0, 0.0)
    seconds: float = 300.0
    prior: tuple[float, float] = (0.01, 0.01)
    slip: float = Physics().slip
    size: float = 1.0


ROOM = World()


def walls(world=ROOM):
    """Segments (W, 2, 2) and lines (W, 2) of rho, alpha, about the world's origin."""
    segments = world.size * room(0).segments - np.array(world.origin)
    way = segments[:, 1] - segments[:, 0]
    alpha = np.arctan2(-way[:, 0], way[:, 1])
    rho = np.cos(alpha) * segments[:, 0, 0] + np.sin(alpha) * segments[:, 0, 1]
    return segments, np.stack([rho, alpha], 1)


def path(world, clockwise):
    """True poses (N, 3): round the room a metre from its walls, round the corners on an arc."""
    sides = [8.0 - 2.0 * CORNER, 4.2 - 2.0 * CORNER] * 2
    pose, poses, side, left, corner = np.array([1.0 + CORNER, 0.9, 0.0]), [], 0, sides[0], False
    for _ in range(int(world.seconds / PERIOD)):
        poses.append(pose)
        way = SPEED * PERIOD / world.size
        while way > 0.0:
            step = min(way, left)
            turn = step / CORNER if corner else 0.0
            chord = step * np.sinc(0.5 * turn / math.pi)
            pose = compose(pose, np.array([chord * math.cos(0.5 * turn), chord * math.sin(0.5 * turn), turn]))
            way, left = way - step, left - step
            if left <= 1e-12:
                side, corner = side + corner, not corner
                left = 0.5 * math.pi * CORNER if corner else sides[side % 4]
    poses = np.array(poses)
    if clockwise:
        poses = poses * [1.0, -1.0, -1.0] + [0.0, 6.0, 0.0]
    poses = poses * [world.size, world.size, 1.0] - [*world.origin, 0.0]
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def odometry(truth, slip, rng):
    """Increments by wheels each of which slips by `slip` sqrt(way), with the covariance of that."""
    mean, covariance = np.zeros_like(truth), np.zeros((len(truth), 3, 3))
    for k in range(1, len(truth)):
        turn = float(wrap_angle(truth[k, 2] - truth[k - 1, 2]))
        way = float(np.hypot(*(truth[k, :2] - truth[k - 1, :2]))) / np.sinc(0.5 * turn / math.pi)
        wheels = np.array([way - 0.5 * WHEEL_BASE * turn, way + 0.5 * WHEEL_BASE * turn])
        wheels = wheels + slip * np.sqrt(np.abs(wheels)) * rng.standard_normal(2)
        way, turn = 0.5 * wheels.sum(), (wheels[1] - wheels[0]) / WHEEL_BASE
        c, s, a = math.cos(0.5 * turn), math.sin(0.5 * turn), np.sinc(0.5 * turn / math.pi)
        da = (c - a) / turn if abs(turn) > 1e-6 else 0.0
        mean[k] = way * a * c, way * a * s, turn
        J = np.array([[a * c, way * (da * c - 0.5 * a * s)], [a * s, way * (da * s + 0.5 * a * c)], [0.0, 1.0]])
        J = J @ np.array([[0.5, 0.5], [-1.0 / WHEEL_BASE, 1.0 / WHEEL_BASE]])
        covariance[k] = J @ np.diag(slip**2 * np.abs(wheels)) @ J.T
    covariance, floored = floor_covariances(covariance, 1e-10)
    return Increments(mean, covariance), floored


def in_view(pose, segments, lines, reach=REACH):
    """Walls (W,) whose foot is on the segment, within reach, with no other wall in between."""
    normal = np.stack([np.cos(lines[:, 1]), np.sin(lines[:, 1])], 1)
    d = lines[:, 0] - normal @ pose[:2]
    foot = pose[:2] + d[:, None] * normal
    a, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = (way**2).sum(1)
    along = ((foot - a) * way).sum(1) / length
    seen = (along > 0.0) & (along < 1.0) & (np.abs(d) < reach)
    for w in np.flatnonzero(seen):
        towards = normal @ (foot[w] - pose[:2])
        t = d / np.where(np.abs(towards) < 1e-9, 1e-12, towards)  # where on the way there the other lines are met
        at = ((pose[:2] + t[:, None] * (foot[w] - pose[:2]) - a) * way).sum(1) / length
        seen[w] = not ((t > 0.0) & (t < 1.0 - 1e-9) & (at >= 0.0) & (at <= 1.0)).any()
    return seen


@cache
def seen_on_the_way(world, clockwise):
    """True poses (N, 3), and the walls in view of each frame; the same for every seed."""
    segments, lines = walls(world)
    truth = path(world, clockwise)
    return truth, [np.flatnonzero(in_view(pose, segments, lines, REACH * world.size)) for pose in truth]


def line_log(seed, world=ROOM, sensor=None):
    """A log of the world, with its map and the true wall of every reading; the same noise wherever the origin is."""
    turns, ground, sonar, start = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
    lines = walls(world)[1]
    truth, views = seen_on_the_way(world, bool(turns.random() < 0.5))
    increments, floored = odometry(truth, world.slip, ground)
    L, sensor = np.linalg.cholesky(R), sensor or Line(max_range=REACH * world.size)
    frame, z, wall = [], [], []
    for k, view in enumerate(views):
        for w in view:
            if sonar.random() < SHARE:
                frame.append(k)
                wall.append(w)
                z.append(sensor.predict(truth[k], lines[w : w + 1])[0] + L @ sonar.standard_normal(2))
    z = np.array(z)
    z[:, 1] = wrap_angle(z[:, 1])
    sigma = np.array([world.prior[0], world.prior[0], world.prior[1]])
    known = LandmarkMap(np.arange(len(lines)), lines)
    inputs = Inputs(
        Prior(truth[0] + sigma * start.standard_normal(3), np.diag(sigma**2)), PERIOD * np.arange(len(truth)),
        increments, Observations(np.array(frame), z, np.tile(R, (len(z), 1, 1))), sensor, known, floored=floored,
    )  # fmt: skip
    return Log(f"walls:{seed}", inputs, Truth(truth, known, np.array(wall)))

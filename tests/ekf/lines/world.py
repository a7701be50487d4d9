"""An ideal world of walls: a robot on a circle in the room of 10 x 6 m, walls read with the stated noise."""

import numpy as np

from data.inputs import LandmarkMap
from data.log import Log
from data.se2 import between, wrap_angle
from data.sensors import Line
from data.truth import Truth
from tests.builders.logs import increments_of, inputs_of, observations_of
from wings.robot.simulated import room

PERIOD = 0.25
SPEED, RADIUS, CENTRE = 0.25, 1.6, np.array([3.1, 3.6])  # m/s, m: round one of the two boxes of the room
REACH = 6.0
SHARE = 0.17  # Of the frames in which a wall is in view, those that read it: once in 1.5 s
R = np.array([[0.007**2, 0.5 * 0.007 * 0.02], [0.5 * 0.007 * 0.02, 0.02**2]])
M = np.diag([0.001, 2e-4, 0.008]) ** 2  # Of the motion in a period


def walls(origin=(0.0, 0.0)):
    """Segments (W, 2, 2) and lines (W, 2) of rho, alpha, about an origin in the room [m]."""
    segments = room(0).segments - np.array(origin)
    way = segments[:, 1] - segments[:, 0]
    alpha = np.arctan2(-way[:, 0], way[:, 1])
    rho = np.cos(alpha) * segments[:, 0, 0] + np.sin(alpha) * segments[:, 0, 1]
    return segments, np.stack([rho, alpha], 1)


def in_view(pose, segments, lines, reach):
    """Walls (W,) whose foot is on the segment, within reach, with no other wall in between."""
    normal = np.stack([np.cos(lines[:, 1]), np.sin(lines[:, 1])], 1)
    d = lines[:, 0] - normal @ pose[:2]
    a, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    foot, length = d[:, None] * normal, (way**2).sum(1)
    along = ((pose[:2] + foot - a) * way).sum(1) / length
    seen = (along > 0.0) & (along < 1.0) & (np.abs(d) < reach)
    for w in np.flatnonzero(seen):
        t = d / (normal @ foot[w] + 1e-12)  # where on the way there the other lines are met
        at = ((pose[:2] + t[:, None] * foot[w] - a) * way).sum(1) / length
        seen[w] = not ((t > 0.0) & (t < 1.0 - 1e-9) & (at >= 0.0) & (at <= 1.0)).any()
    return seen


def line_log(seed, *, origin=(0.0, 0.0), seconds=300.0, prior=0.01, sensor=None):
    """A log of the world with its map, the same noise wherever the origin is; `prior`: sigmas of the first pose."""
    ground, sonar, start = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    segments, lines = walls(origin)
    sensor = sensor or Line(max_range=REACH)
    angle = SPEED * PERIOD / RADIUS * np.arange(int(seconds / PERIOD))
    place = CENTRE - origin + RADIUS * np.stack([np.cos(angle), np.sin(angle)], 1)
    truth = np.column_stack([place, wrap_angle(angle + 0.5 * np.pi)])
    exact = np.concatenate([np.zeros((1, 3)), between(truth[:-1], truth[1:])])
    increments = increments_of(exact + ground.multivariate_normal(np.zeros(3), M, len(truth)), M)
    views = [in_view(pose, segments, lines, sensor.max_range) & (sonar.random(len(lines)) < SHARE) for pose in truth]
    frame, wall = np.nonzero(views)
    z = np.array([sensor.predict(truth[k], lines[w : w + 1])[0] for k, w in zip(frame, wall)])
    z = z + sonar.multivariate_normal(np.zeros(2), R, len(z))
    z[:, 1] = wrap_angle(z[:, 1])
    known = LandmarkMap(np.arange(len(lines)), lines)
    begin = truth[0] + prior * start.standard_normal(3)
    inputs = inputs_of(
        increments, observations_of(frame, z, R), sensor, known, start=begin, spread=prior**2,
        time=PERIOD * np.arange(len(truth)),
    )  # fmt: skip
    return Log(f"walls:{seed}", inputs, Truth(truth, known, wall))

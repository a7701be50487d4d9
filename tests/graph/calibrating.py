"""Small worlds whose odometry and sensor err, and an oracle: dense least squares in the robot's own frame."""

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from association.decide import known_decisions
from data import se2
from data.inputs import ERRORS, Increments, LabelledObservations, Systematic
from data.motion.systematic import forgotten, knots
from data.sensors import RangeBearing
from graph.problem import Start
from tests.graph.worlds import circle, order_of_creation

SIGMA = dict(zip(ERRORS, (0.05, 0.03, 0.06, 0.05, 0.02, 0.04, 0.03), strict=True))
LENGTH = 6.0
"""m, of the drift: a knot every 1.2 m, which is three frames of the circle."""


def errors_of(names, **scaled):
    return Systematic(tuple(names), np.array([SIGMA[n] * scaled.get(n, 1.0) for n in names]), LENGTH)


def corrected_by_hand(motion, e):
    """What a robot moved by that measured `motion` (n, 3), from errors by name, each (n,); no sensor in it."""
    x, y, t = motion.T
    d = np.hypot(x, y) * np.where(x < 0, -1.0, 1.0)
    extra = d * (e["curvature"] + e["drift"]) + np.where(t > 0, e["left"], e["right"]) * t
    half = np.column_stack([0 * t, 0 * t, extra / 2])
    step = np.column_stack([(1 + e["scale"]) * x, (1 + e["scale"]) * y, t])
    return se2.compose(se2.compose(half, step), half)


def erring(sensor, task, systematic, seed=0, size=1.0, **world):
    """(Inputs, decisions, created, start at the truth, true errors (N, p)): the circle with errors drawn from their
    priors, times `size`.
    """
    inputs, truth, xy = circle(sensor, seed=seed, **world)
    rng = np.random.default_rng([seed, 1])
    names, o = systematic.names, inputs.observations
    constant, fresh = size * rng.normal(size=len(names)) * systematic.sigma, size * rng.normal(size=len(inputs))
    noise = inputs.increments.mean[1:] - se2.between(truth[:-1], truth[1:])
    mean, before = inputs.increments.mean.copy(), None
    while before is None or np.abs(mean - before).max() > 1e-9:
        of, ended = knots(systematic.length, mean)  # the knots are where the odometry that errs has them
        errors, before = np.tile(constant, (len(inputs), 1)), mean.copy()
        if systematic.drifts:
            drift = [fresh[0]]
            for metres, new in zip(ended, fresh[1:], strict=False):
                stays, anew = forgotten(metres, systematic.length)
                drift.append(stays * drift[-1] + math.sqrt(anew) * new)
            at = names.index("drift")
            errors[:, at] = np.array(drift)[of] * systematic.sigma[at]
        e = {n: errors[1:, names.index(n)] if n in names else np.zeros(len(mean) - 1) for n in ERRORS}
        mean[1:] = stated_by_hand(se2.between(truth[:-1], truth[1:]), e) + noise
    z = as_sensed(sensor, o.z, e["range"][0], e["bearing"][0])
    inputs = replace(
        inputs,
        increments=Increments(mean, inputs.increments.covariance),
        observations=LabelledObservations(o.frame, z, o.R, o.label),
        systematic=systematic,
    )
    if task == "slam":
        inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    return inputs, decisions, created, Start(truth, xy[order_of_creation(inputs, decisions, created)]), errors


def stated_by_hand(way, e):
    """What an odometry without noise says of the ways (n, 3): the inverse of `corrected_by_hand`, by iteration."""
    m = way.copy()
    for _ in range(12):
        m = m - se2.pose_error(corrected_by_hand(m, e), way)
    return m


def as_sensed(sensor, z, share, angle):
    """Readings (m, 2) of a sensor whose ranges are too large by a share and whose bearings by an angle."""
    if isinstance(sensor, RangeBearing):
        return np.column_stack([z[:, 0] * (1 + share), se2.wrap_angle(z[:, 1] + angle)])
    return (1 + share) * z @ se2.rotation(angle).T


def logarithm(pose):
    """Of poses (n, 3), as vectors: what exponentiates to them."""
    x, y, t = pose.T
    small = np.abs(t) < 1e-4
    a = np.where(small, 1.0 - t * t / 12.0, 0.5 * t / np.tan(np.where(small, 1.0, 0.5 * t)))
    return np.column_stack([a * x + 0.5 * t * y, a * y - 0.5 * t * x, t])


class Dense:
    """All unknowns in one vector: standard normal errors (knots last), the first pose's share of its prior, the poses
    after it, landmarks. Robot and landmarks in the world; readings as the sensor errs.
    """

    def __init__(self, inputs, decisions, created):
        self.inputs, s = inputs, inputs.systematic
        self.number = np.where(created >= 0, created, decisions)
        self.of, self.ended = knots(s.length, inputs.increments.mean)
        self.constant = [n for n in s.names if n != "drift"]
        self.sigma = dict(zip(s.names, s.sigma, strict=True))
        self.knots = len(self.ended) + 1 if s.drifts else 0
        self.landmarks = 0 if inputs.map is not None else int(self.number.max()) + 1
        B = se2.world_from_body(inputs.prior.mean[2])
        variance, axes = np.linalg.eigh(B.T @ inputs.prior.covariance @ B)
        self.prior_root = axes * np.sqrt(np.maximum(variance, 0.0))
        self.W = np.linalg.inv(np.linalg.cholesky(inputs.increments.covariance[1:]))
        self.V = np.linalg.inv(np.linalg.cholesky(inputs.observations.R))

    def errors(self, x):
        """By name, (N,) each."""
        q, e = len(self.constant), {n: np.zeros(len(self.of)) for n in ERRORS}
        for i, n in enumerate(self.constant):
            e[n] += x[i] * self.sigma[n]
        if self.knots:
            e["drift"] = x[q : q + self.knots][self.of] * self.sigma["drift"]
        return e

    def state(self, x):
        """Poses (N, 3) and landmarks (L, 2)."""
        at, n = len(self.constant) + self.knots, len(self.inputs)
        xi = self.prior_root @ x[at : at + 3]
        t = xi[2]
        a, b = (1.0, 0.0) if abs(t) < 1e-12 else (math.sin(t) / t, (1.0 - math.cos(t)) / t)
        xi = np.array([a * xi[0] - b * xi[1], b * xi[0] + a * xi[1], t])
        poses = np.vstack([se2.compose(self.inputs.prior.mean, xi), x[at + 3 : at + 3 * n].reshape(-1, 3)])
        return (poses, self.inputs.map.xy) if self.inputs.map is not None else (poses, x[at + 3 * n :].reshape(-1, 2))

    def first_pose_covariance(self, x, P):
        """World frame, additive: the unknowns of the first pose are its prior's."""
        at = len(self.constant) + self.knots
        J = np.empty((3, 3))
        for i in range(3):
            h = np.zeros(len(x))
            h[at + i] = 1e-6
            J[:, i] = se2.pose_error(self.state(x + h)[0][0], self.state(x - h)[0][0]) / 2e-6
        return J @ P[at : at + 3, at : at + 3] @ J.T

    def start(self, start):
        at = len(self.constant) + self.knots + 3
        landmarks = np.empty(0) if self.inputs.map is not None else start.landmark.ravel()
        return np.concatenate([np.zeros(at), start.pose[1:].ravel(), landmarks])

    def residuals(self, x):
        inputs, errors, (poses, xy) = self.inputs, self.errors(x), self.state(x)
        at = len(self.constant) + self.knots
        parts = [x[: len(self.constant)], x[at : at + 3]]
        if self.knots:
            drift = x[len(self.constant) : at]
            parts.append(drift[:1])
            for j, metres in enumerate(self.ended):
                stays, anew = forgotten(metres, inputs.systematic.length)
                parts.append([(drift[j + 1] - stays * drift[j]) / math.sqrt(anew)])
        m = inputs.increments.mean[1:]
        way = stated_by_hand(se2.between(poses[:-1], poses[1:]), {n: e[1:] for n, e in errors.items()})
        off = logarithm(se2.between(m, way))
        off[:, :2] = np.einsum("nij,nj->ni", [se2.rotation(t) for t in m[:, 2]], off[:, :2])
        parts.append(np.einsum("nij,nj->ni", self.W, off).ravel())
        o = inputs.observations
        z = inputs.sensor.predict(poses[o.frame], xy[self.number])
        z = as_sensed(inputs.sensor, z, errors["range"][0], errors["bearing"][0])
        parts.append(np.einsum("mij,mj->mi", self.V, inputs.sensor.residual(o.z, z)).ravel())
        return np.concatenate(parts)

    def solved(self, start):
        """(minimum of the squares, x there, covariance there)."""

        def slope(x):
            steps = 1e-6 * np.eye(len(x))
            return np.array([self.residuals(x + h) - self.residuals(x - h) for h in steps]).T / 2e-6

        found = least_squares(self.residuals, self.start(start), slope, method="lm", xtol=1e-10, ftol=1e-10, gtol=1e-10)
        J = slope(found.x)
        return 2.0 * found.cost, found.x, np.linalg.inv(J.T @ J)

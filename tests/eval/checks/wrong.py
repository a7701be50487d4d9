"""Estimators and ways of association that are wrong in one way each."""

import math

import numpy as np

from association.expectation import gate_threshold
from association.methods import singles
from data.se2 import compose, world_from_body
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from tests.eval.checks.plain import Plain


class NoWrap(EkfLocalizer):
    """Its heading is never wrapped, and read as if it were: the wrong sign at the seam."""

    def estimate(self):
        mean, P = super().estimate()
        return np.array([mean[0], mean[1], abs(mean[2])]), P


class BelowZero(EkfLocalizer):
    """Its heading loses the sign just below zero, and nowhere else."""

    def estimate(self):
        mean, P = super().estimate()
        return np.array([mean[0], mean[1], abs(mean[2]) if -0.4 < mean[2] < 0.0 else mean[2]]), P


class NearTheSeam(EkfLocalizer):
    """Its heading is a little too large in the last 0.04 rad before pi, and nowhere else."""

    def estimate(self):
        mean, P = super().estimate()
        return np.array([mean[0], mean[1], mean[2] + (0.5 if mean[2] > np.pi - 0.04 else 0.0)]), P


class Drifting(EkfLocalizer):
    """Half of every turn is forgotten."""

    def predict(self, increment):
        super().predict(increment._replace(mean=increment.mean * np.array([1.0, 1.0, 0.5])))


class Asymmetric(EkfSlam):
    def estimate(self):
        mean, P = super().estimate()
        return mean, P + np.triu(np.full((3, 3), 1e-3), 1)


class Writing(EkfSlam):
    def update(self, observations, decisions, **more):
        done = super().update(observations, decisions, **more)
        observations.z[:, 0] += 0.5
        return done


class Keeping(EkfSlam):
    """It works in the prior's own array."""

    def __init__(self, prior, sensor, options):
        super().__init__(prior, sensor, options)
        self.start = prior.mean

    def predict(self, increment):
        super().predict(increment)
        self.start += increment.mean


class Unseeded(EkfSlam):
    def estimate(self):
        mean, P = super().estimate()
        return mean + 1e-6 * np.random.default_rng().normal(size=3), P


class Sharing(EkfSlam):
    """Its state is that of the class."""

    seen = np.zeros(3)

    def estimate(self):
        Sharing.seen = Sharing.seen + 1e-9
        mean, P = super().estimate()
        return mean + self.seen, P


class Shaken(EkfLocalizer):
    """It takes what is discarded for pairings with the first landmark."""

    def update(self, observations, decisions, **more):
        return super().update(observations, np.where(decisions == -2, self.map.id[0], decisions), **more)


class Empty(EkfSlam):
    def update(self, observations, decisions, **more):
        assert observations.z.max() > 0.0
        return super().update(observations, decisions, **more)


class Swapped(EkfSlam):
    """Its landmarks are numbered from the last."""

    def landmarks(self):
        state = super().landmarks()
        return state._replace(number=state.number[::-1].copy())


class Returning(EkfSlam):
    """What was removed is in its map all the same."""

    def landmarks(self):
        state = super().landmarks()
        if len(state.number) and state.number[0] != 0:
            return tuple(np.concatenate([a[:1] * 0, a]) for a in state)
        return state


class Blurred(EkfSlam):
    """Its joint covariance is not that of its parts."""

    def expect(self, observations):
        from dataclasses import replace

        e = super().expect(observations)
        return replace(e, HPHt=1.5 * e.HPHt)


class Dead(EkfSlam):
    def predict(self, increment):
        raise OSError("flat battery")


def first(expectation, gate):
    """Takes the row for the number."""
    d2 = expectation.individual_distances()
    close = d2 < gate_threshold(gate)
    return np.where(close.any(axis=1), close.argmax(axis=1) if d2.shape[1] else 0, -1)


def unwrapped(expectation, gate):
    off = expectation.z[:, None] - expectation.z_hat[None]
    return np.where(np.abs(off[..., 1]).min(axis=1, initial=9.0) < 1.0, singles(expectation, gate), -1)


def greedy(expectation, gate):
    """Nearest neighbour that says nothing of pairing twice."""
    d2 = expectation.individual_distances()
    if not d2.size:
        return np.full(len(d2), -1)
    return np.where(d2.min(axis=1) < gate_threshold(gate), expectation.number[d2.argmin(axis=1)], -1)


def allowed(expectation, gate):
    return greedy(expectation, gate)


allowed.one_to_one = False


def fragile(expectation, gate):
    expectation.individual_distances().min(axis=1)
    return singles(expectation, gate)


def ungated(expectation, gate):
    return singles(expectation, math.sqrt(gate) if gate else None)


def in_order(expectation, gate):
    """Takes the first landmark inside the gate, whatever comes later."""
    close = expectation.individual_distances() < gate_threshold(gate)
    if not close.size:
        return np.full(len(close), -1)
    decisions, taken = np.full(len(close), -1), set()
    for i, row in enumerate(close):
        j = next((j for j in np.flatnonzero(row) if j not in taken), None)
        if j is not None:
            decisions[i] = expectation.number[j]
            taken.add(j)
    return decisions


def writing(expectation, gate):
    found = singles(expectation, gate)
    expectation.z[:] = 0.0
    return found


def tossing(expectation, gate):
    found = singles(expectation, gate)
    return np.where(np.random.default_rng().random(len(found)) < 0.5, -1, found)


def one_dof(expectation, gate):
    """Its gate has one degree of freedom too few."""
    limit = gate_threshold(gate, 1)
    found = singles(expectation, gate)
    d2 = expectation.individual_distances().min(axis=1, initial=math.inf)
    return np.where(d2 < limit, found, -1)


def never(expectation, gate):
    return np.full(len(expectation.z), -1)


class OwnRange(Plain):
    """It writes range and bearing out, and nothing is close enough in another world to correct its mean."""

    def step(self, K, nu):
        return 0.0 * (K @ nu)

    def found(self, z, R):
        super().found(z, R)
        angle = self.x[2] + z[1]
        self.x[-2:] = self.x[:2] + z[0] * np.array([np.cos(angle), np.sin(angle)])


class Averaging(Plain):
    """It predicts by sigma points, whose headings it averages as if they were lengths."""

    turn = staticmethod(lambda angle: angle)

    def predict(self, increment):
        L, R, centre = np.linalg.cholesky(3 * self.P).T, world_from_body(self.x[2]), compose(self.x, increment.mean)
        off = compose(self.x + np.vstack([L, -L]), increment.mean) - centre
        off[:, 2] = self.turn(off[:, 2])
        self.x, self.P = centre + off.mean(axis=0), np.cov(off.T, bias=True) + R @ increment.covariance @ R.T

"""Estimators and ways of association as strangers write them, right and wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from association.methods import singles
from data.result import Finished, Trajectory
from data.se2 import compose
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam


class Mine(EkfSlam):
    pass


class MineLocal(EkfLocalizer):
    pass


again = singles


class Bare:
    """As little as there can be: dead reckoning."""

    def __init__(self, prior, sensor, *rest):
        self.pose = prior.mean.copy()

    def predict(self, increment):
        self.pose = compose(self.pose, increment.mean)

    def update(self, observations, decisions):
        pass

    def estimate(self):
        return self.pose


class NoCovariance(EkfSlam):
    def estimate(self):
        return super().estimate().mean, None


class Silent(EkfSlam):
    """It says nothing of its innovations."""

    def update(self, observations, decisions, **more):
        super().update(observations, decisions, **more)


def _flattered(done):
    return done._replace(nis=float(done.dof))


class Flattering(EkfSlam):
    """Its NIS is what it should be, whatever happens."""

    def update(self, observations, decisions, **more):
        return _flattered(super().update(observations, decisions, **more))


class FlatteringLocal(EkfLocalizer):
    def update(self, observations, decisions, **more):
        return _flattered(super().update(observations, decisions, **more))


class MineLocalSmoothing(MineLocal):
    """It says that it smooths."""

    smooths = True


class FlatteringSmoothing(FlatteringLocal):
    smooths = True


class Noisy(EkfLocalizer):
    """The noise of its expectation is twice that of the log."""

    def expect(self, observations):
        e = super().expect(observations)
        return replace(e, R=4.0 * e.R)


class Dropping(EkfLocalizer):
    """It uses all observations but the first, and says so."""

    def update(self, observations, decisions, **more):
        kept = np.array(decisions)
        kept[:1] = -2
        return super().update(observations, kept, **more)


class Unexpecting:
    """A filter without `expect` that states an NIS."""

    def __init__(self, prior, sensor, known, options):
        self.inner = EkfLocalizer(prior, sensor, known)
        self.predict, self.update, self.estimate = self.inner.predict, self.inner.update, self.inner.estimate

    def predict(self, increment):
        """Replaced by that of the filter inside, as the others."""

    update = estimate = predict


class Unready(EkfLocalizer):
    def expect(self, observations):
        raise NotImplementedError("not yet")


class Smoothing(Mine):
    """What it hands back at the end is a path, too."""

    smooths = True

    def __init__(self, *given):
        super().__init__(*given)
        self.path = []

    def estimate(self):
        found = super().estimate()
        self.path.append(found)
        return found

    def finish(self):
        path = Trajectory(np.array([p.mean for p in self.path]), np.array([p.covariance for p in self.path]))
        return Finished(path, super().finish().map)


class Crashing(EkfSlam):
    def update(self, observations, decisions, **more):
        if self.created > 8:
            raise RuntimeError("no room\nfor more")
        return super().update(observations, decisions, **more)


class Unborn(EkfSlam):
    def __init__(self, *given):
        raise KeyError("constructor")


class Writing(EkfSlam):
    def update(self, observations, decisions, **more):
        observations.z[:] += 1.0
        return super().update(observations, decisions, **more)


def returning(what):
    class Wrong(EkfSlam):
        def estimate(self):
            return what(super().estimate())

    return Wrong


def nearest_by_hand(expectation, gate):
    """Reads nothing but the arrays; may pair twice."""
    d2 = expectation.individual_distances()
    if not d2.size:
        return np.full(len(d2), -1)
    best = d2.argmin(axis=1)
    return np.where(d2.min(axis=1) < 9.21, expectation.number[best], -1)

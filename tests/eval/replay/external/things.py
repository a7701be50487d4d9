"""Estimators and ways of association as strangers write them, right and wrong."""

from association.methods import singles
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

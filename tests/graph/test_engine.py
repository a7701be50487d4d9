"""What gtsam must do for the engine: parameters can be changed, the linearization point is not copied."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from graph.engine import Engine

SOFT = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)


def started():
    """An engine with two poses, the second linearized where it started; nothing moves far enough to be relinearized."""
    engine, start = Engine(1.0, 1, qr=False), gtsam.Values()
    start.insert(X(0), gtsam.Pose2())
    start.insert(X(1), gtsam.Pose2(1.0, 0.3, 0.4))
    step = gtsam.BetweenFactorPose2(X(0), X(1), gtsam.Pose2(1.2, 0.0, 0.1), SOFT)
    engine.add([gtsam.PriorFactorPose2(X(0), gtsam.Pose2(), SOFT), step], start)
    return engine


def pose(values):
    p = values.atPose2(X(1))
    return [p.x(), p.y(), p.theta()]


def test_everything_is_linearized_anew_on_request_and_the_threshold_is_back_afterwards():
    engine = started()
    assert np.allclose(pose(engine.isam.getLinearizationPoint()), [1.0, 0.3, 0.4])
    engine.linearize_all(X(1))
    assert np.allclose(pose(engine.isam.getLinearizationPoint()), [1.2, 0.0, 0.1])
    closer = gtsam.BetweenFactorPose2(X(0), X(1), gtsam.Pose2(1.4, 0.0, 0.1), SOFT)
    engine.add([closer], gtsam.Values())
    engine.update(X(1))
    assert np.allclose(pose(engine.isam.getLinearizationPoint()), [1.2, 0.0, 0.1]), "less than the threshold"
    assert np.allclose(pose(engine.values()), [1.3, 0.0, 0.1])


def test_the_linearization_point_is_handed_to_factors_in_python_without_a_copy():
    engine, seen = started(), []

    def error(this, values, jacobians):
        seen.append(values)
        if jacobians is not None:
            jacobians[0] = np.zeros((1, 3))
        return np.zeros(1)

    engine.add([gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [X(1)], error)], gtsam.Values())
    engine.linearize_all(X(1))
    assert any(values is engine.point for values in seen)

"""Random small graphs of every kind of factor, for tests of the audit."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, P, V, X

N = gtsam.noiseModel
CAMERA = gtsam.Cal3_S2(400.0, 400.0, 0.0, 320.0, 240.0)


def noise(rng, dim, robust=True):
    sigmas = rng.uniform(0.05, 0.5, dim)
    kind = rng.integers(4 if robust else 3)
    if kind == 0:
        return N.Isotropic.Sigma(dim, sigmas[0])
    if kind == 1:
        return N.Diagonal.Sigmas(sigmas)
    B = np.diag(sigmas) @ (np.eye(dim) + 0.3 * rng.normal(size=(dim, dim)))
    if kind == 2:
        return N.Gaussian.Covariance(B @ B.T)
    loss = (N.mEstimator.Huber.Create(0.7), N.mEstimator.Cauchy.Create(1.0), N.mEstimator.GemanMcClure.Create(3.0))
    return N.Robust.Create(loss[rng.integers(3)], N.Diagonal.Sigmas(sigmas))


def custom(rng, a, b):
    z = float(rng.normal(0.0, 0.1))

    def error(this, values, H):
        if H is not None:
            H[0], H[1] = np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]])
        return np.array([np.sin(values.atPose2(b).theta() - values.atPose2(a).theta() - z)])

    return gtsam.CustomFactor(noise(rng, 1), [a, b], error)


def planar(seed, poses=5, points=3):
    """A graph in the plane: with or without prior, landmarks, loops, callbacks; some variables are not determined."""
    rng = np.random.default_rng(seed)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    true = [gtsam.Pose2(*rng.normal(0, 2.0, 2), rng.uniform(-3, 3)) for _ in range(poses)]
    for k, pose in enumerate(true):
        values.insert(X(k), pose.retract(rng.normal(0, 0.05, 3)))
    lm = rng.normal(0, 4.0, (points, 2))
    for j in range(points):
        values.insert(L(j), lm[j] + rng.normal(0, 0.05, 2))
    if rng.random() < 0.6:
        graph.add(gtsam.PriorFactorPose2(X(0), true[0].retract(rng.normal(0, 0.1, 3)), noise(rng, 3)))
    ends = [(k, k + 1) for k in range(poses - 1)] + [tuple(rng.choice(poses, 2, replace=False)) for _ in range(3)]
    for a, b in ends:
        z = true[a].between(true[b]).retract(rng.normal(0, 0.1, 3))
        graph.add(gtsam.BetweenFactorPose2(X(int(a)), X(int(b)), z, noise(rng, 3)))
    for j in range(points):
        for k in rng.choice(poses, rng.integers(1, poses), replace=False).tolist():
            bearing = gtsam.Rot2(true[k].bearing(lm[j]).theta() + rng.normal(0, 0.05))
            r = float(true[k].range(lm[j]) + rng.normal(0, 0.1))
            kind = rng.integers(3)
            if kind == 0:
                graph.add(gtsam.BearingRangeFactor2D(X(k), L(j), bearing, r, noise(rng, 2)))
            elif kind == 1:
                graph.add(gtsam.BearingFactor2D(X(k), L(j), bearing, noise(rng, 1)))
            else:
                graph.add(gtsam.RangeFactor2D(X(k), L(j), r, noise(rng, 1)))
    graph.add(custom(rng, X(0), X(poses - 1)))
    return graph, values


def spatial(seed, poses=4, points=5):
    """A graph in space: between, prior, projection, range, priors of points and velocities."""
    rng = np.random.default_rng(seed)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    true = [gtsam.Pose3(gtsam.Rot3.RzRyRx(*rng.normal(0, 0.1, 3)), rng.normal(0, 0.5, 3)) for _ in range(poses)]
    lm = rng.uniform([-2, -2, 5], [2, 2, 9], (points, 3))
    for k, pose in enumerate(true):
        values.insert(X(k), pose.retract(rng.normal(0, 0.01, 6)))
        values.insert(V(k), rng.normal(0, 1, 3))
        graph.add(gtsam.PriorFactorVector(V(k), rng.normal(0, 1, 3), noise(rng, 3)))
    for a, b in [(k, k + 1) for k in range(poses - 1)] + [(0, poses - 1)]:
        z = true[a].between(true[b]).retract(rng.normal(0, 0.05, 6))
        graph.add(gtsam.BetweenFactorPose3(X(a), X(b), z, noise(rng, 6)))
    if rng.random() < 0.5:
        graph.add(gtsam.PriorFactorPose3(X(0), true[0], noise(rng, 6)))
    for j in range(points):
        values.insert(P(j), lm[j] + rng.normal(0, 0.02, 3))
        for k in rng.choice(poses, rng.integers(1, poses + 1), replace=False).tolist():
            if rng.random() < 0.7:
                pixel = gtsam.PinholeCameraCal3_S2(true[k], CAMERA).project(lm[j]) + rng.normal(0, 1.0, 2)
                model = N.Robust.Create(N.mEstimator.Huber.Create(1.0), N.Isotropic.Sigma(2, 1.0))
                model = N.Isotropic.Sigma(2, 1.0) if rng.random() < 0.6 else model
                graph.add(gtsam.GenericProjectionFactorCal3_S2(pixel, model, X(k), P(j), CAMERA))
            else:
                graph.add(
                    gtsam.RangeFactor3D(X(k), P(j), float(true[k].range(lm[j]) + rng.normal(0, 0.1)), noise(rng, 1))
                )
    if rng.random() < 0.5:
        graph.add(gtsam.BetweenFactorPoint3(P(0), P(1), lm[1] - lm[0], noise(rng, 3)))
    return graph, values


def inertial(seed, poses=5):
    rng = np.random.default_rng(seed)
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    params.setAccelerometerCovariance(1e-2 * np.eye(3))
    params.setGyroscopeCovariance(1e-3 * np.eye(3))
    params.setIntegrationCovariance(1e-4 * np.eye(3))
    from gtsam.symbol_shorthand import B

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(B(0), gtsam.imuBias.ConstantBias())
    graph.add(gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), noise(rng, 6)))
    for k in range(poses):
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(), np.array([0.5 * k, 0.0, 0.0])).retract(rng.normal(0, 0.01, 6)))
        values.insert(V(k), np.array([0.5, 0, 0]) + rng.normal(0, 0.01, 3))
        graph.add(gtsam.GPSFactor(X(k), np.array([0.5 * k, 0, 0]) + rng.normal(0, 0.1, 3), noise(rng, 3)))
        if k:
            made = gtsam.PreintegratedImuMeasurements(params, gtsam.imuBias.ConstantBias())
            for _ in range(10):
                made.integrateMeasurement(np.array([0, 0, 9.81]) + rng.normal(0, 0.1, 3), rng.normal(0, 0.01, 3), 0.1)
            graph.add(gtsam.ImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(0), made))
    graph.add(gtsam.PriorFactorVector(V(0), np.array([0.5, 0, 0]), noise(rng, 3)))
    return graph, values

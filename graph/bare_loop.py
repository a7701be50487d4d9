"""Baseline of the benchmark: gtsam's ISAM2 with the same factors, nothing else."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import Inputs, IntArray
from data.result import Trajectory
from graph.batch import build
from graph.engine import Engine
from graph.factors import pose2, pose_array, prior_factor
from graph.incremental import DELICATE, SKIP, THRESHOLD
from graph.optimum import in_world


def bare_isam2(inputs: Inputs, decisions: IntArray, created: IntArray) -> Trajectory:
    """SLAM, frame by frame: add the factors, update, read the newest pose and its covariance.

    Frames without observations join the next update. Factors are made beforehand; parameters, the
    choice of QR and the further updates after a jump are those of our smoother. No gate, no bookkeeping. Raises
    ValueError for a sensor of walls.
    """
    if not inputs.sensor.sees_points:
        raise ValueError("the bare loop supports only landmarks that are points")
    problem = build(inputs, decisions, created)
    prior, steps = (np.linalg.eigvalsh(C) for C in (inputs.prior.covariance, inputs.increments.covariance[1:]))
    engine = Engine(THRESHOLD, SKIP, qr=prior[0] < DELICATE < prior[-1] or steps.min(initial=np.inf) < DELICATE)
    isam, motion = engine.isam, problem.motion.factors()
    pose, covariance = np.empty((len(inputs), 3)), np.empty((len(inputs), 3, 3))
    graph, values, row, known = gtsam.NonlinearFactorGraph(), gtsam.Values(), 0, set()
    estimate, P = pose2(inputs.prior.mean), np.zeros((3, 3))
    graph.add(prior_factor(inputs.prior))
    for k in range(len(inputs)):
        if k:
            graph.add(motion[k - 1])
            estimate = estimate.compose(pose2(inputs.increments.mean[k]))
        values.insert(X(k), estimate)
        first = row
        while row < len(problem.observations) and problem.observations[row].frame == k:
            seen = problem.observations[row]
            for factor in seen.measured:
                graph.add(factor)
            if seen.number not in known:
                known.add(seen.number)
                at = inputs.sensor.inverse(pose_array(estimate), inputs.observations.z[row])[0][0]
                values.insert(L(seen.number), at)
            row += 1
        if row > first:
            isam.update(graph, values)
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            estimate, P = engine.settle(X(k), estimate), isam.marginalCovariance(X(k))
        pose[k], covariance[k] = pose_array(estimate), P
    return Trajectory(pose, in_world(pose, covariance))

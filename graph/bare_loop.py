"""The peers of the benchmark: gtsam's ISAM2 in a loop and its batch optimizer, with the same factors, nothing else."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import Inputs, IntArray
from data.result import Trajectory
from graph.batch import Start, build, start_values
from graph.engine import Engine
from graph.factors import pose2, prior_factor
from graph.incremental import SKIP, THRESHOLD
from graph.optimum import in_world
from graph.robust import is_delicate


def bare_isam2(inputs: Inputs, decisions: IntArray, created: IntArray, *, every_frame: bool = False) -> Trajectory:
    """SLAM, frame by frame: add the factors, update, read the newest pose and its covariance.

    As in our own loop, frames that see nothing join the next update, unless `every_frame` asks for one each. Factors
    are made beforehand, all at once; the parameters and the choice of QR are ours. No recovery, no gate, no
    bookkeeping. Raises ValueError for a sensor of walls.
    """
    if not inputs.sensor.sees_points:
        raise ValueError("the bare loop knows landmarks that are points alone")
    problem = build(inputs, decisions, created)
    isam = Engine(THRESHOLD, SKIP, qr=is_delicate(inputs)).isam
    pose, covariance = np.empty((len(inputs), 3)), np.empty((len(inputs), 3, 3))
    graph, values, row, known = gtsam.NonlinearFactorGraph(), gtsam.Values(), 0, set()
    estimate, P = pose2(inputs.prior.mean), np.zeros((3, 3))
    graph.add(prior_factor(inputs.prior))
    for k in range(len(inputs)):
        if k:
            graph.add(problem.motion[k - 1])
            estimate = estimate.compose(pose2(inputs.increments.mean[k]))
        values.insert(X(k), estimate)
        first = row
        while row < len(problem.sighted) and problem.sighted[row].frame == k:
            seen = problem.sighted[row]
            for factor in seen.measured:
                graph.add(factor)
            if seen.number not in known:
                known.add(seen.number)
                at = np.array([estimate.x(), estimate.y(), estimate.theta()])
                values.insert(L(seen.number), inputs.sensor.inverse(at, inputs.observations.z[row])[0][0])
            row += 1
        if every_frame or row > first:
            isam.update(graph, values)
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            estimate, P = isam.calculateEstimatePose2(X(k)), isam.marginalCovariance(X(k))
        pose[k], covariance[k] = (estimate.x(), estimate.y(), estimate.theta()), P
    return Trajectory(pose, in_world(pose, covariance))


def bare_batch(inputs: Inputs, decisions: IntArray, created: IntArray, start: Start) -> Trajectory:
    """SLAM: gtsam's Levenberg-Marquardt optimizer as it comes, and the marginal covariance of every pose and landmark.

    It stops where the error falls little, near the optimum or not, and says nothing.
    """
    problem = build(inputs, decisions, created)
    graph = problem.graph()
    found = gtsam.LevenbergMarquardtOptimizer(graph, start_values(problem, start)).optimize()
    marginals = gtsam.Marginals(graph, found)
    for n in problem.numbers.tolist():
        marginals.marginalCovariance(L(n))
    covariance = np.array([marginals.marginalCovariance(X(k)) for k in range(len(inputs))])
    pose = gtsam.utilities.extractPose2(gtsam.utilities.allPose2s(found))
    return Trajectory(pose, in_world(pose, covariance))

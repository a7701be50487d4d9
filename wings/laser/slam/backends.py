"""Estimators on the constraints of one laser log: key poses as frames, the chain as motion, loops as closures."""

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from association.expectation import gate_threshold
from association.names import SCAN
from association.truncated import truncated_square
from data.inputs import Increments, Inputs, IntArray, Observations
from data.motion.velocity import floor_covariances
from data.notice import stopped
from data.pose_measurements import Closures
from data.result import Failure, Innovations, Run, Trajectory
from data.se2 import Array, compose, covariances_in_world
from eval.replay.batch import batch
from eval.replay.estimators import dead_reckoning
from eval.replay.run import step_by_step
from eval.replay.settings import ESTIMATOR_TABLE, STEPPING, Setup
from graph.batch import CUT
from graph.factors import CAUCHY, HUBER, UnderConstrained
from wings.laser.pose_graph import FixedLagPoseGraph
from wings.laser.scans.constraints import Chain, Loops
from wings.laser.scans.uncertainty import residuals

TASK = "slam"
PLAIN = Setup()
NO_OBSERVATIONS = Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))
LOOP = "loop"  # Source of the closures that are loops


class Solved(NamedTuple):
    """The result of an estimator."""

    run: Run  # with a path over all frames
    final_keys: Array  # (K, 3) final key poses, of a filter those online (NaN: never reached)
    weight: Array  # (L,) final weight of each loop closure, 0: rejected, NaN: never accepted


class KeyInputs(NamedTuple):
    """Key poses as frames, without observations; `believed`: row in `Loops` of each of its closures."""

    inputs: Inputs
    believed: IntArray


def key_inputs(inputs: Inputs, chain: Chain, loops: Loops) -> KeyInputs:
    """The log of the key poses of a laser log with its accepted loop closures."""
    believed = np.flatnonzero(loops.believed >= 0)
    believed = believed[np.argsort(np.maximum(loops.key1, loops.key2)[believed], kind="stable")]
    source = np.zeros(len(believed), np.int64)
    ends = loops.key1[believed], loops.key2[believed]
    closures = Closures(*ends, loops.relative[believed], loops.covariance[believed], source, (LOOP,))
    covariance, floored = floor_covariances(chain.covariance, inputs.covariance_floor)
    given = replace(
        inputs, time=inputs.time[chain.frame], increments=Increments(chain.motion, covariance), floored=floored,
        observations=NO_OBSERVATIONS, scans=None, closures=closures if len(closures) else None,
    )  # fmt: skip
    return KeyInputs(given, believed)


def smoothed(name: str, given: KeyInputs) -> Run:
    """A batch smoother over key poses, started at the chain's dead reckoning and at the chordal path."""
    return batch(name, given.inputs, replace(dead_reckoning(given.inputs, TASK), association=SCAN))


def wheels_alone(inputs: Inputs) -> Run:
    """Dead reckoning by the wheels."""
    return dead_reckoning(replace(inputs.without_map(), observations=NO_OBSERVATIONS), TASK)


def estimated(
    name: str, inputs: Inputs, chain: Chain, loops: Loops, setup: Setup = PLAIN, *, gate: float | None = None
) -> Solved:
    """One estimator of `OF_SCANS` but dead reckoning, over the accepted loop closures; online: its key pose at the
    time, and the motion since. `gate`: the filter's, of a loop closure (3 dof); `setup.lag`: of `fixed-lag`.
    """
    begin = time.perf_counter()
    given = key_inputs(inputs, chain, loops)
    if name == "fixed-lag":
        run = _fixed_lag(given.inputs, setup.lag)
    elif name in STEPPING:
        run = step_by_step(name, given.inputs, TASK, "jcbb", replace(setup, gate_poses=gate if name == "ekf" else None))
        if name == "isam2":  # it keeps every key pose
            run = replace(run, state_size=3 * np.arange(1, len(given.inputs) + 1))
    else:
        run = smoothed(name, given)
    keys = run.final if run.final is not None else run.online
    assert keys is not None
    weight = np.full(len(loops), np.nan)
    if run.failure is None:
        weight[given.believed] = _weights(name, run, given.inputs.closures, keys.pose)
    if name == "ekf" and run.failure is None and run.closures is not None:
        run = _with_innovations(run, given.inputs, gate)
    found = over_frames(run, chain, len(inputs))
    return Solved(replace(found, association=SCAN, seconds=time.perf_counter() - begin), keys.pose, weight)


def _weights(name: str, run: Run, closures: Closures | None, pose: Array) -> Array:
    """The final weight (K,) of each closure: of its robust loss, or whether it was used."""
    if closures is None:
        return np.empty(0)
    square = residuals(pose, closures.frame1, closures.frame2, closures.relative, closures.covariance)
    loss = ESTIMATOR_TABLE[name].options.get("loss")
    if loss == "huber":
        return HUBER / np.sqrt(np.maximum(square, HUBER**2))
    if loss == "cauchy":
        return np.where(square > CUT**2, 0.0, 1.0 / (1.0 + square / CAUCHY**2))
    if name == "fixed-lag":
        return np.full(len(closures), np.nan)
    done = run.closures_final if run.closures_final is not None else run.closures
    return np.ones(len(closures)) if done is None else done.used.astype(float)


def _with_innovations(run: Run, inputs: Inputs, gate: float | None) -> Run:
    """A filter's run with the NIS of the closures it used, by frame."""
    done, closures = run.closures, inputs.closures
    assert done is not None
    assert closures is not None
    used = done.used & np.isfinite(done.nis)
    nis, dof = np.zeros(len(inputs)), np.zeros(len(inputs), np.int64)
    np.add.at(nis, closures.later[used], done.nis[used])
    np.add.at(dof, closures.later[used], done.dof[used])
    mean, var = truncated_square(gate_threshold(gate, 3), 3)
    formed = Innovations(np.where(dof > 0, nis, np.nan), dof, np.full(len(inputs), np.nan), np.empty((0, 2)))
    return replace(run, innovations=formed, total_nis=(float(nis.sum()), int(dof.sum())), gated=(mean / 3, var / 3))


def trajectory_over_frames(chain: Chain, pose: Array, covariance: Array) -> Trajectory:
    """Path of all N frames of key poses (K, 3), (K, 3, 3) and motion since, taken as independent; world, additive."""
    at, P = pose[chain.key], covariance[chain.key]
    path = compose(at, chain.since)
    F = np.tile(np.eye(3), (len(path), 1, 1))
    F[:, 0, 2], F[:, 1, 2] = at[:, 1] - path[:, 1], path[:, 0] - at[:, 0]
    world = F @ P @ F.transpose(0, 2, 1) + covariances_in_world(at[:, 2], chain.since_covariance)
    return Trajectory(path, 0.5 * (world + world.transpose(0, 2, 1)))


def over_frames(run: Run, chain: Chain, frames: int) -> Run:
    """A run over key poses as one over all `frames`, each attached to its key pose; observations are dropped."""

    def path(of: Trajectory | None) -> Trajectory | None:
        return None if of is None else trajectory_over_frames(chain, of.pose, of.covariance)

    def at(failure: Failure | None) -> Failure | None:
        return None if failure is None else failure._replace(frame=int(chain.frame[failure.frame]))

    none, innovations = np.empty(0, np.int64), run.innovations
    if innovations is not None:
        nis, likelihood = np.full(frames, np.nan), np.full(frames, np.nan)
        dof = np.zeros(frames, np.int64)
        nis[chain.frame], dof[chain.frame] = innovations.nis, innovations.dof
        likelihood[chain.frame] = innovations.log_likelihood
        innovations = Innovations(nis, dof, likelihood, np.empty((0, 2)))
    return replace(
        run, online=path(run.online), final=path(run.final), decisions=none, final_decisions=none, created=none,
        begun=None, removed=None, events=(), innovations=innovations, failure=at(run.failure),
        implausible=at(run.implausible), fixes=None, closures=None, fixes_final=None, closures_final=None,
        state_size=None if run.state_size is None else run.state_size[chain.key],
    )  # fmt: skip


def _fixed_lag(inputs: Inputs, lag: float) -> Run:
    """The newest key poses of the graph, key pose by key pose."""
    graph = FixedLagPoseGraph(inputs.prior, inputs.time, lag=lag)
    keys, none = len(inputs), np.empty(0, np.int64)
    online, covariance = np.full((keys, 3), np.nan), np.full((keys, 3, 3), np.nan)
    size = np.zeros(keys, np.int64)
    failure, final, k = None, None, 0
    try:
        for k in range(keys):
            if k:
                graph.add_key(inputs.increments.mean[k], inputs.increments.covariance[k])
            known = None if inputs.closures is None else inputs.closures.of(k)
            if known is not None:
                graph.add_loops(known.frame1, known.frame2, known.relative, known.covariance)
            graph.update()
            online[k], covariance[k] = graph.newest()
            size[k] = 3 * graph.size
        final = Trajectory(graph.poses(), graph.covariances())
    except UnderConstrained as stop:
        failure = Failure("diverged", k, stopped(str(stop)))
        final = Trajectory(np.full((keys, 3), np.nan), np.full((keys, 3, 3), np.nan))
    path = Trajectory(online, covariance)
    return Run("fixed-lag", SCAN, TASK, path, final, None, none, none, none, state_size=size, failure=failure)

"""All back ends on the same constraints of one laser log: key poses, the chain between them, loop closures."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from association.expectation import gate_threshold
from association.scans.constraints import SCAN, Chain, Loops
from association.truncated import truncated_square
from data.inputs import Inputs, IntArray
from data.notice import Code, Notice, notice, stopped
from data.result import DISCARD, Failure, Innovations, Run, Trajectory
from data.se2 import Array, compose, covariances_in_world, dead_reckoned
from ekf.pose_chain import run_pose_chain
from ekf.whole_run import run_filter
from eval.replay.settings import Setup
from graph.factors import UnderConstrained
from graph.optimum import NotConvergedError
from graph.poses.batch import PoseProblem, SmoothedPoses, pose_problem, smooth_poses
from graph.poses.online import FixedLagPoseGraph, PoseGraph
from graph.poses.robust import gnc_poses

TASK = "slam"
LOSSES = {"batch": "gaussian", "batch-huber": "huber", "batch-cauchy": "cauchy"}
"""Losses on loop closures of the batch smoothers."""
NAMES = ("dead-reckoning", "ekf", "isam2", "fixed-lag", *LOSSES, "gnc")
PLAIN = Setup()
MOST_KEYS = 4000
"""Key poses of a filter: its time grows with their cube, a minute for 3300."""


class Solved(NamedTuple):
    """The result of a back end."""

    run: Run  # with a path over all frames
    final_keys: Array  # (K, 3) final key poses, of a filter its last state (NaN: never reached)
    weight: Array  # (L,) final weight of each loop closure, 0: rejected, NaN: never accepted


class _Constraints(NamedTuple):
    """Input of a back end: `believed` (L,) rows of the accepted loop closures, in the order of acceptance."""

    inputs: Inputs
    chain: Chain
    loops: Loops
    believed: IntArray

    def joining(self, key: int) -> IntArray:
        """Rows of the loop closures accepted at a key pose."""
        joined = self.loops.believed[self.believed]
        return self.believed[np.searchsorted(joined, key) : np.searchsorted(joined, key + 1)]

    def problem(self) -> PoseProblem:
        """All constraints at once."""
        c, o, b = self.chain, self.loops, self.believed
        return pose_problem(
            self.inputs.prior, c.motion, c.covariance, o.key1[b], o.key2[b], o.relative[b], o.covariance[b]
        )

    def weights(self, of_believed: Array) -> Array:
        """Weights (L,) of all loop closures from those of the accepted ones."""
        weight = np.full(len(self.loops), np.nan)
        weight[self.believed] = of_believed
        return weight


def backend(
    name: str,
    inputs: Inputs,
    chain: Chain,
    loops: Loops,
    setup: Setup = PLAIN,
    *,
    loss: str = "gaussian",
    gate: float | None = None,
) -> Solved:
    """One back end, by its name in `NAMES`, over the accepted loop closures.

    Online, at frame f: the estimate of its key pose at the time of f, with all loop closures accepted by then, and the
    motion since. `loss` on loop closures is that of `isam2` and `fixed-lag` (the name determines it for the others);
    `gate` the filter's chi-square probability (3 dof) of a loop closure, None: no gate; `setup.lag` that of
    `fixed-lag`. Seconds are those of the back end alone.
    """
    if name not in NAMES:
        raise ValueError(f"back end {name!r}; known: {', '.join(NAMES)}")
    begin = time.perf_counter()
    order = np.argsort(loops.believed, kind="stable")
    given = _Constraints(inputs, chain, loops, order[loops.believed[order] >= 0].astype(np.int64))
    if name == "dead-reckoning":
        solved = _dead_reckoning(given)
    elif name == "ekf" and len(chain.frame) > MOST_KEYS:
        why = notice(Code.TOO_MANY_KEYS, keys=len(chain.frame), most=MOST_KEYS)
        run, nothing_known = _stopped(name, chain, Failure("incomplete", 0, why))
        solved = Solved(run, nothing_known, np.full(len(loops), np.nan))
    elif name == "ekf":
        solved = _filter(given, gate)
    elif name in ("isam2", "fixed-lag"):
        lag = setup.lag if name == "fixed-lag" else None
        solved = _incremental(name, given, loss, lag)
    else:
        solved = _batch(name, given)
    return solved._replace(run=replace(solved.run, seconds=time.perf_counter() - begin))


def over_frames(chain: Chain, pose: Array, covariance: Array) -> Trajectory:
    """Path of all N frames from key poses (K, 3), (K, 3, 3) and the motion since (world, additive).

    The error of this motion is taken as independent of the key pose's.
    """
    at, P = pose[chain.key], covariance[chain.key]
    path = compose(at, chain.since)
    F = np.tile(np.eye(3), (len(path), 1, 1))
    F[:, 0, 2], F[:, 1, 2] = at[:, 1] - path[:, 1], path[:, 0] - at[:, 0]
    world = F @ P @ F.transpose(0, 2, 1) + covariances_in_world(at[:, 2], chain.since_covariance)
    return Trajectory(path, 0.5 * (world + world.transpose(0, 2, 1)))


def _run(name: str, **parts: object) -> Run:
    """A run without observations, map or decisions."""
    none = np.empty(0, np.int64)
    run = Run(name, SCAN, TASK, None, None, None, none, none, none)
    return replace(run, **parts)  # type: ignore[arg-type]


def _diverged(name: str, chain: Chain, frame: int, stop: UnderConstrained) -> tuple[Run, Array]:
    """A failed smoother and its blank key poses (K, 3)."""
    return _stopped(name, chain, Failure("diverged", frame, stopped(str(stop))))


def _stopped(name: str, chain: Chain, failure: Failure) -> tuple[Run, Array]:
    """A run without a result and its blank key poses (K, 3)."""
    blank = np.full((len(chain.frame), 3), np.nan)
    path = over_frames(chain, blank, np.full((len(blank), 3, 3), np.nan))
    run = _run(name, failure=failure)
    return (replace(run, online=path) if name == "ekf" else replace(run, final=path)), blank


def _dead_reckoning(given: _Constraints) -> Solved:
    inputs = given.inputs
    nothing = np.full(len(inputs.observations.frame), DISCARD, np.int64)
    alone = run_filter(inputs.without_map(), nothing)
    path = Trajectory(alone.pose, alone.covariance)
    run = _run("dead-reckoning", association="none", online=path, state_size=alone.state_size)
    return Solved(run, path.pose[given.chain.frame], np.full(len(given.loops), np.nan))


def _filter(given: _Constraints, gate: float | None) -> Solved:
    """EKF over all key poses, online only."""
    c, o, n = given.chain, given.loops, len(given.inputs)
    threshold = gate_threshold(gate, 3)
    mean, variance = truncated_square(threshold, 3)
    found = run_pose_chain(
        given.inputs.prior, c.motion, c.covariance, o.key1, o.key2, o.relative, o.covariance, o.believed,
        threshold=threshold,
    )  # fmt: skip
    nis, dof = np.full(n, np.nan), np.zeros(n, np.int64)
    nis[c.frame], dof[c.frame] = np.where(found.dof > 0, found.nis, np.nan), found.dof
    failure: Failure | None = None
    notes: tuple[Notice, ...] = ()
    if found.failure is not None:
        failure = Failure("diverged", int(c.frame[found.failure.frame]), found.failure.notice)
    if gate is not None:
        tested = int(np.isfinite(found.d2).sum())
        rejected = tested - int(found.used.sum())
        notes = (notice(Code.CLOSURES_GATED, gate=gate, rejected=rejected, closures=tested),)
    run = _run(
        "ekf",
        online=over_frames(c, found.online, found.online_covariance),
        innovations=Innovations(nis, dof, np.full(n, np.nan), np.empty((0, 2))),
        total_nis=(float(found.nis.sum()), int(found.dof.sum())) if failure is None else None,
        state_size=3 * (c.key + 1),
        failure=failure,
        notes=notes,
        gated=(mean / 3.0, variance / 3.0),
    )
    return Solved(run, found.pose, given.weights(found.used[given.believed].astype(float)))


def _incremental(name: str, given: _Constraints, loss: str, lag: float | None) -> Solved:
    """iSAM2 key pose by key pose, over all of them or (`lag`) the newest; isam2 ends at the optimum of all
    constraints.
    """
    inputs, chain = given.inputs, given.chain
    graph = PoseGraph(inputs.prior, loss=loss) if lag is None else FixedLagPoseGraph(inputs.prior, lag=lag, loss=loss)
    keys = len(chain.frame)
    online, covariance = np.full((keys, 3), np.nan), np.full((keys, 3, 3), np.nan)
    size = np.zeros(keys, np.int64)
    k = 0
    try:
        for k in range(keys):
            if k:
                graph.add_key(chain.motion[k], chain.covariance[k])
            if isinstance(graph, FixedLagPoseGraph):
                graph.stamp(float(inputs.time[chain.frame[k]]))
            rows, o = given.joining(k), given.loops
            graph.add_loops(o.key1[rows], o.key2[rows], o.relative[rows], o.covariance[rows])
            graph.update()
            online[k], covariance[k] = graph.newest()
            size[k] = 3 * graph.size
        pose = graph.poses()
        if isinstance(graph, FixedLagPoseGraph):
            final = over_frames(chain, pose, graph.covariances())
            notes = (notice(Code.CLOSURES_LOST, fixes=graph.fixes, lost=graph.lost),)
            run = _run(name, final=final, notes=notes)
            weight = np.full(len(given.believed), np.nan)
        else:
            found = smooth_poses(given.problem(), pose, loss=loss)
            run, pose, weight = _smoothed(name, given, found, loss), found.pose, found.weight
    except UnderConstrained as stop:
        run, pose = _diverged(name, chain, int(chain.frame[k]), stop)
        weight = np.full(len(given.believed), np.nan)
    run = replace(run, online=over_frames(chain, online, covariance), state_size=size[chain.key])
    return Solved(run, pose, given.weights(weight))


def _batch(name: str, given: _Constraints) -> Solved:
    """A batch smoother from the chain's dead reckoning; if that does not converge, from iSAM2's path."""
    chain, problem = given.chain, given.problem()
    loss = LOSSES.get(name, "gaussian")

    def solve(start: Array) -> SmoothedPoses:
        return gnc_poses(problem, start)[0] if name == "gnc" else smooth_poses(problem, start, loss=loss)

    try:
        try:
            found = solve(dead_reckoned(given.inputs.prior.mean, chain.motion))
        except NotConvergedError:
            start = _incremental("isam2", given, loss, None).final_keys
            if not np.isfinite(start).all():
                raise
            found = solve(start)
    except UnderConstrained as stop:
        run, nothing = _diverged(name, chain, 0, stop)
        return Solved(run, nothing, np.full(len(given.loops), np.nan))
    run = _smoothed(name, given, found, loss)
    if name == "gnc":
        out = int((found.weight == 0.0).sum())
        rejected = notice(Code.CLOSURES_REJECTED, rejected=out, closures=len(found.weight))
        run = replace(run, notes=(rejected,))
    return Solved(run, found.pose, given.weights(found.weight))


def _smoothed(name: str, given: _Constraints, found: SmoothedPoses, loss: str) -> Run:
    return _run(
        name,
        final=over_frames(given.chain, found.pose, found.covariance),
        total_nis=(found.cost, found.dof) if loss == "gaussian" else None,
        iterations=found.iterations,
        last_step_sigma=found.last_step,
    )

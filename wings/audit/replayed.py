"""The graphs that batch smoothers of the replay end with, for the audit: linearized as the smoothers do it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from data.inputs import Inputs, IntArray
from data.se2 import Array, covariances_in_body
from data.sensors import RANGE_BEARING, RELATIVE_POINT
from graph.batch import NONE_REJECTED, Rejected, build
from graph.problem import Start
from graph.qr.elimination import Rows
from graph.qr.rows import Linearizer
from wings.audit.audit import Statistics, statistics
from wings.audit.kinds import LOOP, ODOMETRY, PRIOR, Kinds
from wings.audit.linear import Group, System

OBSERVATIONS, FIXES, MAP, DRIFT, ERRORS, SCANS = (
    "observations",
    "fixes",
    "landmarks of the map",
    "drift",
    "systematic errors",
    "scan matching",
)
SEED = 0  # of the probes of variance components
DIAGONAL = 1e-9  # correlation below which a noise is diagonal


@dataclass(frozen=True, eq=False)
class Replayed:
    """Statistics of the graph of a batch smoother.

    Attributes:
        statistics: of its factors.
        frame: (F,) frame into which an increment leads, or of an observation; of key poses their number; -1: neither.
        observation: (F,) row of the observation, loop closure or fix; -1: another factor.
    """

    statistics: Statistics
    frame: IntArray
    observation: IntArray


def of_landmarks(
    inputs: Inputs,
    decisions: IntArray,
    initialized: IntArray,
    end: Start,
    rejected: Rejected = NONE_REJECTED,
    *,
    scans: bool = False,
) -> Replayed:
    """The graph of `graph.batch.smooth` at its end; arguments as there. `scans`: motion is of scan matching."""
    problem = build(inputs, decisions, initialized, rejected=rejected)
    problem = replace(problem, pose_factors=[p for p in problem.pose_factors if p.used])
    values = problem.values(end)
    linearizer = Linearizer(problem)
    rows, errors = linearizer(values), linearizer.constants(values)
    n, m, blocks = linearizer.frames, len(problem.observations), len(rows.variable)
    loops = sum(p.closure for p in problem.pose_factors)
    fixes = len(problem.pose_factors) - loops
    used = np.flatnonzero(np.where(initialized >= 0, initialized, decisions) >= 0)
    frame, observation = np.full(blocks + (len(errors) > 0), -1), np.full(blocks + (len(errors) > 0), -1)
    frame[1:n], frame[n : n + m] = np.arange(1, n), inputs.observations.frame[used]
    observation[n : n + m] = used
    for row, p in enumerate(problem.pose_factors, n + m):
        frame[row], observation[row] = max(p.frames), p.row
    names = [PRIOR, SCANS if scans else ODOMETRY, OBSERVATIONS, FIXES, LOOP, MAP, DRIFT, ERRORS]
    places = len(problem.priors)
    drifts = blocks - n - m - fixes - loops - places
    of = np.repeat(np.arange(8), [1, n - 1, m, fixes, loops, places, drifts, int(len(errors) > 0)])
    axes = [(), () if scans else _axes_of_odometry(inputs), _axes_of_observations(inputs, used), (), (), (), (), ()]
    return _replayed(rows, errors, of, names, axes, frame, observation)


def _replayed(
    rows: Rows,
    errors: Array,
    of: IntArray,
    names: list[str],
    axes: list[tuple[str, ...]],
    frame: IntArray,
    observation: IntArray,
) -> Replayed:
    some = np.unique(of)
    known = Kinds(
        np.searchsorted(some, of), tuple(names[k] for k in some), tuple(axes[k] for k in some),
        np.array(names)[of] == LOOP,
    )  # fmt: skip
    system = system_of(rows, errors)
    keys = [tuple(v for v in row if v >= 0) for row in rows.variable.tolist()] + [()] * (len(errors) > 0)
    # the first pose is that of the prior, in its sigmas; poses and points of the others in m
    metres = [np.arange(2) if d > 1 else np.zeros(0, np.int64) for d in rows.dim.tolist()]
    metres[0] = np.zeros(0, np.int64)
    if len(errors):
        metres.append(np.zeros(0, np.int64))
    found = statistics(system, keys, known, metres, np.random.default_rng(SEED), brief=True)
    return Replayed(found, frame, observation)


def system_of(rows: Rows, errors: Array) -> System:
    """The rows as a system, a factor each block; `errors` (q,), constant ones in sigmas, are its last variable."""
    q, size = len(errors), len(rows.dim)
    dim = rows.dim if q == 0 else np.append(rows.dim, q)
    width = np.where(rows.variable >= 0, dim[rows.variable], 0)
    shape, groups = np.column_stack([rows.height, width]), []
    for each in np.unique(shape, axis=0):
        at, d = np.flatnonzero((shape == each).all(1)), int(each[0])
        there = [j for j in range(rows.variable.shape[1]) if each[1 + j]]
        A = [rows.A[at, :d, 3 * j : 3 * j + int(each[1 + j])] for j in there]
        variables = rows.variable[at][:, there]
        if q:
            A.append(rows.b[at, :d, 1:])
            variables = np.column_stack([variables, np.full(len(at), size)])
        groups.append(Group(at, variables, np.concatenate(A, axis=2), -rows.b[at, :d, 0], np.ones(len(at))))
    count = len(rows.variable)
    if q:
        prior = Group(np.array([count]), np.array([[size]]), np.eye(q)[None], errors[None], np.ones(1))
        groups.append(prior)
    return System(range(len(dim)), dim, groups, count + (q > 0))


def _axes_of_odometry(inputs: Inputs) -> tuple[str, ...]:
    if inputs.systematic is not None:
        return ()
    increments = inputs.increments
    C = covariances_in_body(increments.mean[1:, 2], increments.covariance[1:])
    return ("x", "y", "theta") if _diagonal(C) else ()


def _axes_of_observations(inputs: Inputs, used: IntArray) -> tuple[str, ...]:
    """Names of the residuals of all observations in use, if their noise is diagonal in them."""
    sensor, o = inputs.sensor, inputs.observations
    if not sensor.sees_points or sensor.translation != (0.0, 0.0) or not _diagonal(o.R[used]):
        return ()
    if sensor.kind == RELATIVE_POINT:
        return ("x", "y") if sensor.rotation == 0.0 else ()
    return ("bearing", "range") if sensor.kind == RANGE_BEARING else ()


def _diagonal(C: Array) -> bool:
    """Whether covariances (n, d, d) are."""
    sigma = np.sqrt(np.einsum("nii->ni", C))
    scale = sigma[:, :, None] * sigma[:, None, :]
    return bool((np.abs(C * (1.0 - np.eye(C.shape[1]))) <= DIAGONAL * scale).all())

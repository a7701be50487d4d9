"""A filter over a whole log in one compiled loop, for decisions that were made beforehand (known association).

The step-by-step filters give the same bytes; this spares them the way through the interpreter at every frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from data.blocks import diagonal_blocks
from data.inputs import Inputs, IntArray
from data.result import DISCARD, NEW, MapState, Systematics
from data.se2 import Array
from ekf import kernels, systematic
from ekf.filter import DEFAULT, FilterOptions
from ekf.kernels import NEWEST, OK, augment, healthy, predict
from ekf.systematic import hold_known, predict_with_errors
from ekf.updates import update, update_each
from ekf.walls import frame_of


class FilterRun(NamedTuple):
    """Pose (N, 3), covariance (N, 3, 3); nis, dof, log_likelihood, state_size (N,) each.

    `white` (M, 2) as in `Innovations`. `decisions` (M,) are the given ones, gated pairings turned into `DISCARD`;
    `failure` is (frame, why) or None: the rows after it are NaN.
    `errors`: the systematic ones, where the inputs have any.
    """

    pose: Array
    covariance: Array
    nis: Array
    dof: IntArray
    log_likelihood: Array
    state_size: IntArray
    white: Array
    decisions: IntArray
    map: MapState | None
    failure: tuple[int, str] | None
    errors: Systematics | None = None


def run_filter(
    inputs: Inputs,
    decisions: IntArray,
    *,
    threshold: float = np.inf,
    options: FilterOptions = DEFAULT,
) -> FilterRun:
    """EKF localization (inputs with a map) or EKF-SLAM (without) with given decisions (M,).

    SLAM: decisions are landmark numbers in order of creation, `NEW` or `DISCARD`; localization: map ids or `DISCARD`.
    """
    if options.new_variance_per_square is not None:
        raise ValueError("a new landmark's variance depends on its distance only in the step-by-step filter")
    n, slam = len(inputs), inputs.map is None
    decided = np.array(decisions, np.int64)
    if inputs.map is None:
        known = np.empty((0, 2))
    else:
        known = inputs.map.xy
        paired = decided >= 0
        decided[paired] = inputs.map.rows(decided[paired])
        if np.any(decided[paired] < 0):
            raise ValueError("decisions name a landmark the map does not have")
        decided[~paired] = DISCARD
    of = inputs.systematic
    frame = frame_of(of, inputs.sensor, inputs.prior, options, slam=slam)
    errors, sensor = systematic.as_states(of, frame), frame.sensor(inputs.sensor)
    base = 3 + len(errors.place)
    room = int((decided == NEW).sum())
    if errors.range_at >= 0 and not slam:
        room = int(np.bincount(inputs.observations.frame[decided >= 0]).max(initial=0))
    capacity = base + 2 * room
    mean, P = np.zeros(capacity), np.zeros((capacity, capacity))
    mean[:base], P[:base, :base] = systematic.begin(inputs.prior, of, frame)
    state, variance = np.full((n, base), np.nan), np.full((n, base, base), np.nan)
    stats, size = np.zeros((n, 3)), np.zeros(n, np.int64)
    first = mean.copy() if options.first_estimates else NEWEST
    o = inputs.observations
    white = np.full((len(o.z), 2), np.nan)
    how = options.each, options.augment_variance(0.0), options.rule_with(base - 3)
    d, status, stopped = run(
        sensor.kind, sensor.extrinsic, mean, P, base, inputs.increments.mean, inputs.increments.covariance,
        inputs.start, o.z, o.R, decided, known, how, float(threshold), first, errors,
        (state, variance, stats, size, white),
    )  # fmt: skip
    failure = None
    if status != kernels.OK:
        failure = (int(stopped), kernels.FAILURES[status])
        state[stopped:], variance[stopped:] = np.nan, np.nan
    if inputs.map is not None:
        decided = np.where(decided >= 0, inputs.map.id[np.maximum(decided, 0)], DISCARD)
    found = None
    if slam:
        count, b = (d - base) // 2, slice(3, base)
        blocks = diagonal_blocks(P[base:d, base:d])
        found = MapState(np.arange(count, dtype=np.int64), mean[base:d].reshape(count, 2).copy(), blocks)
        found = systematic.landmarks(found, P[base:d, b].reshape(count, 2, base - 3), mean[b], P[b, b], frame)
    return FilterRun(
        *systematic.poses(state, variance, frame), stats[:, 0], stats[:, 2].astype(np.int64), stats[:, 1], size, white,
        decided, found, failure, systematic.of_frames(of, state, variance),
    )  # fmt: skip


@numba.njit(cache=True)
def run(  # type: ignore[no-untyped-def]
    kind, extrinsic, mean, P, d, motion, M, start, z, R, decision, known, how, threshold, first, errors, out
):
    """A whole log with decisions made beforehand: what the step-by-step filter does, without leaving compiled code.

    `decision` (M,): SLAM (known empty): landmark number, `NEW` or `DISCARD`; localization: row of `known` (L, 2) or
    `DISCARD`. Rejected pairings become `DISCARD` in place. `how` = each, variance of a new landmark, rule; `first` as
    in `ekf.kernels`; `errors` as in `ekf.systematic`; `out` = pose and errors (N, 3 + p), their covariance
    (N, 3 + p, 3 + p), stats (N, 3), state_size (N,), white (M, 2). Returns (d, status, frame of the failure).
    """
    each, variance, rule = how
    pose, covariance, stats, size, white = out
    slam = len(known) == 0
    n, base = len(motion), 3 + len(errors.place)
    held = not slam and errors.range_at >= 0
    for f in range(n):
        if f > 0:
            if base > 3:
                predict_with_errors(mean, P, d, motion[f], M[f], first, errors)
            else:
                predict(mean, P, d, motion[f], M[f], first)
        begin, end = start[f], start[f + 1]
        paired = 0
        for i in range(begin, end):
            paired += decision[i] >= 0
        status = OK
        if paired > 0:
            at, xy = np.empty(paired, np.int64), np.empty((paired, 2))
            zs, Rs, rows = np.empty((paired, 2)), np.empty((paired, 2, 2)), np.empty(paired, np.int64)
            keep, own = np.empty(paired, np.bool_), np.empty((paired, 2))
            k = 0
            for i in range(begin, end):
                if decision[i] >= 0:
                    rows[k], zs[k], Rs[k] = i, z[i], R[i]
                    at[k] = -1
                    if slam:
                        at[k] = base + 2 * decision[i]
                    else:
                        xy[k] = known[decision[i]]
                    k += 1
            used = d
            if held:  # known landmarks are states while the update lasts
                hold_known(mean, P, d, xy, first, errors)
                at[:], used = d + 2 * np.arange(paired), d + 2 * paired
            if each:
                status = update_each(
                    kind, extrinsic, mean, P, used, at, xy, zs, Rs, threshold, keep, stats[f], own, rule, first
                )
            else:
                status = update(
                    kind, extrinsic, mean, P, used, at, xy, zs, Rs, threshold, keep, stats[f], own, rule, first
                )
            for k in range(paired):
                white[rows[k]] = own[k]
                if not keep[k]:
                    decision[rows[k]] = DISCARD
        if slam and status == OK:
            for i in range(begin, end):
                if decision[i] == NEW:
                    augment(kind, extrinsic, mean, P, d, z[i], R[i], variance, first)
                    d += 2
        if status == OK:
            status = healthy(mean, P)
        pose[f] = mean[:base]
        covariance[f] = P[:base, :base]
        size[f] = d
        if status != OK:
            return d, status, f
    return d, OK, n

"""A filter over a whole log in one compiled loop, for known decisions; the same bytes as step by step."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from data.blocks import diagonal_blocks
from data.inputs import Inputs, IntArray, Systematic
from data.motion.systematic import SensorFrame
from data.result import DISCARD, NEW, MapState, Systematics
from data.se2 import Array
from ekf import kernels, systematic
from ekf.filter import DEFAULT, FilterOptions, frame_of
from ekf.kernels import NEWEST, OK, Pairings, augment, healthy, predict
from ekf.systematic import Errors, hold_known, predict_with_errors
from ekf.updates import Outcome, UpdateRule, update, update_each

NO_MAP = np.empty((0, 2))
NO_MAP.setflags(write=False)  # as a map's positions are: the loop is compiled once


class FilterRun(NamedTuple):
    """The results of a filter over N frames and M observations."""

    pose: Array  # (N, 3)
    covariance: Array  # (N, 3, 3)
    nis: Array  # (N,), as dof, log_likelihood and state_size
    dof: IntArray
    log_likelihood: Array
    state_size: IntArray
    white: Array  # (M, 2) as in `Innovations`
    decisions: IntArray  # (M,) the given ones, gated pairings turned into `DISCARD`
    map: MapState | None
    failure: tuple[int, str] | None  # frame and reason; later rows are NaN
    errors: Systematics | None = None  # the systematic ones, where the inputs have any


def run_filter(
    inputs: Inputs, decisions: IntArray, *, threshold: float = np.inf, options: FilterOptions = DEFAULT
) -> FilterRun:
    """EKF localization (inputs with a map) or EKF-SLAM (without) with given decisions (M,). SLAM: decisions are
    landmark numbers in order of creation, `NEW` or `DISCARD`; localization: map ids or `DISCARD`.
    """
    if options.new_variance_per_square is not None:
        raise ValueError("a new landmark's variance depends on its distance only in the step-by-step filter")
    n, slam = len(inputs), inputs.map is None
    decided = np.array(decisions, np.int64)
    if inputs.map is None:
        known = NO_MAP
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
    track = empty_track(n, base, len(inputs.observations.z))
    state, variance = track.pose, track.covariance
    first = mean.copy() if options.first_estimates else NEWEST
    o, moves = inputs.observations, inputs.increments
    steps = Steps(moves.mean, moves.covariance, inputs.start, o.z, o.R, decided, known)
    rules = rules_of(options, threshold, base - 3, first)
    d, status, stopped = run(sensor.kind, sensor.extrinsic, mean, P, base, steps, rules, errors, track)
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
    return filter_run(track, of, frame, decided, found, failure)


def empty_track(frames: int, base: int, observations: int) -> Track:
    """An empty track, with `base` entries of pose and errors."""
    return Track(
        np.full((frames, base), np.nan),
        np.full((frames, base, base), np.nan),
        np.zeros((frames, 3)),
        np.zeros(frames, np.int64),
        np.full((observations, 2), np.nan),
    )


def rules_of(options: FilterOptions, threshold: float, errors: int, first: Array) -> Rules:
    """The rules of a filter with this many systematic errors."""
    how = UpdateRule(float(threshold), *options.rule(errors), first)
    return Rules(options.each, options.augment_variance(0.0), how)


def filter_run(
    track: Track,
    of: Systematic | None,
    frame: SensorFrame,
    decisions: IntArray,
    state: MapState | None,
    failure: tuple[int, str] | None,
) -> FilterRun:
    """The results of the compiled loop, in the world."""
    nis, log_likelihood, dof = track.stats.T
    errors = systematic.of_frames(of, track.pose, track.covariance)
    pose, covariance = systematic.poses(track.pose, track.covariance, frame)
    dof = dof.astype(np.int64)
    return FilterRun(
        pose, covariance, nis, dof, log_likelihood, track.size, track.white, decisions, state, failure, errors
    )


class Steps(NamedTuple):
    """The frames of a log with known decisions for the compiled loop."""

    motion: Array  # (N, 3)
    M: Array  # (N, 3, 3) covariance of the motion
    start: IntArray  # (N + 1,) first row of each frame in z, R and decision
    z: Array  # (M, 2)
    R: Array  # (M, 2, 2)
    decision: IntArray  # (M,) landmark number, `NEW` or `DISCARD`; in localization row of `known` or `DISCARD`
    known: Array  # (L, 2) known landmarks; empty in SLAM


class Rules(NamedTuple):
    """Rules of the compiled loop."""

    each: bool  # one update per observation
    variance: float  # of a new landmark, negative: exact
    how: UpdateRule


class Track(NamedTuple):
    """Outputs of the compiled loop, stats (N, 3) as of `Outcome`; white (M, 2) by observation, the others by frame."""

    pose: Array
    covariance: Array
    stats: Array
    size: IntArray
    white: Array


@numba.njit(cache=True)
def run(
    kind: int, extrinsic: Array, mean: Array, P: Array, d: int, steps: Steps, rules: Rules, errors: Errors, track: Track
) -> tuple[int, int, int]:
    """Fill `track` by the steps of a filter, from a state of d entries, in compiled code. Rejected pairings become
    `DISCARD` in `steps.decision`. Returns (d, status, frame of the failure).
    """
    motion, M, start, z, R, decision, known = steps
    first = rules.how.first
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
            rows = np.empty(paired, np.int64)
            seen = Pairings(
                np.empty(paired, np.int64), np.empty((paired, 2)), np.empty((paired, 2)), np.empty((paired, 2, 2))
            )
            done = Outcome(np.empty(paired, np.bool_), track.stats[f], np.empty((paired, 2)))
            k = 0
            for i in range(begin, end):
                if decision[i] >= 0:
                    rows[k], seen.z[k], seen.R[k] = i, z[i], R[i]
                    seen.at[k] = -1
                    if slam:
                        seen.at[k] = base + 2 * decision[i]
                    else:
                        seen.known[k] = known[decision[i]]
                    k += 1
            used = d
            if held:  # known landmarks are temporary states of the update
                hold_known(mean, P, d, seen.known, first, errors)
                seen.at[:], used = d + 2 * np.arange(paired), d + 2 * paired
            if rules.each:
                status = update_each(kind, extrinsic, mean, P, used, seen, rules.how, done)
            else:
                status = update(kind, extrinsic, mean, P, used, seen, rules.how, done)
            for k in range(paired):
                track.white[rows[k]] = done.white[k]
                if not done.keep[k]:
                    decision[rows[k]] = DISCARD
        if slam and status == OK:
            for i in range(begin, end):
                if decision[i] == NEW:
                    augment(kind, extrinsic, mean, P, d, z[i], R[i], rules.variance, first)
                    d += 2
        if status == OK:
            status = healthy(mean, P)
        track.pose[f] = mean[:base]
        track.covariance[f] = P[:base, :base]
        track.size[f] = d
        if status != OK:
            return d, status, f
    return d, OK, n

"""A filter over a whole log in one compiled loop, for known decisions; the same bytes as step by step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.blocks import diagonal_blocks
from data.compiled import njit
from data.inputs import Inputs, IntArray, Systematic, not_estimable
from data.motion.systematic import SensorFrame
from data.result import DISCARD, NEW, MapState, Systematics, map_with
from data.se2 import Array, BoolArray
from ekf import kernels, systematic
from ekf.filter import DEFAULT, FilterOptions, frame_of
from ekf.kernels import NEWEST, OK, Pairings, augment, healthy, predict
from ekf.systematic import Errors, hold_known, predict_with_errors
from ekf.updates import Outcome, UpdateRule, update


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
    map: MapState | None  # of SLAM, or an uncertain one as estimated
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
    if inputs.map is not None:
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
    joining = None if slam else joining_of(inputs, decided)
    if joining is not None:
        room += len(joining.row)
    capacity = base + 2 * room
    mean, P = np.zeros(capacity), np.zeros((capacity, capacity))
    mean[:base], P[:base, :base] = systematic.begin(inputs.prior, of, frame)
    track = empty_track(n, base, len(inputs.observations.z))
    state, variance = track.pose, track.covariance
    first = mean.copy() if options.first_estimates else NEWEST
    steps = steps_of(inputs, slice(0, n), decided, base, joining)
    rules = rules_of(options, threshold, base - 3, first)
    d, status, stopped = run(sensor.kind, sensor.extrinsic, mean, P, base, steps, rules, errors, track)
    steps.put(decided, track.white)
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
    elif joining is not None and inputs.map is not None:
        number = inputs.map.id[joining.row[: (d - base) // 2]]
        at, blocks = mean[base:d].reshape(-1, 2), diagonal_blocks(P[base:d, base:d])
        found = map_with(inputs.map, MapState(number, at, blocks))
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
    how = UpdateRule(float(threshold), *options.rule(errors), options.each, first)
    return Rules(options.augment_variance(0.0), how)


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
    """N frames of a log with known decisions for the compiled loop: K pairings, J new landmarks."""

    motion: Array  # (N, 3)
    M: Array  # (N, 3, 3) covariance of the motion
    seen: Pairings
    rows: IntArray  # (K,) of the pairings among all observations
    paired: IntArray  # (N + 1,) first pairing of each frame
    keep: BoolArray  # (K,), white (K, 2): outcomes of the pairings
    white: Array
    z: Array  # (J, 2) of the new landmarks
    R: Array  # (J, 2, 2)
    new: IntArray  # (N + 1,) first new landmark of each frame

    join: IntArray  # (N + 1,) first landmark of an uncertain map that joins the state with each frame
    xy: Array  # (I, 2) their places in the map
    sigma: Array  # (I, 2)

    def put(self, decisions: IntArray, white: Array) -> None:
        """Enter the outcomes: into decisions (M,) that a pairing was rejected, the innovations into white (M, 2)."""
        decisions[self.rows[~self.keep]] = DISCARD
        white[self.rows] = self.white


class Joining(NamedTuple):
    """Landmarks of an uncertain map that are states (`ekf.localizer`), in the order of their first pairing."""

    row: IntArray  # (I,) of the map
    frame: IntArray  # (I,) of the first pairing, ascending
    place: IntArray  # (L,) of each landmark of the map among them; -1: none


def joining_of(inputs: Inputs, decided: IntArray) -> Joining | None:
    """Landmarks that join the state by rows of the map `decided` (M,); None in an exact map.

    Raises ValueError for an uncertain map beside a range error, or of walls.
    """
    known = inputs.map
    if known is None or known.sigma is None:
        return None
    if why := not_estimable(inputs.systematic, known, inputs.sensor):
        raise ValueError(why)
    rows = np.flatnonzero(decided >= 0)
    rows = rows[known.sigma[decided[rows]].any(axis=1)]
    row, first = np.unique(decided[rows], return_index=True)
    order = np.argsort(first)
    place = np.full(len(known.id), -1)
    place[row[order]] = np.arange(len(row))
    return Joining(row[order], inputs.observations.frame[rows[first[order]]], place)


def steps_of(inputs: Inputs, frames: slice, decided: IntArray, base: int, joining: Joining | None = None) -> Steps:
    """Steps of the frames by `decided` (M,): the place of a landmark in the state behind `base`, or the row of the map.

    All arrays are copies: read-only ones would compile the loop once more.
    """
    o, moves, starts = inputs.observations, inputs.increments, inputs.start[frames.start : frames.stop + 1]
    own = decided[starts[0] : starts[-1]]
    rows, fresh = starts[0] + np.flatnonzero(own >= 0), starts[0] + np.flatnonzero(own == NEW)
    at, known = base + 2 * decided[rows], np.zeros((len(rows), 2))
    if inputs.map is not None:
        at, known = np.full(len(rows), -1), inputs.map.xy[decided[rows]]
    join, xy, sigma = np.zeros(len(starts), np.int64), np.zeros((0, 2)), np.zeros((0, 2))
    if joining is not None and inputs.map is not None and inputs.map.sigma is not None:
        place = joining.place[decided[rows]]
        at = np.where(place >= 0, base + 2 * place, -1)
        join = np.searchsorted(joining.frame, np.arange(frames.start, frames.stop + 1)).astype(np.int64)
        xy, sigma = inputs.map.xy[joining.row], inputs.map.sigma[joining.row]
    return Steps(
        np.array(moves.mean[frames]), np.array(moves.covariance[frames]),
        Pairings(at, known, o.z[rows], o.R[rows]), rows, np.searchsorted(rows, starts),
        np.ones(len(rows), np.bool_), np.full((len(rows), 2), np.nan),
        o.z[fresh], o.R[fresh], np.searchsorted(fresh, starts), join, xy, sigma,
    )  # fmt: skip


class Rules(NamedTuple):
    """Rules of the compiled loop."""

    variance: float  # of a new landmark, negative: exact
    how: UpdateRule


class Track(NamedTuple):
    """Outputs of a run, stats (N, 3) as of `Outcome`; white (M, 2) by observation, the others by frame."""

    pose: Array
    covariance: Array
    stats: Array
    size: IntArray
    white: Array


@njit
def run(
    kind: int, extrinsic: Array, mean: Array, P: Array, d: int, steps: Steps, rules: Rules, errors: Errors, track: Track
) -> tuple[int, int, int]:
    """Fill `track` and the outcomes of `steps`, from a state of d entries, in compiled code.

    Returns (d, status, frame of the failure).
    """
    first, seen = rules.how.first, steps.seen
    n, base = len(steps.motion), 3 + len(errors.place)
    for f in range(n):
        if f > 0:
            if base > 3:
                predict_with_errors(mean, P, d, steps.motion[f], steps.M[f], first, errors)
            else:
                predict(mean, P, d, steps.motion[f], steps.M[f], first)
        begin, end = steps.paired[f], steps.paired[f + 1]
        status = OK
        for i in range(steps.join[f], steps.join[f + 1]):
            for q in range(2):
                mean[d + q], P[d + q, d + q] = steps.xy[i, q], steps.sigma[i, q] ** 2
                if len(first):
                    first[d + q] = steps.xy[i, q]
            d += 2
        if end > begin:
            used = d
            if errors.range_at >= 0 and seen.at[begin] < 0:  # known landmarks are temporary states of the update
                hold_known(mean, P, d, seen.known, begin, end, first, errors)
                for i in range(begin, end):
                    seen.at[i] = used
                    used += 2
            done = Outcome(steps.keep, track.stats[f], steps.white)
            status = update(kind, extrinsic, mean, mean, P, used, seen, begin, end, rules.how, done)
        if status == OK:
            for i in range(steps.new[f], steps.new[f + 1]):
                augment(kind, extrinsic, mean, P, d, steps.z[i], steps.R[i], rules.variance, first)
                d += 2
            status = healthy(mean, P)
        for i in range(base):
            track.pose[f, i] = mean[i]
            for j in range(base):
                track.covariance[f, i, j] = P[i, j]
        track.size[f] = d
        if status != OK:
            return d, status, f
    return d, OK, n

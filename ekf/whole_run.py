"""A filter over a whole log in one compiled loop, for known decisions; the same bytes as step by step.

EKF-SLAM with most of a large map parked at any time (compressed filter) has the equations of `ekf.parking`. The log is
cut into epochs. In each epoch the state holds the robot (pose and systematic errors) and the landmarks observed in it;
all others are parked. No landmark is restored within an epoch, so y is as long as the active part, and at its end

    x_B += C y,    P_BB += C P_yy C',    P_BA = C P_yA          (C = P_BA at the beginning)
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.blocks import coordinates, diagonal_blocks
from data.compiled import njit
from data.inputs import Inputs, IntArray, not_estimable
from data.result import DISCARD, NEW, MapState, Systematics, map_with
from data.se2 import Array, BoolArray
from ekf import kernels, systematic
from ekf.filter import DEFAULT, FilterOptions, frame_of
from ekf.kernels import NEWEST, OK, Pairings, augment, healthy, predict
from ekf.parking import Triangle, root, symmetric, whitened
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
    inputs: Inputs, decisions: IntArray, *, threshold: float = np.inf, options: FilterOptions = DEFAULT,
    epochs: "list[Epoch] | None" = None,
) -> FilterRun:  # fmt: skip
    """EKF localization (inputs with a map) or EKF-SLAM (without) with given decisions (M,). SLAM: decisions are
    landmark numbers in order of creation, `NEW` or `DISCARD`; localization: map ids or `DISCARD`.

    `epochs` of SLAM change nothing but rounding; None: one, without parked landmarks.
    """
    if options.new_variance_per_square is not None:
        raise ValueError("a new landmark's variance depends on its distance only in the step-by-step filter")
    n, known, of, o = len(inputs), inputs.map, inputs.systematic, inputs.observations
    decided = np.array(decisions, np.int64)
    if known is not None:
        decided = np.where(decided >= 0, known.rows(decided), DISCARD)
        if (decided[decisions >= 0] < 0).any():
            raise ValueError("decisions name a landmark the map does not have")
    number, total = landmark_numbers(decided), int((decided == NEW).sum())
    frame = frame_of(of, inputs.sensor, inputs.prior, options, slam=known is None)
    errors, sensor = systematic.as_states(of, frame), frame.sensor(inputs.sensor)
    base, joining = 3 + len(errors.place), joining_of(inputs, decided)
    room = 0 if joining is None else len(joining.row)
    if known is not None and errors.range_at >= 0:
        room = int(np.bincount(o.frame[decided >= 0]).max(initial=0))
    track = Track(
        np.full((n, base), np.nan), np.full((n, base, base), np.nan), np.zeros((n, 3)), np.zeros(n, np.int64),
        np.full((len(o.z), 2), np.nan),
    )  # fmt: skip
    whole = FullMap(np.zeros(2 * total), Triangle(), np.zeros((2 * total, base)), np.zeros(2 * total))
    mean, P = systematic.begin(inputs.prior, of, frame)
    robot = np.array(mean, float), np.array(P, float), np.array(mean, float)
    created, failure, found = 0, None, None
    slot_of = np.zeros(total, np.int64)
    for epoch in epochs or [Epoch(0, n, np.empty(0, np.int64), all_active=True)]:
        rows, frames = slice(inputs.start[epoch.begin], inputs.start[epoch.end]), slice(epoch.begin, epoch.end)
        new = int((decided[rows] == NEW).sum())
        state = begin_epoch(whole, robot, epoch, created, room if known is not None else new, options.first_estimates)
        if known is None:
            slot_of[epoch.active] = np.arange(len(epoch.active))
            slot_of[created : created + new] = (state.d - base) // 2 + np.arange(new)
            paired = rows.start + np.flatnonzero(decided[rows] >= 0)
            decided[paired] = slot_of[number[paired]]
        steps = steps_of(inputs, frames, decided, base, joining)
        if epoch.begin:
            step = state.mean, state.P, state.d, steps.motion[0], steps.M[0], state.first
            if of is None:
                predict(*step)
            else:
                predict_with_errors(*step, errors)
        how = UpdateRule(float(threshold), *options.rule(base - 3), state.first)
        part = Track(track.pose[frames], track.covariance[frames], track.stats[frames], track.size[frames], track.white)
        d, status, stopped = run(
            sensor.kind, sensor.extrinsic, state.mean, state.P, state.d, steps, options.augment_variance(0.0), how,
            errors, part,
        )  # fmt: skip
        decided[steps.rows[~steps.keep]] = DISCARD
        track.white[steps.rows] = steps.white
        reached = epoch.end if status == kernels.OK else epoch.begin + int(stopped) + 1
        track.size[epoch.begin : reached] += base + 2 * created - state.d
        if known is None:
            new = (d - state.d) // 2
            with np.errstate(all="ignore"):  # the state of a failed filter is undefined
                robot = end_epoch(whole, state, epoch, created, new)
            created += new
        elif joining is not None:
            at, blocks = state.mean[base:d].reshape(-1, 2), diagonal_blocks(state.P[base:d, base:d])
            found = map_with(known, MapState(known.id[joining.row[: len(at)]], at, blocks))
        if status != kernels.OK:
            failure = (reached - 1, kernels.FAILURES[status])
            track.pose[reached - 1 :], track.covariance[reached - 1 :] = np.nan, np.nan
            break
    if known is None:
        blocks = whole.P.blocks()[:created]
        found = MapState(np.arange(created), whole.mean[: 2 * created].reshape(-1, 2).copy(), blocks)
        cross = whole.robot[: 2 * created, 3:].reshape(created, 2, base - 3)
        found = systematic.landmarks(found, cross, robot[0][3:], robot[1][3:, 3:], frame)
    nis, log_likelihood, dof = track.stats.T
    of_errors = systematic.of_frames(of, track.pose, track.covariance)
    pose, covariance = systematic.poses(track.pose, track.covariance, frame)
    used = np.where(decided >= 0, decisions, decided)
    return FilterRun(
        pose, covariance, nis, dof.astype(np.int64), log_likelihood, track.size, track.white, used, found, failure,
        of_errors,
    )  # fmt: skip


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


class Joining(NamedTuple):
    """Landmarks of an uncertain map that are states (`ekf.localizer`), in the order of their first pairing."""

    row: IntArray  # (I,) of the map
    frame: IntArray  # (I,) of the first pairing, ascending
    place: IntArray  # (L,) of each landmark of the map among them; -1: none


def joining_of(inputs: Inputs, decided: IntArray) -> Joining | None:
    """Landmarks that join by rows of the map `decided` (M,); None: exact map. ValueError: range error, walls."""
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


class Track(NamedTuple):
    """Outputs of a run, stats (N, 3) as of `Outcome`; white (M, 2) by observation, the others by frame."""

    pose: Array
    covariance: Array
    stats: Array
    size: IntArray
    white: Array


@njit
def run(
    kind: int, extrinsic: Array, mean: Array, P: Array, d: int, steps: Steps, variance: float, how: UpdateRule,
    errors: Errors, track: Track,
) -> tuple[int, int, int]:  # fmt: skip
    """Fill `track` and outcomes of `steps` from d entries. Returns (d, status, frame of the failure)."""
    first, seen = how.first, steps.seen
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
            status = update(kind, extrinsic, mean, mean, P, used, seen, begin, end, how, done)
        if status == OK:
            for i in range(steps.new[f], steps.new[f + 1]):
                augment(kind, extrinsic, mean, P, d, steps.z[i], steps.R[i], variance, first)
                d += 2
            status = healthy(mean, P)
        track.pose[f], track.covariance[f] = mean[:base], P[:base, :base]
        track.size[f] = d
        if status != OK:
            return d, status, f
    return d, OK, n


LEAST = 300  # landmarks. A smaller map is never parked: at most some tenths of a second would be gained
STEP, PAIRING = 1.0e-9, 2.0e-10  # s. Cost of a frame per squared length of the state, and additional cost per pairing
PRODUCT, MOVED = 8.0e-11, 2.0e-8
"""s. Cost of an epoch's end per squared length of the map and column of C, and additional cost per entry, on one core.
Half or twice as much changes the time of a run by less than a tenth."""
WORTH = 0.7  # parking must be expected to take less than this share of the time


class Epoch(NamedTuple):
    """Frames `begin` to `end` - 1, landmarks (a,) in the state at the beginning, and whether none is parked."""

    begin: int
    end: int
    active: IntArray
    all_active: bool


class Plan(NamedTuple):
    """Epochs, and the expected computing time [s] with them and without parking."""

    epochs: list[Epoch]
    seconds: float
    plain: float


def landmark_numbers(decisions: IntArray) -> IntArray:
    """Landmark number (M,) that each observation is paired with or initializes, negative for none."""
    new = decisions == NEW
    return np.where(new, np.cumsum(new) - 1, decisions)


def plan(decisions: IntArray, start: IntArray) -> Plan:
    """Epochs for decisions (M,) of frames whose observations begin at `start` (N + 1,), as many frames each.

    Their length is the power of two of least cost: longer epochs have a longer state, shorter ones update the whole map
    more often. Lengths chosen one by one differ in cost by less than a tenth.
    """
    number, frames = landmark_numbers(decisions), len(start) - 1
    created = np.concatenate([[0], np.cumsum(decisions == NEW)])[start]
    step = STEP + PAIRING * np.diff(np.concatenate([[0], np.cumsum(decisions >= 0)])[start])
    best = Plan([], math.inf, float((step * (3.0 + 2.0 * created[1:]) ** 2).sum()))
    for length in (1 << k for k in range(frames.bit_length() + 1)):
        epochs, seconds = list[Epoch](), 0.0
        for begin in range(0, frames, length):
            end = min(begin + length, frames)
            mapped, new = int(created[begin]), int(created[end] - created[begin])
            seen = np.unique(number[start[begin] : start[end]])
            seen = seen[(seen >= 0) & (seen < mapped)]
            n = len(seen)
            whole = 2 * (mapped - n) <= 4 + 2 * n
            rows, columns = 2 * (mapped + new), 3 + 2 * n
            size = 3 + 2 * (mapped + new) if whole else 7 + 4 * n + 2 * new
            seconds += float(step[begin:end].sum()) * size**2 + 2 * MOVED * rows * (n + new)
            seconds += 0.0 if whole else PRODUCT * rows**2 * columns
            epochs.append(Epoch(begin, end, np.arange(mapped) if whole else seen, whole))
        if seconds < best.seconds:
            best = best._replace(epochs=epochs, seconds=seconds)
    return best


def worthwhile(inputs: Inputs, decisions: IntArray, options: FilterOptions = DEFAULT) -> list[Epoch] | None:
    """Epochs in which the filter is faster than without, or None. None also for filters that parking would change: the
    invariant one moves all landmarks, and an iterated one ends by the largest motion of all of them.
    """
    if inputs.map is not None or options.invariant or options.iterations > 1 or (decisions == NEW).sum() < LEAST:
        return None
    found = plan(decisions, inputs.start)
    return found.epochs if found.seconds < WORTH * found.plain else None


@dataclass
class FullMap:
    """The map between two epochs: mean (2n,), P, cross-covariance with the robot (2n, 3 + p), first estimates (2n,)."""

    mean: Array
    P: Triangle
    robot: Array
    first: Array


class State(NamedTuple):
    """Buffers of an epoch: robot, active landmarks, y, padding to an even length, then room for new landmarks."""

    mean: Array
    P: Array
    first: Array
    d: int  # length without new landmarks
    y: int  # length of y
    C: Array  # (2b, y), D of `ekf.parking`, undefined in rows of active landmarks


Robot = tuple[Array, Array, Array]  # mean, covariance, first estimate (3 + p) of pose and errors


def begin_epoch(whole: FullMap, robot: Robot, epoch: Epoch, created: int, new: int, first_estimates: bool) -> State:
    """The state at the beginning of an epoch that will initialize `new` landmarks."""
    at = coordinates(epoch.active)
    base = len(robot[0])
    a = base + len(at)
    y = 0 if epoch.all_active else a
    d = a + y + y % 2
    mean, P = np.zeros(d + 2 * new), np.zeros((d + 2 * new, d + 2 * new))
    C = np.concatenate([whole.robot[: 2 * created], whole.P.columns(at)], axis=1)
    mean[:base], mean[base:a] = robot[0], whole.mean[at]
    P[:base, :base], P[base:a, :a] = robot[1], C[at]
    P[:a, base:a] = P[base:a, :a].T
    P[base:a, base:a] = symmetric(C[at, base:])
    D = C[:, :0]
    if y:
        L = root(P[:a, :a])
        P[:a, a : a + y], P[a : a + y, :a] = L, L.T
        D = whitened(C, L)
    first = NEWEST
    if first_estimates:
        first = mean.copy()
        first[:base], first[base:a] = robot[2], whole.first[at]
    return State(mean, P, first, d, y, D)


def end_epoch(whole: FullMap, state: State, epoch: Epoch, created: int, new: int) -> Robot:
    """Update the map after an epoch that initialized `new` landmarks; returns the robot."""
    at = coordinates(epoch.active)
    base = whole.robot.shape[1]
    a, end = base + len(at), state.d + 2 * new
    after = 2 * (created + new)
    whole.P.grow(after)
    y = slice(a, a + state.y)
    held = np.concatenate([np.arange(a), np.arange(state.d, end)])
    rows = np.concatenate([at, np.arange(2 * created, after)])
    cross = np.zeros((after, len(held)))
    if state.y:
        C = np.zeros((after, state.y))
        C[: 2 * created] = state.C
        whole.mean[:after] += C @ state.mean[y]
        whole.P.add_product(C @ state.P[y, y], C)
        cross = C @ state.P[y, held]
    cross[rows] = state.P[np.ix_(held[base:], held)]
    whole.mean[rows] = state.mean[held[base:]]
    whole.P.put(rows, cross[:, base:])
    whole.robot[:after] = cross[:, :base]
    first = state.mean[:base].copy()
    if len(state.first):
        whole.first[rows] = state.first[held[base:]]
        first = state.first[:base].copy()
    return state.mean[:base].copy(), state.P[:base, :base].copy(), first

"""EKF-SLAM over a whole log with known decisions, with most of a large map parked at any time (compressed filter).

As `ekf.whole_run`, with the equations of `ekf.parking`. The log is cut into epochs. In each epoch the state holds the
robot (pose and systematic errors) and the landmarks observed in it; all others are parked. No landmark is restored
within an epoch, so y is as long as the active part, and at the end of the epoch

    x_B += C y,    P_BB += C P_yy C',    P_BA = C P_yA          (C = P_BA at the beginning)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.blocks import coordinates
from data.inputs import Inputs, IntArray
from data.result import NEW, MapState
from data.se2 import Array
from ekf import kernels, systematic
from ekf.filter import DEFAULT, FilterOptions, frame_of
from ekf.kernels import NEWEST
from ekf.parking import Triangle, root, symmetric, whitened
from ekf.whole_run import FilterRun, Track, empty_track, filter_run, rules_of, run, steps_of

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
    """Epochs for decisions (M,) of frames whose observations begin at `start` (N + 1,).

    Each epoch has the length of least mean cost per frame: a longer one has a longer state, a shorter one updates the
    whole map more often. Greedy, from one epoch to the next.
    """
    number = landmark_numbers(decisions)
    created = np.concatenate([[0], np.cumsum(decisions == NEW)])[start]
    paired = np.diff(np.concatenate([[0], np.cumsum(decisions >= 0)])[start])
    step = STEP + PAIRING * paired
    plain = float((step * (3.0 + 2.0 * created[1:]) ** 2).sum())
    epochs, seconds, begin, frames = list[Epoch](), 0.0, 0, len(start) - 1
    while begin < frames:
        mapped = int(created[begin])
        seen, steps, best, chosen = set[int](), 0.0, np.inf, begin + 1
        active, all_active = seen, True
        for end in range(begin + 1, frames + 1):
            seen.update(n for n in number[start[end - 1] : start[end]].tolist() if 0 <= n < mapped)
            steps += step[end - 1]
            new, n = int(created[end]) - mapped, len(seen)
            whole = 2 * (mapped - n) <= 4 + 2 * n
            rows, columns = 2 * (mapped + new), 3 + 2 * n
            length = 3 + 2 * (mapped + new) if whole else 7 + 4 * n + 2 * new
            cost = steps * length**2 + (0.0 if whole else PRODUCT * rows**2 * columns) + 2 * MOVED * rows * (n + new)
            if cost < best * (end - begin):
                best, chosen, active, all_active = cost / (end - begin), end, set(seen), whole
            elif cost > 2.0 * best * (end - begin):
                break
        kept = np.arange(mapped) if all_active else np.array(sorted(active), np.int64)
        epochs.append(Epoch(begin, chosen, kept, all_active))
        seconds += best * (chosen - begin)
        begin = chosen
    return Plan(epochs, seconds, plain)


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


def run_in_epochs(
    inputs: Inputs,
    decisions: IntArray,
    epochs: list[Epoch],
    *,
    threshold: float = np.inf,
    options: FilterOptions = DEFAULT,
) -> FilterRun:
    """The result of `ekf.whole_run.run_filter` for EKF-SLAM, up to rounding; arguments as there."""
    n, o = len(inputs), inputs.observations
    number, total = landmark_numbers(decisions), int((decisions == NEW).sum())
    decided = np.array(decisions, np.int64)
    of = inputs.systematic
    frame = frame_of(of, inputs.sensor, inputs.prior, options, slam=True)
    errors, sensor = systematic.as_states(of, frame), frame.sensor(inputs.sensor)
    base = 3 + len(errors.place)
    track = empty_track(n, base, len(o.z))
    whole = FullMap(np.zeros(2 * total), Triangle(), np.zeros((2 * total, base)), np.zeros(2 * total))
    mean, P = systematic.begin(inputs.prior, of, frame)
    robot = np.array(mean, float), np.array(P, float), np.array(mean, float)
    created, failure = 0, None
    slot_of = np.zeros(total, np.int64)
    for epoch in epochs:
        rows = slice(inputs.start[epoch.begin], inputs.start[epoch.end])
        new = int((decisions[rows] == NEW).sum())
        state = begin_epoch(whole, robot, epoch, created, new, options.first_estimates)
        slot_of[epoch.active] = np.arange(len(epoch.active))
        slot_of[created : created + new] = (state.d - base) // 2 + np.arange(new)
        decided[rows] = np.where(decisions[rows] >= 0, slot_of[np.maximum(number[rows], 0)], decisions[rows])
        frames = slice(epoch.begin, epoch.end)
        steps = steps_of(inputs, frames, decided, base)
        if epoch.begin:
            step = state.mean, state.P, state.d, steps.motion[0], steps.M[0], state.first
            if of is None:
                kernels.predict(*step)
            else:
                systematic.predict_with_errors(*step, errors)
        rules = rules_of(options, threshold, base - 3, state.first)
        part = Track(track.pose[frames], track.covariance[frames], track.stats[frames], track.size[frames], track.white)
        d, status, stopped = run(
            sensor.kind, sensor.extrinsic, state.mean, state.P, state.d, steps, rules, errors, part
        )
        steps.put(decided, track.white)
        reached = epoch.end if status == kernels.OK else epoch.begin + int(stopped) + 1
        track.size[epoch.begin : reached] += base + 2 * created - state.d
        new = (d - state.d) // 2
        with np.errstate(all="ignore"):  # the state of a failed filter is undefined
            robot = end_epoch(whole, state, epoch, created, new)
        created += new
        if status != kernels.OK:
            failure = (reached - 1, kernels.FAILURES[status])
            track.pose[reached - 1 :], track.covariance[reached - 1 :] = np.nan, np.nan
            break
    decided = np.where(decided >= 0, decisions, decided)
    blocks = whole.P.blocks()[:created]
    found = MapState(np.arange(created), whole.mean[: 2 * created].reshape(-1, 2).copy(), blocks)
    cross = whole.robot[: 2 * created, 3:].reshape(created, 2, base - 3)
    found = systematic.landmarks(found, cross, robot[0][3:], robot[1][3:, 3:], frame)
    return filter_run(track, of, frame, decided, found, failure)


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

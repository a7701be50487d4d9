"""EKF-SLAM over a whole log with decisions that were made beforehand, most of a large map parked at any time.

As `ekf.whole_run`, with the compressed filter of `ekf.parking`: the log is cut into epochs; in each one the state holds
the pose and the landmarks that the epoch will see, all others are parked. No landmark comes back within an epoch, so
the carried y is as long as the active part at its beginning, and

    x_B += C y,    P_BB += C P_yy C',    P_BA = C P_yA          (C = P_BA at the beginning)

at its end. How long an epoch is to be is known beforehand as well: see `plan`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.blocks import coordinates
from data.inputs import Inputs, IntArray
from data.result import NEW, MapState
from data.se2 import Array
from ekf import kernels
from ekf.filter import DEFAULT, FilterOptions
from ekf.kernels import NEWEST
from ekf.parking import root, symmetric, whitened
from ekf.triangle import Triangle
from ekf.whole_run import FilterRun, run

LEAST = 300
"""Landmarks. A smaller map is never parked: some tenths of a second are gained at most, and it keeps its bytes."""
STEP, READING = 1.0e-9, 2.0e-10
"""s. A frame costs so much per squared length of the state, and so much more with each of its pairings."""
PRODUCT, MOVED = 8.0e-11, 2.0e-8
"""s. The end of an epoch costs so much per squared length of the map and column of C, and so much more per entry.
Measured on one core. With 600 and 2400 landmarks half and twice as much of these two change the time of a run by less
than a tenth; a sixth of it costs a fifth more."""
WORTH = 0.7
"""Parking must be expected to take less than this part of the time."""


class Epoch(NamedTuple):
    """Frames from `begin` before `end`, and the landmarks (a,) in the state from its beginning, ascending.

    all_active: no landmark is parked.
    """

    begin: int
    end: int
    active: IntArray
    all_active: bool


class Plan(NamedTuple):
    """Epochs, and how long they and the filter that never parks are expected to take [s]."""

    epochs: list[Epoch]
    seconds: float
    plain: float


def numbers_of(decisions: IntArray) -> tuple[IntArray, int]:
    """Landmark number (M,) that each observation is paired with or initializes, negative for none, and how many."""
    new = decisions == NEW
    return np.where(new, np.cumsum(new) - 1, decisions), int(new.sum())


def plan(decisions: IntArray, start: IntArray) -> Plan:
    """Epochs for decisions (M,) of frames whose observations begin at `start` (N + 1,).

    Each one is as long as makes its frames cheapest on the average: a longer one has more landmarks in its state, a
    shorter one brings the whole map up to date more often. Greedy, from one epoch to the next.
    """
    number, _ = numbers_of(decisions)
    created = np.concatenate([[0], np.cumsum(decisions == NEW)])[start]
    paired = np.diff(np.concatenate([[0], np.cumsum(decisions >= 0)])[start])
    step = STEP + READING * paired
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
    """Epochs in which the filter is faster than without, or None.

    None, too, for filters that parking would change: the invariant one moves all landmarks, and an iterated one ends by
    how far all of them moved.
    """
    if inputs.map is not None or options.invariant or options.iterations > 1 or (decisions == NEW).sum() < LEAST:
        return None
    found = plan(decisions, inputs.start)
    return found.epochs if found.seconds < WORTH * found.plain else None


@dataclass
class Whole:
    """The map between two epochs: mean (2n,), P, cross-covariance with the pose (2n, 3), first estimates (2n,)."""

    mean: Array
    P: Triangle
    pose: Array
    first: Array


def run_in_epochs(
    inputs: Inputs,
    decisions: IntArray,
    epochs: list[Epoch],
    *,
    threshold: float = np.inf,
    options: FilterOptions = DEFAULT,
) -> FilterRun:
    """What `ekf.whole_run.run_filter` gives for EKF-SLAM, up to rounding; arguments as there."""
    n, o = len(inputs), inputs.observations
    number, total = numbers_of(decisions)
    decided, white = np.array(decisions, np.int64), np.full((len(o.z), 2), np.nan)
    pose, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    stats, size = np.zeros((n, 3)), np.zeros(n, np.int64)
    out = pose, covariance, stats, size, white
    whole = Whole(np.zeros(2 * total), Triangle(), np.zeros((2 * total, 3)), np.zeros(2 * total))
    robot = np.array(inputs.prior.mean, float), np.array(inputs.prior.covariance, float), robot_first(inputs)
    created, failure = 0, None
    how = options.each, options.augment_variance(0.0), options.rule
    slot_of = np.zeros(total, np.int64)
    for epoch in epochs:
        rows = slice(inputs.start[epoch.begin], inputs.start[epoch.end])
        new = int((decisions[rows] == NEW).sum())
        state = begun(whole, robot, epoch, created, new, options.first_estimates)
        slot_of[epoch.active] = np.arange(len(epoch.active))
        slot_of[created : created + new] = (state.d - 3) // 2 + np.arange(new)
        decided[rows] = np.where(decisions[rows] >= 0, slot_of[np.maximum(number[rows], 0)], decisions[rows])
        frames = slice(epoch.begin, epoch.end)
        motion, M = inputs.increments.mean[frames], inputs.increments.covariance[frames]
        if epoch.begin:
            kernels.predict(state.mean, state.P, state.d, motion[0], M[0], state.first)
        d, status, stopped = run(
            inputs.sensor.kind, inputs.sensor.extrinsic, state.mean, state.P, state.d, motion, M,
            inputs.start[epoch.begin : epoch.end + 1], o.z, o.R, decided, np.empty((0, 2)), how, float(threshold),
            state.first, (pose[frames], covariance[frames], stats[frames], size[frames], white),
        )  # fmt: skip
        reached = epoch.end if status == kernels.OK else epoch.begin + int(stopped) + 1
        size[epoch.begin : reached] += 3 + 2 * created - state.d
        new = (d - state.d) // 2
        with np.errstate(all="ignore"):  # a filter that failed may hold anything
            robot = ended(whole, state, epoch, created, new)
        created += new
        if status != kernels.OK:
            failure = (reached - 1, kernels.FAILURES[status])
            pose[reached - 1 :], covariance[reached - 1 :] = np.nan, np.nan
            break
    decided = np.where(decided >= 0, decisions, decided)
    blocks = whole.P.blocks()[:created]
    state_map = MapState(np.arange(created), whole.mean[: 2 * created].reshape(-1, 2).copy(), blocks)
    return FilterRun(
        out[0], out[1], stats[:, 0], stats[:, 2].astype(np.int64), stats[:, 1], size, white, decided, state_map, failure
    )


def robot_first(inputs: Inputs) -> Array:
    """The pose's first estimate before the first frame."""
    return np.array(inputs.prior.mean, float)


class State(NamedTuple):
    """Buffers of an epoch: pose, active landmarks, y and (if that is odd) nothing, then room for new landmarks.

    d: length without the new ones; y: length of y; C: (2b, y), D of `ekf.parking`; of active
    landmarks its rows mean nothing.
    """

    mean: Array
    P: Array
    first: Array
    d: int
    y: int
    C: Array


Robot = tuple[Array, Array, Array]
"""Mean (3,), covariance (3, 3) and first estimate (3,) of the pose."""


def begun(whole: Whole, robot: Robot, epoch: Epoch, created: int, new: int, first_estimates: bool) -> State:
    """The state at the beginning of an epoch that will initialize `new` landmarks."""
    at = coordinates(epoch.active)
    a = 3 + len(at)
    y = 0 if epoch.all_active else a
    d = a + y + y % 2
    mean, P = np.zeros(d + 2 * new), np.zeros((d + 2 * new, d + 2 * new))
    C = np.concatenate([whole.pose[: 2 * created], whole.P.columns(at)], axis=1)
    mean[:3], mean[3:a] = robot[0], whole.mean[at]
    P[:3, :3], P[3:a, :a] = robot[1], C[at]
    P[:a, 3:a] = P[3:a, :a].T
    P[3:a, 3:a] = symmetric(C[at, 3:])
    D = C[:, :0]
    if y:
        L = root(P[:a, :a])
        P[:a, a : a + y], P[a : a + y, :a] = L, L.T
        D = whitened(C, L)
    first = NEWEST
    if first_estimates:
        first = mean.copy()
        first[:3], first[3:a] = robot[2], whole.first[at]
    return State(mean, P, first, d, y, D)


def ended(whole: Whole, state: State, epoch: Epoch, created: int, new: int) -> Robot:
    """Bring the map up to date after an epoch that initialized `new` landmarks; the robot."""
    at = coordinates(epoch.active)
    a, end = 3 + len(at), state.d + 2 * new
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
    cross[rows] = state.P[np.ix_(held[3:], held)]
    whole.mean[rows] = state.mean[held[3:]]
    whole.P.put(rows, cross[:, 3:])
    whole.pose[:after] = cross[:, :3]
    robot_first = state.mean[:3].copy()
    if len(state.first):
        whole.first[rows] = state.first[held[3:]]
        robot_first = state.first[:3].copy()
    return state.mean[:3].copy(), state.P[:3, :3].copy(), robot_first

"""Time of association: JCBB on a hard frame, a corridor run, and the cost of a frame as the map grows."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from association.decide import decide
from association.expectation import Expectation, gate_threshold
from association.jcbb import jcbb
from data.inputs import Increments, Inputs, IntArray, LabelledObservations, Prior
from data.result import NEW
from data.se2 import Array
from data.sensors import RangeBearing
from eval.benchmarks.timed import Timed, median_seconds
from eval.replay.frontend import FrontEnd
from eval.replay.run import front_end, step_by_step
from eval.replay.settings import HINDSIGHT, Setup

GATE = 0.99
MAP_SIZES = (66, 300, 1000, 3000)
PER_METRE = 5  # landmarks per metre along the line of `line_world`


def hard_frame(observations: int, landmarks: int, ambiguous: int) -> Expectation:
    """A frame whose landmarks are far apart, `ambiguous` of them with a neighbour inside the gate, all correlated."""
    rng = np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(landmarks)))
    xy = 4.0 * np.stack(np.divmod(np.arange(landmarks), side), axis=1).astype(float)
    xy[observations : observations + ambiguous] = xy[:ambiguous] + np.array([0.12, 0.05])
    pose = np.tile(np.eye(2), (landmarks, 1))  # a pose error shifts all expectations alike
    joint = pose @ (0.03 * np.eye(2)) @ pose.T + 1e-3 * np.eye(2 * landmarks)
    R = np.tile(1e-3 * np.eye(2), (observations, 1, 1))
    shift = rng.multivariate_normal(np.zeros(2), 0.03 * np.eye(2))
    z = xy[:observations] + shift + rng.normal(0.0, 0.04, (observations, 2))
    return Expectation.from_arrays(z, xy, joint, R)


def plain_jcbb(e: Expectation, gate: float) -> IntArray:
    """Textbook JCBB in plain Python: depth first, one inverse of the joint covariance per node."""
    compatible = e.individual_distances() < gate_threshold(gate)
    best: tuple[int, float, list[int]] = (0, 0.0, [-1] * len(compatible))

    def distance(pairs: list[tuple[int, int]]) -> float:
        rows, columns = np.array(pairs).T
        S = e.joint(columns)
        for i, r in enumerate(rows):
            S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += e.R[r]
        nu = (e.z[rows] - e.z_hat[columns]).ravel()
        return float(nu @ np.linalg.inv(S) @ nu)

    def descend(i: int, pairs: list[tuple[int, int]], d2: float) -> None:
        nonlocal best
        left = int(compatible[i:].any(axis=1).sum())
        if len(pairs) + left < best[0]:
            return
        if i == len(compatible):
            if len(pairs) > best[0] or (len(pairs) == best[0] and d2 < best[1]):
                choice = [-1] * len(compatible)
                for r, c in pairs:
                    choice[r] = c
                best = (len(pairs), d2, choice)
            return
        taken = {c for _, c in pairs}
        for c in np.flatnonzero(compatible[i]).tolist():
            if c not in taken:
                more = [*pairs, (i, c)]
                joint = distance(more)
                if joint < gate_threshold(gate, 2 * len(more)):
                    descend(i + 1, more, joint)
        descend(i + 1, pairs, d2)

    descend(0, [], 0.0)
    return np.where(np.array(best[2]) >= 0, e.number[best[2]], NEW)


def line_world(landmarks: int) -> Inputs:
    """A robot along a line, one metre a frame, until it has seen every landmark; labels granted, no map."""
    rng = np.random.default_rng(0)
    frames = landmarks // PER_METRE
    xy = np.column_stack([rng.uniform(0.0, frames, landmarks), rng.uniform(-1.5, 1.5, landmarks)])
    sensor, sigma = RangeBearing(max_range=2.0), np.array([0.02, 0.005])
    frame, label, z = [], [], []
    for k in range(frames):
        exact = sensor.predict(np.array([k + 0.5, 0.0, 0.0]), xy)
        seen = np.flatnonzero(sensor.in_view(exact))
        frame += [k] * len(seen)
        label += seen.tolist()
        z += list(exact[seen] + sigma * rng.standard_normal((len(seen), 2)))
    noise = np.array([0.02, 0.02, 0.005])
    mean = np.array([1.0, 0.0, 0.0]) + noise * rng.standard_normal((frames, 3))
    covariance = np.tile(np.diag(noise**2), (frames, 1, 1))
    mean[0], covariance[0] = 0.0, 0.0
    observations = LabelledObservations(
        np.array(frame, np.int64), np.array(z), np.tile(np.diag(sigma**2), (len(z), 1, 1)), np.array(label, np.int64)
    )
    prior = Prior(np.array([0.5, 0.0, 0.0]), np.diag([1e-4, 1e-4, 1e-6]))
    return Inputs(prior, np.arange(frames, dtype=np.float64), Increments(mean, covariance), observations, sensor)


def frame_seconds(estimator: str, inputs: Inputs, setup: Setup) -> tuple[float, int, int]:
    """Seconds to expect and decide (JCBB) in the last frame, and its numbers of observations and candidates."""
    front = FrontEnd(estimator, "known", inputs, setup)
    last = len(inputs) - 1
    for k in range(last):
        front.move(inputs.frame(k))
        front.update(inputs.frame(k), front.associate(inputs.frame(k)))
        front.tidy()
    front.move(inputs.frame(last))
    observations = inputs.frame_observations(last)
    seconds = median_seconds(lambda: decide("jcbb", front.expect(observations), GATE, 0.99999), 20)
    return seconds, len(observations.z), len(front.expect(observations).number)


def each_frame(estimator: str, association: str, inputs: Inputs) -> Array:
    """Seconds (N,) of every frame of a log."""
    front = front_end(estimator, association, inputs, Setup())
    seconds = np.empty(len(inputs))
    with threadpool_limits(1):
        for k in range(len(inputs)):
            begin = time.perf_counter()
            frame = inputs.frame(k)
            front.move(frame)
            if len(frame.observations.z):
                front.update(frame, front.associate(frame))
            front.tidy()
            front.estimator.estimate()
            seconds[k] = time.perf_counter() - begin
    return seconds


def hindsight_lines(frames: int) -> list[Timed]:
    """Victoria Park without labels, frame by frame: the mean, the slowest in a hundred, the slowest."""
    from data.formats.recordings.victoria_park import load_victoria_park
    from data.log import shortened

    inputs = shortened(load_victoria_park(), frames).inputs().without_map()
    lines = []
    for name in ("ekf", "isam2"):
        each_frame(name, HINDSIGHT, shortened(load_victoria_park(), 300).inputs().without_map())
        seconds = each_frame(name, HINDSIGHT, inputs)
        what = f"Victoria Park without labels, {name}, jcbb-hindsight, a frame"
        for label, value, goal in (
            ("mean", seconds.mean(), "< 10 ms"),
            ("99 %", np.quantile(seconds, 0.99), "< 50 ms"),
            ("longest", seconds.max(), ""),
        ):
            lines.append(Timed(f"{what}: {label}", float(value), 1, "frames", "", goal if name == "isam2" else ""))
    return lines


def association_lines(quick: bool) -> list[Timed]:
    """Lines of the table about association."""
    from data.worlds.corridor import Corridor, simulate

    e = hard_frame(20, 1000, 10)
    fast = median_seconds(lambda: jcbb(replace(e), GATE), 50)  # a copy has no cached distances
    plain = median_seconds(lambda: plain_jcbb(e, GATE), 1)
    if not np.array_equal(jcbb(e, GATE), plain_jcbb(e, GATE)):
        raise AssertionError("the plain JCBB decides otherwise")
    log = simulate(Corridor(), 0)
    inputs = log.inputs().without_map()
    run = median_seconds(lambda: step_by_step("ekf", inputs, "slam", "jcbb"))
    seen = len(log.recorded.observations.frame)
    corridor = f"corridor ({len(inputs)} steps, {seen} observations), EKF and JCBB"
    lines = [
        Timed("JCBB, 20 observations x 1000 landmarks, 10 ambiguous", fast, 1, "frames", "1", "< 5 ms"),
        Timed("peer: JCBB in plain Python", plain, 1, "frames", f"{plain / fast:.0f}"),
        Timed(corridor, run, len(inputs), "frames", "", "< 0.25 s"),
    ]
    for size in MAP_SIZES[:1] if quick else MAP_SIZES:
        world = line_world(size)
        for name, setup in (("ekf", Setup()), ("ekf", Setup(in_view=True)), ("isam2", Setup())):
            seconds, seen, candidates = frame_seconds(name, world, setup)
            cut = ", in view" if setup.in_view else ""
            what = f"association of a frame, {name}{cut}, map of {size} ({seen} seen, {candidates} candidates)"
            lines.append(Timed(what, seconds, 1, "frames"))
    return lines

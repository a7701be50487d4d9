"""Very many frames through one online estimator: `python -m tests.faults.soak CASE FRAMES`, or without for the cases.

A robot goes round and round among a few landmarks, for ever: frames come from a generator and are forgotten, they go
through the front end as those of a drive do (`eval.replay.run.through`). Prints one line of JSON, `Soaked`.
"""

import gc
import json
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from data import se2
from data.inputs import Frame, FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.sensors import RangeBearing
from ekf.filter import Filter
from eval.replay.frontend import FrontEnd
from eval.replay.run import front_end, through
from eval.replay.settings import Beginning, Setup
from graph.fixed_lag import FixedLagSmoother

PERIOD = 0.25  # s between frames
ROUND, RADIUS = 120, 5.0  # Frames and m of a round
MOTION, READING = (0.01, 0.005, 0.005), (0.1, 0.02)
"""Standard deviations of an increment [m, m, rad] and of a reading [m, rad]."""
SENSOR = RangeBearing(max_range=4.0)
LANDMARKS = np.array([(r * math.cos(a), r * math.sin(a)) for r, a in zip([3.5, 6.5] * 8, np.arange(16) * math.pi / 8)])
PRIOR = np.array([1e-2, 1e-2, 1e-3])  # Standard deviations of the first pose [m, m, rad]


class Case(NamedTuple):
    """Of the estimator that is given the map or is not; `constant`: whether its memory is to be."""

    estimator: str
    localizes: bool
    association: str
    setup: Setup = Setup()
    errors: Systematic | None = None
    constant: bool = True


ERRORS = Systematic(("scale", "drift", "bearing"), np.array([0.02, 0.02, 0.01]))
SHORT = Setup(lag=5.0)
FILTERS = ("ekf", "ekf-iterated", "ekf-fej", "ekf-invariant")
CASES = {
    **{f"localization-{name}": Case(name, True, "jcbb") for name in FILTERS},
    **{f"slam-{name}": Case(name, False, "known") for name in FILTERS},
    "slam-ekf-jcbb": Case("ekf", False, "jcbb"),
    "slam-ekf-deactivate": Case("ekf", False, "jcbb", Setup(deactivate_after=10.0)),
    "slam-ekf-calibrate": Case("ekf", False, "known", errors=ERRORS),
    "localization-fixed-lag": Case("fixed-lag", True, "known", SHORT),
    "slam-fixed-lag": Case("fixed-lag", False, "known", SHORT),
    "localization-isam2": Case("isam2", True, "known", constant=False),
    "slam-isam2": Case("isam2", False, "known", constant=False),
}


class Soaked(NamedTuple):
    case: str  # case, frames: what was run
    frames: int
    seconds: float  # CPU time of the frames
    early_mb: float  # early_mb, late_mb: resident memory after a twentieth of the frames, and after all
    late_mb: float
    # early_ms, late_ms: CPU time of a frame, in the fastest hundredth of the second tenth and of the last
    early_ms: float
    late_ms: float
    error_m: float  # mean distance from the truth over the last tenth
    nees: float  # mean of the pose's over the last tenth; 3 is expected
    # asymmetry, lowest: of the covariance at the end, as shares of its trace: largest difference from its transpose,
    # lowest eigenvalue
    asymmetry: float
    lowest: float
    states: int  # states, landmarks: at the end
    landmarks: int


def resident() -> float:
    """MB."""
    gc.collect()
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024.0


def round_trip() -> tuple[np.ndarray, np.ndarray]:
    """True poses (ROUND, 3) of a round, and the true increment (3,) between any two of them."""
    turn = 2.0 * math.pi / ROUND
    chord = 2.0 * RADIUS * math.sin(0.5 * turn)
    step = np.array([chord * math.cos(0.5 * turn), chord * math.sin(0.5 * turn), turn])
    angle = turn * np.arange(ROUND)
    poses = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), se2.wrap_angle(angle + 0.5 * math.pi)], axis=-1)
    return poses, step


def frames_of(count: int, poses: np.ndarray, step: np.ndarray, rng: np.random.Generator) -> Iterator[Frame]:
    """A drive without end, frame by frame, with labels."""
    seen = []
    for pose in poses:
        z = SENSOR.predict(pose, LANDMARKS)
        near = np.flatnonzero(SENSOR.in_view(z))
        seen.append((z[near], near.astype(np.int64), np.tile(np.diag(np.square(READING)), (len(near), 1, 1))))
    Q, motion, reading, first = np.diag(np.square(MOTION)), np.array(MOTION), np.array(READING), 0
    for k in range(count):
        z, label, R = seen[k % ROUND]
        z = z + reading * rng.standard_normal(z.shape)
        increment = Increment(step + motion * rng.standard_normal(3), Q) if k else None
        yield Frame(k, PERIOD * k, increment, FrameObservations(z, R), label, first)
        first += len(z)


def covariance_of(estimator: Any) -> np.ndarray:
    """All of it, where it is at hand."""
    if isinstance(estimator, Filter):
        return estimator._P[: estimator.size, : estimator.size]
    return np.asarray(estimator.estimate().covariance)


def front_of(name: str, pose: np.ndarray, rng: np.random.Generator) -> FrontEnd:
    """Before the first frame, near a pose (3,)."""
    case = CASES[name]
    prior = Prior(pose + PRIOR * rng.standard_normal(3), np.diag(PRIOR**2))
    known = LandmarkMap(np.arange(len(LANDMARKS)), LANDMARKS) if case.localizes else None
    begin = Beginning(prior, SENSOR, known, case.errors)
    front = front_end(case.estimator, case.association, begin, case.setup.settled(sensed=False))
    if isinstance(front.estimator, FixedLagSmoother):
        front.estimator.keep_no_path()
    return front


def soaked(name: str, count: int, seed: int = 0) -> FrontEnd:
    poses, step = round_trip()
    rng = np.random.default_rng(seed)
    front = front_of(name, poses[0], rng)
    for frame in frames_of(count, poses, step, rng):
        through(front, frame, lambda *_: None)
    return front


def soak(name: str, count: int, seed: int = 0) -> Soaked:
    poses, step = round_trip()
    rng = np.random.default_rng(seed)
    front = front_of(name, poses[0], rng)
    part, spent, early = max(count // 100, 1), [0.0], 0.0
    errors = nees = 0.0
    late = count - 10 * part
    for frame in frames_of(count, poses, step, rng):
        k = frame.number
        through(front, frame, lambda *_: None)
        mean, covariance = front.estimator.estimate()
        if k >= late:
            e = mean - poses[k % ROUND]
            e[2] = se2.wrap_angle(float(e[2]))
            errors += math.hypot(e[0], e[1])
            nees += float(e @ np.linalg.solve(covariance, e))
        if (k + 1) % part == 0:
            spent.append(time.process_time())
            if len(spent) == 6:
                early = resident()
    cost = 1e3 * np.diff(spent)[1:] / part
    P = covariance_of(front.estimator)
    if not np.isfinite(P).all():
        raise FloatingPointError(f"{name}: the covariance is not finite")
    trace = float(np.trace(P))
    return Soaked(
        name, count, spent[-1] - spent[1], early, resident(), float(cost[8:18].min()), float(cost[-10:].min()),
        errors / (10 * part), nees / (10 * part), float(np.abs(P - P.T).max()) / trace,
        float(np.linalg.eigvalsh(P)[0]) / trace, front.state_size, len(front.landmarks().number),
    )  # fmt: skip


if __name__ == "__main__":
    with threadpool_limits(1):
        said = json.dumps(soak(sys.argv[1], int(sys.argv[2]))._asdict()) if sys.argv[2:] else "\n".join(CASES)
    sys.stdout.write(said + "\n")

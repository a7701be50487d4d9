"""`python -m tests.research.confusion N`: which explanation is named for a log that was drawn from each.

A short log in a known map is drawn N times from each explanation and smoothed once; printed is the confusion matrix of
the explanations of the residuals, before a filter's likelihood decides between the best.
"""

import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from data.inputs import Inputs
from data.logs import open_log
from data.se2 import Array
from eval.compare import compare
from eval.referee.effects import without
from eval.referee.explanations import Evidence, Explanation, evidence_of, explanations
from eval.referee.residuals import Used
from tests.builders.logs import along

Draw = Callable[[np.random.Generator, Array, Array], tuple[Array, Array]]
"""Noise of odometry (N, 3) and observations (M, 2) from white noise; both are in stated sigmas."""
SOUND = "sound"


@cache
def exact(name: str = "arena:5:frames=120") -> tuple[Inputs, Array, Used]:
    """A log without noise, its path, and its landmarks."""
    log = open_log(name)
    r, pose = log.inputs(labels=True), log.truth.pose
    assert pose is not None
    assert log.truth.landmark_of is not None
    assert r.map is not None
    used = Used(r.map.rows(log.truth.landmark_of), r.map.xy, r.map.id)
    z = r.sensor.predict(pose[r.observations.frame], r.map.xy[used.number])
    plain = replace(
        r,
        prior=replace(r.prior, mean=pose[0]),
        increments=along(pose, r.increments.covariance),
        observations=replace(r.observations, z=z),
    )
    return plain, pose, used


def _lasting(rng: np.random.Generator, z: Array) -> Array:
    """AR(1) noise of each landmark, with a correlation of 0.8."""
    _, _, used = exact()
    made = z.copy()
    for landmark in np.unique(used.number):
        for before, now in pairwise(np.flatnonzero(used.number == landmark)):
            made[now] = 0.8 * made[before] + 0.6 * z[now]
    return made


def _frames() -> Array:
    return np.asarray(exact()[0].observations.frame)


def _own(z: Array) -> Array:
    """Three times the noise of the landmark that is seen most often."""
    number = exact()[2].number
    return np.where((number == np.bincount(number).argmax())[:, None], 3.0 * z, z)


def _jump(u: Array) -> Array:
    u[60, :2] += 12.0
    return u


DRAWN: Mapping[str, Draw] = {
    SOUND: lambda rng, u, z: (u, z), "sigma z": lambda rng, u, z: (u, 2.0 * z),
    "sigma z, half": lambda rng, u, z: (u, 0.5 * z), "sigma z1": lambda rng, u, z: (u, z * [2.0, 1.0]),
    "sigma z2": lambda rng, u, z: (u, z * [1.0, 2.0]), "sigma odometry": lambda rng, u, z: (2.0 * u, z),
    "sigma odometry, half": lambda rng, u, z: (0.5 * u, z),
    "sigma odometry_x": lambda rng, u, z: (u * [2.0, 1.0, 1.0], z),
    "tails readings": lambda rng, u, z: (u, z / np.sqrt(rng.chisquare(3.0, (len(z), 1)))),
    "tails readings, outliers": lambda rng, u, z: (u, np.where(rng.random((len(z), 1)) < 0.1, 10.0 * z, z)),
    "change z": lambda rng, u, z: (u, np.where(((_frames() >= 30) & (_frames() < 60))[:, None], 3.0 * z, z)),
    "correlation z": lambda rng, u, z: (u, _lasting(rng, z)), "landmark": lambda rng, u, z: (u, _own(z)),
    "jump odometry": lambda rng, u, z: (_jump(u), z),
}  # fmt: skip
SYSTEMATIC: Mapping[str, Mapping[str, float]] = {
    "systematic odometry_theta_time": {"odometry_theta_time": 0.01},
    "systematic odometry_x_distance": {"odometry_x_distance": 0.03},
    "systematic odometry_scale": {"odometry_x_distance": 0.03, "odometry_theta_turn": 0.03},
    "systematic odometry_wheels": {
        "odometry_x_distance": 0.03, "odometry_theta_turn": 0.03, "odometry_theta_distance": 0.02
    },
    "systematic z1_range": {"z1_range": 0.03},
    "systematic z2_constant": {"z2_constant": 0.02},
    "systematic bias": {"z1_constant": 0.1, "z2_constant": 0.02},
    "systematic mount_x": {"mount_x": 0.15},
    "systematic mount": {"mount_x": 0.2, "mount_y": -0.1},
    "systematic latency": {"latency": 0.2},
    "systematic z2_scale": {"z2_scale": 0.04},
    "systematic odometry_current": {"odometry_current_x": 0.03, "odometry_current_y": -0.03},
}  # fmt: skip


def evidence(true: str, seed: int) -> Evidence:
    """Residuals drawn from an explanation."""
    inputs, path, used = exact()
    rng = np.random.default_rng([seed, sorted([*DRAWN, *SYSTEMATIC]).index(true)])
    o, increments = inputs.observations, inputs.increments
    u, z = rng.standard_normal((len(path), 3)), rng.standard_normal(o.z.shape)
    u, z = DRAWN.get(true, DRAWN[SOUND])(rng, u, z)
    u[0] = 0.0
    inputs = without(inputs, path, used, {n: -size for n, size in SYSTEMATIC.get(true, {}).items()})
    motion = inputs.increments.mean + np.einsum("nij,nj->ni", _root(increments.covariance), u)
    read = inputs.observations.z + np.einsum("mij,mj->mi", _root(o.R), z)
    inputs = replace(inputs, increments=replace(increments, mean=motion), observations=replace(o, z=read))
    (run,) = compare(inputs, "localization", ("batch",), "known")
    assert run.final is not None
    return evidence_of(inputs, run.final.pose, used)


def _root(C: Array) -> Array:
    """Square roots (n, d, d) whose components are those of C."""
    size, axes = np.linalg.eigh(C)
    return np.asarray((axes * np.sqrt(np.maximum(size, 0.0))[:, None]) @ axes.transpose(0, 2, 1))


def best(true: str, seed: int) -> Explanation | None:
    """The explanation with the best odds, if they are better than those of none."""
    found = explanations(evidence(true, seed), [])
    return found[0] if found and found[0].net > 0.0 else None


def named(found: Explanation | None) -> str:
    """An explanation in a row of the matrix; a landmark without its number."""
    if found is None:
        return SOUND
    return found.finding.kind if found.finding.kind in ("landmark", "displaced") else found.finding.said


def main() -> None:
    """Print the pairs (true, named) that occur, in %."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print("| true | named [%] |\n|---|---|")
    for true in (*DRAWN, *SYSTEMATIC):
        counts = Counter(named(best(true, seed)) for seed in range(count))
        print(f"| {true} | {', '.join(f'{n} {100 * k / count:.3g}' for n, k in counts.most_common())} |", flush=True)


if __name__ == "__main__":
    main()

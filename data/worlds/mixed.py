"""The arena with more sensors: GPS on a lever arm, a compass, and loop closures beside the landmarks.

Path, map, odometry, observations and prior are those of the arena of the same parameters and seed. Fixes, closures and
outliers come from further independent streams of the seed.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from data import se2
from data.inputs import IntArray
from data.log import Log
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from data.se2 import Array, BoolArray
from data.worlds import arena
from data.worlds.arena import Arena
from data.worlds.parameters import streams, told

STREAMS = 4  # Those of the arena come first
FAR = 3.0  # closure radii between two frames that a false closure takes for the same place
JUMP = (3.0, 10.0)  # m, least and largest jump of a GPS fix


@dataclass(frozen=True)
class Mixed(Arena):
    """Parameters of the world, beside those of the arena; a period of 0 is none of these measurements."""

    landmarks: int = told(12, "number of point landmarks, uniform in a square")
    gps_period: float = told(1.0, "s between position fixes")
    sigma_gps: float = told(0.3, "m, noise of each coordinate of a fix")
    lever_x: float = told(-0.3, "m, place of the antenna in the body frame")
    lever_y: float = told(0.2, "m, place of the antenna in the body frame")
    compass_period: float = told(5.0, "s between headings")
    sigma_compass: float = told(0.03, "rad, noise of a heading")
    mount_compass: float = told(0.1, "rad, direction of the compass in the body frame")
    closure_period: float = told(2.0, "s between closures")
    closure_gap: float = told(20.0, "s, least time between the two frames of a closure")
    closure_radius: float = told(2.0, "m, largest distance between them")
    sigma_closure: float = told(0.05, "m")
    sigma_closure_heading: float = told(0.01, "rad, noise of a closure")
    jumps: bool = told(False, "some GPS fixes are metres off")
    false_closures: bool = told(False, "some closures take frames for near each other that are not")
    outliers: float = told(
        0.05, "share of fixes that jump and of closures that are false, at least one of each", most="share"
    )

    positive: ClassVar[tuple[str, ...]] = (
        *Arena.positive, *("sigma_gps", "sigma_compass", "sigma_closure", "sigma_closure_heading", "closure_radius"),
    )  # fmt: skip
    signed: ClassVar[tuple[str, ...]] = (*Arena.signed, "lever_x", "lever_y", "mount_compass")


def simulate(mixed: Mixed, seed: int, name: str | None = None) -> Log:
    """One log of the world. Same parameters and seed: same bytes."""
    log = arena.simulate(mixed, seed, name or f"mixed:{seed}")
    assert log.truth.pose is not None
    fix_rng, closure_rng, outlier_rng = streams(seed, STREAMS + 3)[STREAMS:]
    fixes, fix_inlier = _fixes(mixed, log.truth.pose, fix_rng, outlier_rng)
    closures, closure_inlier = _closures(mixed, log.truth.pose, closure_rng, outlier_rng)
    recorded = replace(log.recorded, fixes=fixes, closures=closures)
    truth = replace(
        log.truth, fix_inlier=None if fixes is None else fix_inlier,
        closure_inlier=None if closures is None else closure_inlier,
    )  # fmt: skip
    return replace(log, recorded=recorded, truth=truth, source={**log.source, "kind": "mixed"})


def _stride(mixed: Mixed, period: float) -> int:
    return max(1, round(period / mixed.period))


def _drawn(count: int, share: float, rng: np.random.Generator) -> BoolArray:
    """Which of `count` are outliers: a share of them, at least one."""
    chosen = np.zeros(count, bool)
    if count:
        chosen[rng.choice(count, max(1, round(share * count)), replace=False)] = True
    return chosen


def _fixes(
    mixed: Mixed, truth: Array, rng: np.random.Generator, outlier_rng: np.random.Generator
) -> tuple[Fixes | None, IntArray]:
    """Position fixes and headings by frame, and which are inliers (F,)."""
    n = len(truth)
    sources: list[FixSource] = []
    parts: list[tuple[IntArray, Array, Array, FixKind]] = []
    outlying: list[BoolArray] = []
    if mixed.gps_period:
        frame = np.arange(0, n, _stride(mixed, mixed.gps_period))
        sources.append(FixSource("gps", (mixed.lever_x, mixed.lever_y)))
        antenna = se2.compose(truth[frame], np.array([mixed.lever_x, mixed.lever_y, 0.0]))[:, :2]
        z = np.zeros((len(frame), 3))
        z[:, :2] = antenna + mixed.sigma_gps * rng.standard_normal((len(frame), 2))
        jumped = _drawn(len(frame), mixed.outliers, outlier_rng) & mixed.jumps
        size, way = outlier_rng.uniform(*JUMP, len(frame)), outlier_rng.uniform(-math.pi, math.pi, len(frame))
        z[:, :2] += np.where(jumped, size, 0.0)[:, None] * np.stack([np.cos(way), np.sin(way)], 1)
        parts.append((frame, z, np.diag([mixed.sigma_gps**2, mixed.sigma_gps**2, 0.0]), FixKind.POSITION))
        outlying.append(jumped)
    if mixed.compass_period:
        frame = np.arange(0, n, _stride(mixed, mixed.compass_period))
        sources.append(FixSource("compass", rotation=mixed.mount_compass))
        z = np.zeros((len(frame), 3))
        noise = mixed.sigma_compass * rng.standard_normal(len(frame))
        z[:, 2] = se2.wrap_angle(truth[frame, 2] + mixed.mount_compass + noise)
        parts.append((frame, z, np.diag([0.0, 0.0, mixed.sigma_compass**2]), FixKind.HEADING))
        outlying.append(np.zeros(len(frame), bool))
    if not parts:
        return None, np.empty(0, np.int64)
    frame = np.concatenate([p[0] for p in parts])
    order = np.argsort(frame, kind="stable")
    count = [len(p[0]) for p in parts]
    fixes = Fixes(
        frame[order], np.repeat([int(p[3]) for p in parts], count)[order],
        np.repeat(np.arange(len(parts)), count)[order], np.concatenate([p[1] for p in parts])[order],
        np.repeat(np.stack([p[2] for p in parts]), count, axis=0)[order], tuple(sources),
    )  # fmt: skip
    return fixes, (~np.concatenate(outlying)).astype(np.int64)[order]


def _closures(
    mixed: Mixed, truth: Array, rng: np.random.Generator, outlier_rng: np.random.Generator
) -> tuple[Closures | None, IntArray]:
    """Closures with the nearest of much earlier frames, and which are inliers (K,)."""
    if not mixed.closure_period:
        return None, np.empty(0, np.int64)
    gap = max(1, math.ceil(mixed.closure_gap / mixed.period))
    pairs = []
    for k in range(gap, len(truth), _stride(mixed, mixed.closure_period)):
        distance = np.hypot(*(truth[: k - gap + 1, :2] - truth[k, :2]).T)
        nearest = int(np.argmin(distance))
        if distance[nearest] <= mixed.closure_radius:
            pairs.append((nearest, k))
    if not pairs:
        return None, np.empty(0, np.int64)
    first, second = np.array(pairs, np.int64).T
    false = _drawn(len(pairs), mixed.outliers, outlier_rng) & mixed.false_closures
    relative = se2.between(truth[first], truth[second])
    for i in np.flatnonzero(false):
        distance = np.hypot(*(truth[: second[i] - gap + 1, :2] - truth[second[i], :2]).T)
        elsewhere = np.flatnonzero(distance > FAR * mixed.closure_radius)
        if len(elsewhere):
            first[i] = int(outlier_rng.choice(elsewhere))
        else:
            false[i] = False
    sigma = np.array([mixed.sigma_closure, mixed.sigma_closure, mixed.sigma_closure_heading])
    relative = relative + sigma * rng.standard_normal(relative.shape)
    relative[:, 2] = se2.wrap_angle(relative[:, 2])
    covariance = np.tile(np.diag(sigma**2), (len(pairs), 1, 1))
    source = np.zeros(len(pairs), np.int64)
    return Closures(first, second, relative, covariance, source, ("loops",)), (~false).astype(np.int64)

"""Shared parts of simulated worlds: checked parameters, a drive by noisy velocities, a prior of the first pose."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import field, fields, replace
from typing import Any

import numpy as np

from data import se2
from data.errors import UsageError, unknown
from data.inputs import Increments, Prior
from data.log import Log
from data.motion.velocity import VelocityModel, VelocityNoise, floor_covariances, preintegrate
from data.se2 import Array

FLOOR = 1e-10
"""m^2, rad^2; smallest eigenvalue of an increment's covariance."""


def check_parameters(
    world: str,
    values: Any,
    *,
    positive: Collection[str],
    not_negative: Collection[str] = (),
    choices: Mapping[str, Collection[str]] | None = None,
) -> None:
    """Check every field of a dataclass: numbers by the two lists of names, words by their `choices`.

    A field has its default's type (floats accept any number); None stands for an optional number. UsageError names
    world, key and value.
    """
    for f in fields(values):
        value = getattr(values, f.name)
        where = f"{world}: {f.name} = {value!r}"
        if isinstance(f.default, str):
            known = (choices or {})[f.name]
            if value not in known:
                raise UsageError(f"{where}: {unknown(value, known)}")
            continue
        if isinstance(f.default, bool):
            if not isinstance(value, bool):
                raise UsageError(f"{where}; on or off is needed")
            continue
        if f.default is None and value is None:
            continue
        whole = isinstance(f.default, int)
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            raise UsageError(f"{where}; a {'whole ' if whole else ''}number is needed")
        if not math.isfinite(value):
            raise UsageError(f"{where}; a finite number is needed")
        if f.name in positive and not value > 0:
            raise UsageError(f"{where}; {'at least 1' if whole else 'a positive number'} is needed")
        if f.name in not_negative and value < 0:
            raise UsageError(f"{where}; must not be negative")


def in_degrees(value: float, **more: object) -> float:
    """A field in radians whose value is written in degrees, in a log's name and as a flag."""
    default: float = field(default=math.radians(value), metadata={"unit": "deg", **more})
    return default


def streams(seed: int, count: int) -> list[np.random.Generator]:
    """Independent generators of a seed."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(count)]


SURVEY = 0x50E7
"""Separates the random stream of a map's errors from others of the same seed."""


def surveyed(log: Log, sigma: float, seed: int) -> Log:
    """The log with a map whose landmarks are off by `sigma` [m] in x and y, as it states; 0: unchanged."""
    known = log.recorded.map
    if known is None or sigma == 0.0:
        return log
    rng = np.random.default_rng(np.random.SeedSequence([seed, SURVEY]))
    stated = np.full(known.xy.shape, sigma)
    off = replace(known, xy=known.xy + stated * rng.standard_normal(stated.shape), sigma=stated)
    return replace(log, recorded=replace(log.recorded, map=off))


def driven(
    period: float,
    v: Array,
    omega: Array,
    at: Array,
    start: Array,
    density: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Array, Increments, int]:
    """True poses (N, 3) at the frames `at` (N,), noisy increments between them, and how many got the floor.

    v [m/s] and omega [rad/s] are sampled every `period` [s] and held, with noise densities `density` [m and rad per
    sqrt(s)].
    """
    time = period * np.arange(len(v), dtype=np.float64)
    exact, _ = preintegrate(VelocityModel(VelocityNoise("density")), time, v, omega, at)
    truth = np.zeros((len(at), 3))
    truth[0] = start
    for k in range(1, len(truth)):
        truth[k] = se2.compose(truth[k - 1], exact.mean[k])
    root = math.sqrt(period)
    noisy_v = v + density[0] / root * rng.standard_normal(len(time))
    noisy_omega = omega + density[1] / root * rng.standard_normal(len(time))
    increments, _ = preintegrate(VelocityModel(VelocityNoise("density", density)), time, noisy_v, noisy_omega, at)
    covariance, floored = floor_covariances(increments.covariance, FLOOR)
    return truth, Increments(increments.mean, covariance), floored


def drawn_prior(pose: Array, sigma: float, sigma_heading: float, rng: np.random.Generator) -> Prior:
    """A prior with standard deviations [m, rad], its mean drawn about the true pose (3,)."""
    sigmas = np.array([sigma, sigma, sigma_heading])
    mean = pose + sigmas * rng.standard_normal(3)
    mean[2] = se2.wrap_angle(mean[2])
    return Prior(mean, np.diag(sigmas**2))

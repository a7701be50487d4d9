"""What landmarks of a simulated world look like: a descriptor such as a trunk's diameter, a class, or both."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from data.appearance import UNREAD, Appearance, drawn
from data.errors import UsageError
from data.log import Log

STREAM = 0x1004
"""Separates this random stream from others of the same seed."""


@dataclass(frozen=True)
class Looking:
    """Appearance of landmarks, as parameters of a world. False alarms look like some landmark.

    Attributes:
        descriptor_sigma: standard deviation of a measured descriptor, whose mean differs from landmark to landmark with
            a standard deviation of 1; 0: there is none.
        classes: number of classes, equally frequent; 0: there are none.
        class_error: probability that a class is read wrongly.
    """

    descriptor_sigma: float = 0.0
    classes: int = 0
    class_error: float = 0.05


NAMES = tuple(f.name for f in fields(Looking))


def check_looking(world: str, values: Looking) -> None:
    """UsageError for invalid appearance, naming world, key and value."""
    if not 0 <= values.classes <= 26 or values.classes == 1:
        raise UsageError(f"{world}: classes = {values.classes}; 2 to 26 are needed, or 0 for none")
    if not 0.0 < values.class_error < 0.5:
        raise UsageError(f"{world}: class_error = {values.class_error}; a probability above 0 and below 0.5 is needed")


def is_plain(values: Looking) -> bool:
    """Whether landmarks look like nothing."""
    return not values.descriptor_sigma and not values.classes


def plainly(values: Looking, parameters: dict[str, Any]) -> dict[str, Any]:
    """Parameters of a world by name, without these where landmarks look like nothing."""
    return {k: v for k, v in parameters.items() if k not in NAMES} if is_plain(values) else parameters


def dressed(values: Looking, log: Log, seed: int) -> Log:
    """The log with the appearance of its landmarks and observations; unchanged where there is none."""
    truth, known = log.truth, log.truth.landmarks
    if is_plain(values) or known is None or truth.landmark_of is None:
        return log
    rng = np.random.default_rng(np.random.SeedSequence([seed, STREAM]))
    n, row = len(known.id), known.rows(truth.landmark_of)
    classes = min(values.classes, n)
    mean, category = rng.standard_normal(n), rng.permutation(np.arange(n) % max(classes, 1))
    mean = mean if values.descriptor_sigma else np.full(n, np.nan)
    names = tuple("abcdefghijklmnopqrstuvwxyz"[:classes])
    zero = np.zeros(n)
    looks = Appearance(mean, zero, category if values.classes else np.full(n, UNREAD), zero, names)
    m = len(row)
    sigma, error = np.full(m, values.descriptor_sigma or 1.0), np.full(m, values.class_error if values.classes else 0.5)
    # a false alarm reads what some landmark would
    like = looks.only(np.where(row >= 0, row, rng.integers(0, n, m)))
    seen = drawn(Appearance(like.descriptor, sigma, like.category, error, names), looks, row, rng)
    places = replace(known, appearance=looks)
    recorded = replace(
        log.recorded, observations=replace(log.recorded.observations, appearance=seen),
        map=None if log.recorded.map is None else places,
    )  # fmt: skip
    return replace(log, recorded=recorded, truth=replace(truth, landmarks=places))

"""Scale of the noise, learned from what is believed: how well pairings should fit, whatever the stated noise says.

Stated noise is often several times too wide, because errors that last are to count for less than their spread says. It
is right for the estimate then, but not for comparing explanations: one that fits ten times as well as the other, in
terms of the noise that there really is, would count as equally good. So squared innovations are taken relative to
their usual size, and as slips happen, their distribution has Student's tails.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from association.evidence import constants
from data.se2 import Array


class NoiseScale(NamedTuple):
    """Variance of the innovations as a share of what was stated, and the weight of what was learned, in innovations."""

    scale: float
    weight: float


def stated() -> NoiseScale:
    """In a known map before anything is learned: what was stated, worth as much as a few innovations."""
    return NoiseScale(1.0, constants.NOISE_PRIOR)


def log_density(noise: NoiseScale, d2: float, log_det: float) -> float:
    """Logarithm of the density of an innovation (2,): d^2 and log determinant by its stated covariance.

    Student's t in two dimensions with the scale matrix `noise.scale` times the stated covariance.
    """
    tails = 0.5 * (constants.FREEDOM + 2.0) * math.log1p(d2 / (constants.FREEDOM * noise.scale))
    return -math.log(2.0 * math.pi * noise.scale) - 0.5 * log_det - tails


def learned(before: NoiseScale, d2: Array, share: Array) -> NoiseScale:
    """The scale after innovations of squares d2 (k,), each believed to a share (k,).

    One step of expectation maximization for Student's t (Liu and Rubin, Statistica Sinica 5, 1995), with fading memory.
    """
    total = float(share.sum())
    if total <= 0.0:
        return before
    counts = (constants.FREEDOM + 2.0) / (constants.FREEDOM + d2 / before.scale)
    weight = min(before.weight + total, max(constants.NOISE_MEMORY, total))
    scale = before.scale + (0.5 * float(share @ (counts * d2)) - total * before.scale) / weight
    return NoiseScale(max(scale, constants.FINEST), weight)

"""Gates by the noise that there is: how wide expectations are, learned apart for the sensor and for map and motion.

Stated noise is often several times too wide, and then a new landmark is inside the gate of its neighbour. What is
believed tells how much of the stated covariances there is (`association.evidence.noise`). Sensor and motion are learned
apart, because a landmark seen in every frame tells of the sensor only: what the map and a long drive add to its
expectation may still be as stated.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from association.evidence import constants
from association.evidence.noise import NoiseScale
from association.expectation import Expectation
from data.inputs import IntArray
from data.se2 import Array


class Scales(NamedTuple):
    """What is learned of the sensor's noise, and of that of map and motion; of the tails beyond Student's.

    `log_tails` is the logarithm of a factor on variances, `sightings` those that it was learned from.
    """

    sensor: NoiseScale
    motion: NoiseScale
    log_tails: float = 0.0
    sightings: float = 0.0


def as_stated() -> Scales:
    """Before anything is learned: what was stated, worth as much as a few innovations."""
    return Scales(NoiseScale(1.0, constants.SCALES_PRIOR), NoiseScale(1.0, constants.SCALES_PRIOR))


def scaled(e: Expectation, scales: Scales) -> Expectation:
    """The expectation with the noise that there is."""
    share = widest(scales)
    if share == 1.0:
        return e
    return replace(
        e, R=share * e.R, HPHt=share * e.HPHt, joint=lambda indices: share * e.joint(indices), elsewhere=None
    )


def widest(scales: Scales) -> float:
    """Share of the stated variance that decisions count with: the wider of both, for a gate must hold what either does.

    Never more than was stated.
    """
    return min(1.0, _core(scales) * math.exp(scales.log_tails))


def _core(scales: Scales) -> float:
    """Without the tails."""
    return min(1.0, constants.TAILS * max(scales.sensor.scale, scales.motion.scale))


def counted(scales: Scales, inside: int, outside: int) -> Scales:
    """After sightings inside and outside the gate that are not new: the gate goes to where it leaves out its share.

    (Robbins and Monro, Annals of Mathematical Statistics 22, 1951.)
    """
    sightings = max(scales.sightings + inside + outside, 1.0)
    step = max(min(constants.TAILS_STEP, constants.TAILS_HORIZON / sightings), constants.TAILS_SLOWEST)
    log = max(0.0, scales.log_tails + step * (outside * (1.0 - constants.LEFT_OUT) - inside * constants.LEFT_OUT))
    return scales._replace(log_tails=min(log, -math.log(_core(scales))), sightings=sightings)


def relearned(scales: Scales, e: Expectation, decisions: IntArray) -> Scales:
    """After the pairings of a frame, by the expectation as stated.

    Variance components: each innovation tells of either scale by the square of its share in the covariance, as much as
    the Fisher information of a scale; Student's weights as in `association.evidence.noise`.
    """
    rows, chosen = e.paired(decisions)
    if not len(rows):
        return scales
    parts = scales.sensor.scale * e.R[rows], scales.motion.scale * e.HPHt[chosen]
    nu = e.residual(e.z[rows], e.z_hat[chosen])
    S = parts[0] + parts[1]
    v = np.asarray(np.linalg.solve(S, nu[..., None])[..., 0], np.float64)
    weight = (constants.FREEDOM + 2.0) / (constants.FREEDOM + (nu * v).sum(axis=1))
    sensor, motion = (_toward(s, part, S, v, weight) for s, part in zip(scales[:2], parts, strict=True))
    return scales._replace(sensor=sensor, motion=motion)


def _toward(before: NoiseScale, part: Array, S: Array, v: Array, weight: Array) -> NoiseScale:
    """One scale after innovations nu (k, 2), v = S^-1 nu; its part (k, 2, 2) of the covariance S (k, 2, 2)."""
    share = 0.5 * np.trace(np.linalg.solve(S, part), axis1=1, axis2=2)
    ratio = 0.5 * weight * np.einsum("ki,kij,kj->k", v, part, v) / np.maximum(share, constants.LEAST_SHARE)
    total = float((share**2).sum())
    memory = min(before.weight + total, max(constants.NOISE_MEMORY, total))
    scale = before.scale * (1.0 + float(share**2 @ (ratio - 1.0)) / memory)
    return NoiseScale(max(scale, constants.FINEST), memory)

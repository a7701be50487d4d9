"""Conventions in which an information matrix may have been written, asked where the residuals speak for one.

Writers of relations in space differ: rotation before or after translation, of the angle or of a quaternion's vector
part (half the angle, so that the variance of the angle is four times the stated one), information or its root. Each
would leave its own pattern of variance components; the question is asked if the pattern is there and the stated
reading is rejected.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from data.se2 import Array
from wings.audit.audit import FAMILY, Audit
from wings.audit.kinds import AXES
from wings.audit.linear import Graph

HALF, ORDER, ROOT = "half-angle", "order", "root"
HALF_ANGLE = 4.0  # variance of the angle over that of a quaternion's vector part
SURE, LARGEST = 2.5, 0.3  # standard errors within which a pattern fits; of a logarithm, beyond which none is told
FITS, SLACK = 22.5, 0.1  # chi-square of six axes that fit, at 0.1 %; of a logarithm, what linearization may add
APART = 1.0  # least logarithm of a pattern, else it is none


@dataclass(frozen=True)
class Question:
    """A convention that a kind of factors may have: `found` is what the components say, `expected` what it implies."""

    kind: str
    convention: str
    found: float
    error: float
    expected: float


def questions(a: Audit, graph: Graph) -> tuple[Question, ...]:
    """The questions of an audit of a graph."""
    out = []
    for k, kind in enumerate(a.kinds.names):
        if a.kinds.axes[k] != AXES["Pose3"]:
            continue
        rows = np.array([i for i, (of, x) in enumerate(a.axis.tolist()) if of == k and x >= 0])
        component, error = a.by_axis.component[rows], a.by_axis.error[rows]
        if np.isfinite(component).all() and (a.p_axis[rows] < FAMILY).any():
            stated = np.mean([_stated(graph, i) for i in np.flatnonzero(a.kinds.of == k).tolist()], axis=0)
            out += _of_kind(kind, np.log(component), error / component, stated)
    return tuple(out)


def _stated(graph: Graph, i: int) -> Array:
    """Logarithms (6,) of the variances that a factor states."""
    factor = graph.at(i)
    assert isinstance(factor, gtsam.NoiseModelFactor)
    model = factor.noiseModel()
    plain = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
    out: Array = 2.0 * np.log(np.maximum(np.asarray(plain.sigmas()), np.finfo(float).tiny))
    return out


def _of_kind(kind: str, c: Array, e: Array, v: Array) -> list[Question]:
    """From the logarithms of components (6,), with standard errors, and of the stated variances."""

    def mean(part: slice, values: Array) -> tuple[float, float]:
        weight = 1.0 / e[part] ** 2
        return float(np.sum(weight * values[part]) / weight.sum()), float(1.0 / np.sqrt(weight.sum()))

    turn, shift = slice(0, 3), slice(3, 6)
    (rotation, by_turn), (translation, by_shift) = mean(turn, c), mean(shift, c)
    error = float(np.hypot(by_turn, by_shift))
    ratio = rotation - translation
    out = []
    swapped = 2.0 * float(v[shift].mean() - v[turn].mean())  # the rotation has the other's variance, and vice versa
    patterns = ((HALF, ratio, error, float(np.log(HALF_ANGLE))), (ORDER, ratio, error, swapped))
    for convention, found, se, expected in patterns:
        if se < LARGEST and abs(expected) > APART and abs(found - expected) < SURE * se + SLACK:
            ratio_ = float(np.exp(found))
            out.append(Question(kind, convention, ratio_, ratio_ * se, float(np.exp(expected))))
    # the stated number is the root of the information: component times root is 1 in each axis
    off = c - v
    if (
        max(by_turn, by_shift) < LARGEST
        and np.abs(v).max() > APART
        and float(np.sum(off**2 / (e**2 + SLACK**2))) < FITS
    ):
        found, se = mean(slice(0, 6), off)
        out.append(Question(kind, ROOT, float(np.exp(found)), float(np.exp(found) * se), 1.0))
    return out

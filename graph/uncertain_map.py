"""Landmarks of an uncertain map as variables of a smoother, with their places in the map as priors.

A landmark's error in the map is the same in all its observations, so one variable stands for it, however often it is
observed. Landmarks without an error in an uncertain map are held to a micrometre.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L

from data.errors import UsageError
from data.inputs import IntArray, LandmarkMap, Systematic
from data.se2 import Array
from data.sensors import Sensor
from graph.factors import EXACT, Factor, noise


@dataclass(frozen=True)
class LandmarkPrior:
    """A landmark's place in the map, `row` there, as a factor on its variable."""

    number: int
    row: int
    xy: Array
    factor: Factor


def is_uncertain(known: LandmarkMap | None) -> bool:
    """Whether there is a map whose landmarks have errors."""
    return known is not None and known.sigma is not None


def landmark_priors(known: LandmarkMap | None, numbers: IntArray) -> list[LandmarkPrior]:
    """Priors of landmarks (k,) of an uncertain map, by id; none without one."""
    if known is None or known.sigma is None:
        return []
    found = []
    for number, row in zip(numbers.tolist(), known.rows(numbers).tolist(), strict=True):
        model = noise.Diagonal.Sigmas(np.maximum(known.sigma[row], EXACT))
        xy = known.xy[row]
        found.append(LandmarkPrior(number, row, xy, gtsam.PriorFactorPoint2(L(number), xy, model)))
    return found


def refuse_uncertain(known: LandmarkMap | None, systematic: Systematic | None, sensor: Sensor) -> None:
    """Raise UsageError for an uncertain map beside a range error to estimate, or of walls."""
    if is_uncertain(known) and not (sensor.sees_points and (systematic is None or "range" not in systematic.names)):
        raise UsageError("an uncertain map needs a sensor of points, without a range error to estimate")

"""Whose fault, in a word: odometry, sensor, estimator, associations, or nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping

from eval.referee.attribution import (
    ASSOCIATIONS,
    ESTIMATOR,
    LEAST_FACTOR,
    NOTHING,
    Finding,
    component_of,
)
from eval.report.trust.said import STANDS_OUT
from eval.studies.trusted import Blame, Trust

ODOMETRY, SENSOR = "odometry", "sensor"


def cause_word(trust: Trust) -> str:
    """What is to blame for what a log says of itself; without twins the largest residual effect hints at it."""
    return _judged(trust, trust.blame) if trust.blame is not None else _hinted(trust)


def _judged(trust: Trust, blame: Blame) -> str:
    """The cause of the verdict; of a noise, the side whose component it is of."""
    if blame.cause in (NOTHING, ASSOCIATIONS, ESTIMATOR):
        return blame.cause
    for found in blame.findings:
        if found.cause == blame.cause:
            return side(_component(found))
    # no finding has a name: the side of the residuals that lie furthest outside their twins
    sides = [side(name.split("_", 1)[1]) for _, name in blame.objected if name.startswith(("slope_", "residual_"))]
    return max(dict.fromkeys(sides), key=sides.count) if sides else _largest(_spreads(trust)) or SENSOR


def _component(found: Finding) -> str:
    return component_of(found.name) if found.kind == "systematic" else found.name


def side(component: str) -> str:
    """Which of the robot's two sources a component of increments or readings belongs to."""
    return ODOMETRY if component.startswith("odometry") else SENSOR


def _hinted(trust: Trust) -> str:
    """Without twins: the systematic error beyond `STANDS_OUT` standard errors, else a noise larger than stated."""
    slopes = {
        name.removeprefix("slope_"): abs(m.value) / m.se
        for (_, name), m in trust.real.measured.items()
        if name.startswith("slope_") and math.isfinite(m.value) and math.isfinite(m.se) and m.se > 0.0
    }
    if max(slopes.values(), default=0.0) > STANDS_OUT:
        return _largest(slopes)
    larger = {name: value for name, value in _spreads(trust).items() if value > LEAST_FACTOR}
    return _largest(larger) or NOTHING


def _spreads(trust: Trust) -> dict[str, float]:
    """Spread of the smoother's residuals in stated sigmas, by component."""
    return {
        name.removeprefix("residual_").removesuffix("_spread"): m.value
        for (_, name), m in trust.real.measured.items()
        if name.startswith("residual_") and name.endswith("_spread") and math.isfinite(m.value)
    }


def _largest(sizes: Mapping[str, float]) -> str:
    return side(max(sizes, key=lambda name: sizes[name])) if sizes else ""

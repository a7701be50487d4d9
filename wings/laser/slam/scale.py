"""The front end with its variances scaled by one factor, which loop closures tell: scan matching is overconfident."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data.inputs import Inputs
from wings.laser.scans.uncertainty import learned_scale, residuals, spanned
from wings.laser.slam.backends import key_inputs, smoothed
from wings.laser.slam.front_end import FrontEndResult, Repeated, consistent_front_end
from wings.laser.slam.parameters import LaserParameters

FEWEST = 20  # loop closures needed to learn a scale, which then is known to a quarter or better


class Scaled(NamedTuple):
    """The front end's constraints with scaled covariances.

    `claimed`: scale on the variances that scan matching itself states; `error`: its standard error, None: too few loop
    closures tell it, and it is the front end's own. `factor`: the part of it that was learned.
    """

    front: FrontEndResult
    repeated: Repeated | None
    factor: float
    claimed: float
    error: float | None


def scaled_front_end(inputs: Inputs, parameters: LaserParameters) -> Scaled:
    """The front end over a laser log; the scale follows from the whole log, and leaves the optimum where it is."""
    front, repeated = consistent_front_end(inputs, parameters)
    learned = _learned(inputs, front)
    factor, error = learned or (1.0, 0.0)
    claimed = parameters.variance_scale * factor
    return Scaled(
        scaled(front, factor), repeated, factor, claimed, None if learned is None else parameters.variance_scale * error
    )


def scaled(front: FrontEndResult, factor: float) -> FrontEndResult:
    """The same with all variances times a factor."""
    c, o = front.chain, front.loops
    chain = replace(c, covariance=factor * c.covariance, since_covariance=factor * c.since_covariance)
    return replace(front, chain=chain, loops=replace(o, covariance=factor * o.covariance))


def _learned(inputs: Inputs, front: FrontEndResult) -> tuple[float, float] | None:
    """Factor on the front end's covariances and its standard error; None with too few loop closures."""
    chain, loops = front.chain, front.loops
    believed = np.flatnonzero(loops.believed >= 0)
    if len(believed) < FEWEST:
        return None
    solved = smoothed("batch", key_inputs(inputs, chain, loops))
    if solved.failure is not None or solved.final is None:
        return None
    key1, key2 = loops.key1[believed], loops.key2[believed]
    step = 1 + np.flatnonzero(spanned(len(chain.frame), key1, key2))
    d2 = residuals(
        solved.final.pose, np.concatenate([step - 1, key1]), np.concatenate([step, key2]),
        np.concatenate([chain.motion[step], loops.relative[believed]]),
        np.concatenate([chain.covariance[step], loops.covariance[believed]]),
    )  # fmt: skip
    return learned_scale(d2, len(believed))

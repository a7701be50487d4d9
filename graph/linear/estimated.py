"""Systematic errors that were estimated, as unknowns of the score test: what more of each would add to a log.

The log is the one less the errors found (`data.motion.corrected_inputs`), in the robot's own frame; each error more, in
prior sigmas, has a column, and the prior of its whole size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.inputs import Inputs, IntArray
from data.motion.corrected_inputs import all_errors
from data.motion.stated import stated_all
from data.motion.systematic import BEARING, RANGE, knots, places
from data.result import Systematics
from data.se2 import Array, between
from data.sensors import RANGE_BEARING
from graph.linear.calibrated import drift_rows


class Estimated(NamedTuple):
    """Errors beside path and map, in prior sigmas.

    Attributes:
        motion: (N, 3, q) what one more of each constant error adds to the increments.
        readings: (m, 2, q) to the readings.
        now: (q,) sizes found.
        by_drift: (N, 3) what one more of its knot's drift adds to an increment; of: (N,) which knot that is.
        own, earlier: (K,) coefficients of a knot and the one before in the rows of the drift's prior, K = 0 without
            one; steps: (K,) what those rows are for the drift found.
    """

    motion: Array
    readings: Array
    now: Array
    by_drift: Array
    of: IntArray
    own: Array
    earlier: Array
    steps: Array


def estimated_errors(inputs: Inputs, found: Systematics, path: Array, frame: IntArray, z_hat: Array) -> Estimated:
    """Of `inputs` with systematic errors `found`, at a path (N, 3), for readings from frames (m,) that expect z_hat."""
    systematic = inputs.systematic
    assert systematic is not None
    every, place, sigma = all_errors(found), places(systematic), systematic.sigma
    of_odometry = every.copy()
    of_odometry[:, [RANGE, BEARING]] = 0.0
    # the errors act on the way as smoothed (see `graph.linear.increments`); the log is corrected by too little
    _, by_way, by_errors = stated_all(
        between(path[:-1], path[1:]), of_odometry[1:], inputs.increments.mean[1:, 2] > 0.0
    )
    motion, readings = np.zeros((len(path), 3, len(place))), np.zeros((len(frame), 2, len(place)))
    motion[1:] = (np.linalg.inv(by_way) @ by_errors)[:, :, place] * sigma
    motion[:, :, place >= RANGE] = 0.0
    size = 1.0 + every[frame, RANGE]
    for i in np.flatnonzero(place >= RANGE):
        if inputs.sensor.kind == RANGE_BEARING:
            more = np.eye(2)[place[i] - RANGE] * np.column_stack([z_hat[:, 0] / size, np.ones(len(frame))])
        elif place[i] == RANGE:
            more = z_hat / size[:, None]
        else:
            more = np.column_stack([-z_hat[:, 1], z_hat[:, 0]])
        readings[:, :, i] = more * sigma[i]
    names = list(systematic.names)
    constant = [i for i, n in enumerate(names) if n != "drift"]
    now = found.mean[-1] / sigma
    of, ended = knots(systematic, inputs.increments.mean)
    own, earlier = drift_rows(ended, systematic.length) if systematic.drifts else (np.empty(0), np.empty(0))
    by_drift, steps = np.zeros((len(of), 3)), np.empty(0)
    if systematic.drifts:
        at = names.index("drift")
        by_drift = motion[:, :, at]
        drift = found.mean[np.searchsorted(of, np.arange(len(own))), at] / sigma[at]
        steps = own * drift
        steps[1:] += earlier[1:] * drift[:-1]
    return Estimated(motion[:, :, constant], readings[:, :, constant], now[constant], by_drift, of, own, earlier, steps)


def without_errors(left: Array, now: Array) -> Array:
    """Products (1 + p, 1 + p) of residuals and columns, what errors `now` (q,) found can explain taken out.

    `left` (1 + p + q, ...): theirs come last, with the sign that columns have there. What a whole error is, is known by
    its prior.
    """
    q = len(now)
    if not q:
        return left
    at = len(left) - q
    with_prior = left.copy()
    with_prior[at:, at:] += np.eye(q)
    with_prior[0, at:] += now
    with_prior[at:, 0] += now
    with_prior[0, 0] += now @ now
    across = with_prior[:at, at:]
    return with_prior[:at, :at] - across @ np.linalg.solve(with_prior[at:, at:], across.T)

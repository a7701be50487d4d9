"""A filter over a whole log in one compiled loop, for decisions that were made beforehand (known association).

The step-by-step filters give the same bytes; this spares them the way through the interpreter at every frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.inputs import Inputs, IntArray
from data.result import DISCARD, NEW, MapState
from data.se2 import Array
from ekf import kernels
from ekf.filter import DEFAULT, FilterOptions


class FilterRun(NamedTuple):
    """Pose (N, 3), covariance (N, 3, 3); nis, dof, log_likelihood, state_size (N,) each.

    `decisions` (M,) are the given ones, gated pairings turned into `DISCARD`; `failure` is (frame, why) or None: the
    rows after it are NaN.
    """

    pose: Array
    covariance: Array
    nis: Array
    dof: IntArray
    log_likelihood: Array
    state_size: IntArray
    decisions: IntArray
    map: MapState | None
    failure: tuple[int, str] | None


def run_filter(
    inputs: Inputs,
    decisions: IntArray,
    *,
    threshold: float = np.inf,
    options: FilterOptions = DEFAULT,
) -> FilterRun:
    """EKF localization (inputs with a map) or EKF-SLAM (without) with given decisions (M,).

    SLAM: decisions are landmark numbers in order of creation, `NEW` or `DISCARD`; localization: map ids or `DISCARD`.
    """
    if options.new_variance_per_square is not None:
        raise ValueError("a new landmark's variance depends on its distance only in the step-by-step filter")
    n, slam = len(inputs), inputs.map is None
    decided = np.array(decisions, np.int64)
    if inputs.map is None:
        known = np.empty((0, 2))
    else:
        known = inputs.map.xy
        paired = decided >= 0
        decided[paired] = np.searchsorted(inputs.map.id, decided[paired])
        decided[~paired] = DISCARD
    capacity = 3 + 2 * int((decided == NEW).sum())
    mean, P = np.zeros(capacity), np.zeros((capacity, capacity))
    mean[:3], P[:3, :3] = inputs.prior.mean, inputs.prior.covariance
    pose, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    stats, size = np.zeros((n, 3)), np.zeros(n, np.int64)
    o = inputs.observations
    how = options.each, options.augment_variance(0.0), options.rule
    d, status, frame = kernels.run(
        inputs.sensor.kind, inputs.sensor.extrinsic, mean, P, 3, inputs.increments.mean, inputs.increments.covariance,
        inputs.start, o.z, o.R, decided, known, how, float(threshold), (pose, covariance, stats, size),
    )  # fmt: skip
    failure = None
    if status != kernels.OK:
        failure = (int(frame), kernels.FAILURES[status])
        pose[frame:], covariance[frame:] = np.nan, np.nan
    if inputs.map is not None:
        decided = np.where(decided >= 0, inputs.map.id[np.maximum(decided, 0)], DISCARD)
    state = None
    if slam:
        count = (d - 3) // 2
        blocks = P[3:d, 3:d].reshape(count, 2, count, 2)[np.arange(count), :, np.arange(count), :]
        state = MapState(np.arange(count, dtype=np.int64), mean[3:d].reshape(count, 2).copy(), blocks)
    return FilterRun(
        pose, covariance, stats[:, 0], stats[:, 2].astype(np.int64), stats[:, 1], size, decided, state, failure
    )

"""A log less the systematic errors that were found in it: what a plain estimator, or a referee, is to be shown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.inputs import ERRORS, Inputs
from data.motion.stated import stated_all
from data.motion.systematic import BEARING, RANGE, corrected_all
from data.result import Systematics
from data.se2 import Array, wrap_angle
from data.sensors import RELATIVE_POINT


def all_errors(systematics: Systematics) -> Array:
    """Errors (N, 7) by frame in the order of `ERRORS`, zero where not estimated."""
    found = np.zeros((len(systematics.mean), len(ERRORS)))
    found[:, [list(ERRORS).index(n) for n in systematics.names]] = systematics.mean
    return found


def corrected_inputs(inputs: Inputs, systematics: Systematics | None) -> Inputs:
    """The inputs as they would be without errors of these sizes, and nothing left to estimate of them.

    Increments are the robot's own; readings are turned and shortened; noise goes along with both. What a smoother that
    estimated the errors made of the log is, but for squares of the noise, the optimum of these inputs as well. None:
    none were found, and the inputs stay as they are.
    """
    if systematics is None:
        return inputs
    errors = all_errors(systematics)
    of_odometry = errors.copy()
    of_odometry[:, [RANGE, BEARING]] = 0.0
    increments = inputs.increments
    found = corrected_all(increments.mean, increments.covariance, of_odometry, np.arange(len(ERRORS)), np.zeros(3))
    # the noise is one of what was stated
    carried = np.linalg.inv(stated_all(found.mean, of_odometry, increments.mean[:, 2] > 0.0)[1])
    o = inputs.observations
    size, bearing = 1.0 + errors[o.frame, RANGE], errors[o.frame, BEARING]
    z, J = o.z.copy(), np.zeros((len(o.z), 2, 2))
    if inputs.sensor.kind != RELATIVE_POINT:
        z[:, 0], z[:, 1] = z[:, 0] / size, wrap_angle(z[:, 1] - bearing)
        J[:, 0, 0], J[:, 1, 1] = 1.0 / size, 1.0
    else:
        c, s = np.cos(bearing) / size, np.sin(bearing) / size
        J[:, 0, 0], J[:, 0, 1], J[:, 1, 0], J[:, 1, 1] = c, s, -s, c
        z = np.einsum("mij,mj->mi", J, z)
    return replace(
        inputs,
        increments=replace(
            increments, mean=found.mean, covariance=carried @ increments.covariance @ carried.transpose(0, 2, 1)
        ),
        observations=replace(o, z=z, R=J @ o.R @ J.transpose(0, 2, 1)),
        systematic=None,
    )

"""Which landmarks are candidates at all: those in the sensor's range and view, widened by what is uncertain."""

from __future__ import annotations

import math

import numpy as np

from data.se2 import Array, BoolArray
from data.sensors import MIN_RANGE, RANGE_BEARING, Sensor

SIGMAS = 3.0
"""The field of view is widened by so many sigmas of the expectation, ..."""
MARGIN = math.radians(5.0)
"""rad, ... and by this."""


def in_view(sensor: Sensor, z_hat: Array, HPHt: Array) -> BoolArray:
    """Which expected measurements (n, 2) lie in the field of view, widened by 3 sigma, of HPHt, and 5 degrees."""
    variance = np.diagonal(HPHt, axis1=1, axis2=2)
    if sensor.kind != RANGE_BEARING:
        r = np.maximum(np.hypot(z_hat[:, 0], z_hat[:, 1]), MIN_RANGE)
        u = z_hat / r[:, None]
        along = np.einsum("ni,nij,nj->n", u, HPHt, u)
        across = np.einsum("nii->n", HPHt) - along
        variance = np.stack([along, across / r**2], 1)
    sigma = SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    return sensor.in_view(z_hat, margin_range=sigma[:, 0], margin_angle=np.minimum(sigma[:, 1] + MARGIN, math.pi))


def may_be_in_view(sensor: Sensor, pose: Array, covariance: Array, xy: Array, spread: Array) -> BoolArray:
    """A superset of `in_view` that needs no joint covariance: spread (n,) bounds each landmark's own sigma [m]."""
    z_hat = sensor.predict(pose, xy)
    lever = math.hypot(*sensor.translation) * math.sqrt(covariance[2, 2])
    sigma = spread + math.sqrt(covariance[0, 0] + covariance[1, 1]) + lever
    r = np.maximum(sensor.polar(z_hat)[:, 0], MIN_RANGE)
    angle = SIGMAS * (sigma / r + math.sqrt(covariance[2, 2])) + MARGIN
    return sensor.in_view(z_hat, margin_range=SIGMAS * sigma, margin_angle=np.minimum(angle, math.pi))

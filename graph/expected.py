"""What a smoother expects to see: candidates in the sensor's view, expected measurements, and their covariance."""

from __future__ import annotations

import math

import numpy as np

from association.expectation import Expectation
from data.inputs import IntArray, Sightings
from data.se2 import Array, BoolArray
from data.sensors import MIN_RANGE, RANGE_BEARING, Sensor

SIGMAS = 3.0
"""The field of view is widened by so many sigmas of the expectation, ..."""
MARGIN = math.radians(5.0)
"""rad, ... and by this."""


def form(
    sensor: Sensor, pose: Array, covariance: Array, number: IntArray, xy: Array, sightings: Sightings
) -> Expectation:
    """Expectation over landmarks `number` (n,) at xy (n, 2), seen from `pose` (3,).

    `covariance`, world frame: (3 + 2n, 3 + 2n) of pose and landmarks, or (3, 3) of the pose where they are known.
    """
    n, m = len(number), len(sightings.z)
    z_hat, Hx, Hl = sensor.linearize(pose, xy)
    known = len(covariance) == 3
    Pxx = covariance[:3, :3]
    blocks = Hx @ Pxx @ Hx.transpose(0, 2, 1)
    if not known:
        Pxl = covariance[:3, 3:].reshape(3, n, 2).transpose(1, 0, 2)
        Pll = covariance[3:, 3:].reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]
        cross = Hx @ Pxl @ Hl.transpose(0, 2, 1)
        blocks = blocks + cross + cross.transpose(0, 2, 1) + Hl @ Pll @ Hl.transpose(0, 2, 1)
    zeros = np.zeros(n + m, np.int64)

    def joint(indices: IntArray) -> Array:
        chosen = np.asarray(indices, np.int64)
        k = len(chosen)
        H = np.zeros((k, 2, 3 if known else 3 + 2 * k))
        H[:, :, :3] = Hx[chosen]
        of = np.arange(3)
        if not known:
            for q in range(2):
                H[np.arange(k), :, 3 + 2 * np.arange(k) + q] = Hl[chosen, :, q]
            of = np.concatenate([of, (3 + 2 * chosen[:, None] + np.arange(2)).ravel()])
        rows = H.reshape(2 * k, H.shape[2])
        S: Array = rows @ covariance[np.ix_(of, of)] @ rows.T
        return 0.5 * (S + S.T)

    return Expectation(number, z_hat, blocks, zeros[:n], sightings.z, sightings.R, zeros[:m], sensor.residual, joint)


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

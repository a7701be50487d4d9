"""What a smoother expects to see: expected measurements of its candidates, and their covariance."""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation
from data.blocks import coordinates, diagonal_blocks
from data.inputs import IntArray, Sightings
from data.se2 import Array, pose_error
from data.sensors import Sensor


def form(
    sensor: Sensor,
    pose: Array,
    covariance: Array,
    number: IntArray,
    xy: Array,
    sightings: Sightings,
    at: Array | None = None,
) -> Expectation:
    """Expectation over landmarks `number` (n,) at xy (n, 2), seen from `pose` (3,), linearized there or `at` (3,).

    `covariance`, world frame: (3 + 2n, 3 + 2n) of pose and landmarks, or (3, 3) of the pose where they are known.
    """
    n, m = len(number), len(sightings.z)
    z_hat, Hx, Hl = sensor.linearize(pose if at is None else at, xy)
    if at is not None:
        z_hat = z_hat + Hx @ pose_error(pose, at)
    known = len(covariance) == 3
    Pxx = covariance[:3, :3]
    blocks = Hx @ Pxx @ Hx.transpose(0, 2, 1)
    if not known:
        Pxl = covariance[:3, 3:].reshape(3, n, 2).transpose(1, 0, 2)
        Pll = diagonal_blocks(covariance[3:, 3:])
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
            of = np.concatenate([of, 3 + coordinates(chosen)])
        rows = H.reshape(2 * k, H.shape[2])
        S: Array = rows @ covariance[np.ix_(of, of)] @ rows.T
        return 0.5 * (S + S.T)

    def elsewhere(at: Array) -> Expectation:
        return form(sensor, pose, covariance, number, xy, sightings, at)

    return Expectation(
        number, z_hat, blocks, zeros[:n], sightings.z, sightings.R, zeros[:m], sensor.residual, joint, elsewhere
    )

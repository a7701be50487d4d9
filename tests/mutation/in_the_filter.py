"""Faults in the filter: prediction, innovation, gain, augmentation, what it reports."""

from __future__ import annotations

import numpy as np

from data.inputs import Increment
from data.result import PoseEstimate
from data.se2 import world_from_body, wrap_angle
from data.sensors import measure
from ekf import kernels, updates
from tests.mutation.faults import Fault, interpreted, replaced
from tests.mutation.verdicts import (
    AS_CERTAIN,
    LOCALIZER_NEES,
    LOCALIZER_NIS,
    LOCALIZER_WHITENESS,
)


def with_innovate(innovate):
    """Put in: the update with another `innovate` instead of the compiled one."""

    def put_in(monkeypatch):
        update = interpreted(updates.update, innovate=innovate)
        monkeypatch.setattr(updates, "of_frame", interpreted(updates.of_frame, update=update))

    return put_in


def unwrapped(kind, extrinsic, mean, base, P, d, seen, begin, out, first):
    kernels.innovate(kind, extrinsic, mean, base, P, d, seen, begin, out, first)
    bearing = seen.z[:, 1]
    out.nu[1::2] = bearing - wrap_angle(bearing - out.nu[1::2])  # z less what was expected, which is wrapped


def with_jacobians(choose):
    """`innovate` of a localizer, where `choose(i, landmark, H)` gives the Jacobian (2, 3) of observation i."""

    def innovate(kind, extrinsic, mean, base, P, d, seen, begin, out, first):
        kernels.innovate(kind, extrinsic, mean, base, P, d, seen, begin, out, first)
        rows = []
        for i, landmark in enumerate(seen.known):
            H = np.empty((2, 3))
            measure(kind, extrinsic, mean, *landmark, np.empty(2), H, np.empty((2, 2)))
            rows.append(choose(i, landmark, H))
        H = np.concatenate(rows)
        out.PHt[:] = P[:d, :d] @ H.T
        out.S[:] = H @ out.PHt
        for i in range(len(seen.at)):
            out.S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += seen.R[i]

    return innovate


def jacobian_of_the_first_sighting(monkeypatch):
    seen = {}
    with_innovate(with_jacobians(lambda i, landmark, H: seen.setdefault(tuple(landmark), H)))(monkeypatch)


def jacobian_of_the_first_in_the_frame(monkeypatch):
    kept = {}

    def choose(i, landmark, H):
        if i == 0:
            kept["H"] = H
        return kept["H"]

    with_innovate(with_jacobians(choose))(monkeypatch)


def jacobian_on_the_wrong_side(real):
    def predict(mean, P, d, motion, M, first):
        before, at = P[:d, :d].copy(), mean[:2].copy()
        real(mean, P, d, motion, M, first)
        F = np.eye(d)
        F[0, 2], F[1, 2] = -(mean[1] - at[1]), mean[0] - at[0]
        P[:d, :d] += F.T @ before @ F - F @ before @ F.T

    return predict


def gain_before_the_prediction(monkeypatch):
    stale = {}
    predict, update = kernels.predict, updates.of_frame

    def remember(mean, P, d, motion, M, first):
        stale["P"] = P.copy()
        predict(mean, P, d, motion, M, first)

    def with_the_old_gain(kind, extrinsic, start, mean, P, *rest):
        old = stale.get("P", P).copy()
        new = old.copy()
        status = update(kind, extrinsic, start, mean, new, *rest)
        P += new - old
        return status

    monkeypatch.setattr(kernels, "predict", remember)
    monkeypatch.setattr(updates, "of_frame", with_the_old_gain)


def no_cross_covariance(real):
    def augment(kind, extrinsic, mean, P, d, z, R, variance, first):
        real(kind, extrinsic, mean, P, d, z, R, variance, first)
        P[d : d + 2, :d] = 0.0
        P[:d, d : d + 2] = 0.0

    return augment


def block_diagonal(real):
    def update(kind, extrinsic, start, mean, P, d, *rest):
        status = real(kind, extrinsic, start, mean, P, d, *rest)
        block = np.r_[0, 0, 0, np.repeat(np.arange(1, 1 + (d - 3) // 2), 2)]
        P[:d, :d] *= block[:, None] == block
        return status

    return update


def scaled(real):
    def estimate(self):
        mean, P = real(self)
        return PoseEstimate(mean, 0.8 * P)

    return estimate


def in_the_body_frame(real):
    def estimate(self):
        mean, P = real(self)
        B = world_from_body(mean[2])
        return PoseEstimate(mean, B.T @ P @ B)

    return estimate


def half_the_noise(real):
    def increment(self, frame):
        mean, covariance = real(self, frame)
        half = 0.5 * covariance
        return Increment(mean, half)

    return increment


ESTIMATE = "ekf.filter.Filter.estimate"
INCREMENT = "data.inputs.Inputs.increment"
AUGMENT = "ekf.kernels.augment"
HALVED = "process noise halved"

FAULTS = (
    Fault(1, "bearing innovation not wrapped", LOCALIZER_NEES, with_innovate(unwrapped), match="overconfident"),
    Fault(2, "prediction with G'PG", LOCALIZER_NEES, replaced("ekf.kernels.predict", jacobian_on_the_wrong_side)),
    Fault(3, "new landmark without cross-covariance", AS_CERTAIN, replaced(AUGMENT, no_cross_covariance)),
    Fault(4, "gain from the covariance before the prediction", LOCALIZER_NEES, gain_before_the_prediction),
    Fault(4, "Jacobian of the frame's first observation for all", LOCALIZER_NEES, jacobian_of_the_first_in_the_frame),
    Fault(9, "body-frame covariance for world-frame", LOCALIZER_NEES, replaced(ESTIMATE, in_the_body_frame),
          match="overconfident"),
    Fault(12, "block-diagonal covariance", AS_CERTAIN, replaced("ekf.updates.of_frame", block_diagonal)),
    Fault(None, "covariance times 0.8", LOCALIZER_NEES, replaced(ESTIMATE, scaled), match="overconfident"),
    Fault(None, HALVED, LOCALIZER_NEES, replaced(INCREMENT, half_the_noise), match="overconfident"),
    Fault(None, HALVED, LOCALIZER_NIS, replaced(INCREMENT, half_the_noise)),
    Fault(None, HALVED, LOCALIZER_WHITENESS, replaced(INCREMENT, half_the_noise), match="correlated"),
    Fault(None, "Jacobian of the first observation", LOCALIZER_NEES, jacobian_of_the_first_sighting,
          match="overconfident"),
)  # fmt: skip

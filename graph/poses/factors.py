"""Relative poses between key poses as gtsam takes them."""

from __future__ import annotations

import gtsam
import numpy as np

from data.errors import DataError
from data.se2 import Array
from graph.factors import SINGULAR, noise, root_information


def roots_at_end(relative: Array, covariance: Array, what: str) -> tuple[Array, float]:
    """Roots (n, 3, 3) of the information of relative poses (n, 3), at their ends, and the smallest pivot.

    Covariances (n, 3, 3) are of the additive error in the frame the relative pose starts from; at the end, where gtsam
    has it, the error is that turned back by the relative heading. Raises DataError for a singular one; `what` names it.
    """
    c, s = np.cos(relative[:, 2]), np.sin(relative[:, 2])
    B = np.zeros((len(relative), 3, 3))
    B[:, 0, 0], B[:, 0, 1], B[:, 1, 0], B[:, 1, 1], B[:, 2, 2] = c, -s, s, c, 1.0
    roots, pivot = root_information(B.transpose(0, 2, 1) @ covariance @ B)
    bad = np.flatnonzero(~(pivot > SINGULAR))
    if len(bad):
        number = f", number {bad[0]}" if len(relative) > 1 else ""
        raise DataError(
            f"{what}{number}: its covariance is singular (variance {pivot[bad[0]]:.3g} in some direction); "
            "a smoother needs its inverse"
        )
    return roots, float(pivot.min(initial=np.inf))


def relative_noise(relative: Array, covariance: Array, what: str) -> tuple[list[gtsam.noiseModel.Gaussian], float]:
    """The same as noise models, and the smallest pivot."""
    roots, pivot = roots_at_end(relative, covariance, what)
    return [noise.Gaussian.SqrtInformation(root) for root in roots], pivot

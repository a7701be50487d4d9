"""Proper scores of a Gaussian pose belief: accuracy and consistency in one number, smaller is better.

The expectation of a proper score is smallest for the true distribution of the errors (Gneiting & Raftery, Strictly
Proper Scoring Rules, Prediction, and Estimation, JASA 102, 2007). Errors are in the world frame, heading wrapped.
"""

import math

import numpy as np
from scipy import special

from data import se2
from data.se2 import Array, BoolArray
from eval.referee.consistency import correlations, squares

LEVELS = tuple(2**n for n in range(5, 13))  # numbers of directions of half a turn
TOLERANCE = 1e-10  # relative change of the energy score that ends the refinement
CHUNK_OF_ROWS = 50


def log_score(error: Array, covariance: Array) -> Array:
    """Negative log density [nats] (N,) of errors (N, k) under N(0, P), P (N, k, k): (e' P^-1 e + log det 2 pi P) / 2.
    Gneiting & Raftery, section 4.1 (Good 1952). P must be invertible; a row with NaN is NaN.
    """
    result = np.full(len(error), np.nan)
    rows = _known(error, covariance)
    correlation, sigma = correlations(covariance[rows])  # the correlation matrix makes accuracy independent of units
    volume = np.linalg.slogdet(correlation)[1] + 2.0 * np.log(sigma).sum(axis=1)
    result[rows] = 0.5 * (squares(error[rows] / sigma, correlation) + volume + error.shape[1] * math.log(2.0 * math.pi))
    return result


def crps(error: Array, sigma: Array) -> Array:
    """Continuous ranked probability score, in the error's unit, of errors under N(0, sigma²); any shapes.

    sigma (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)), z = error / sigma (Gneiting & Raftery, section 4.2, after
    equation 20). A heading is treated as a number on the line, for sigma well below pi.
    """
    z = error / sigma
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    return np.asarray(sigma * (z * special.erf(z / math.sqrt(2.0)) + 2.0 * density - 1.0 / math.sqrt(math.pi)))


def energy_score(error: Array, covariance: Array) -> Array:
    """Energy score [m] (N,) of errors y (N, 2) under N(0, P), P (N, 2, 2): E|X - y| - E|X - X'| / 2.

    Gneiting & Raftery, equation 22. The length of a planar vector v is a quarter of the integral of |u(a)' v| over all
    directions u(a), so the score is pi/2 times the average CRPS of the projections u'y under N(0, u'P u). The trapezoid
    rule converges exponentially. Directions are refined until the score changes by less than a tolerance.
    """
    result = np.full(len(error), np.nan)
    rows = np.flatnonzero(_known(error, covariance))
    for first in range(0, len(rows), CHUNK_OF_ROWS):
        part = rows[first : first + CHUNK_OF_ROWS]
        for nodes in LEVELS:
            angle = np.arange(nodes) * (math.pi / nodes)
            u = np.stack([np.cos(angle), np.sin(angle)])
            sigma = np.sqrt(np.einsum("ia,nij,ja->na", u, covariance[part], u, optimize=True))
            score = crps(error[part] @ u, sigma) @ np.full(nodes, 0.5 * math.pi / nodes)
            done = np.abs(score - result[part]) <= TOLERANCE * score
            result[part] = score
            part = part[~done]
            if not len(part):
                break
    return result


def _known(error: Array, covariance: Array) -> BoolArray:
    return np.asarray(np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))


def mean_scores(pose: Array, covariance: Array, truth: Array, scored: BoolArray) -> dict[str, float]:
    """Means by column of metrics.csv over frames `scored` (N,), with truth and invertible covariance; empty: none."""
    if not scored.any():
        return {}
    error, P = se2.pose_error(pose[scored], truth[scored]), covariance[scored]
    each = crps(error, np.sqrt(np.einsum("nii->ni", P))).mean(axis=0)
    return {
        "log_score": float(log_score(error, P).mean()), "crps_x_m": float(each[0]), "crps_y_m": float(each[1]),
        "crps_heading_rad": float(each[2]), "energy_score_m": float(energy_score(error[:, :2], P[:, :2, :2]).mean()),
    }  # fmt: skip

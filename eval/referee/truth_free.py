"""Consistency statistics of one log that need no truth.

If all models are right, the filter's error is the smoother's plus an uncorrelated part, so their difference
d = x_f - x_s has covariance P_f - P_s (McReynolds' filter-smoother consistency test; Wright, Woodburn, Truong and
Chuba, Adv. Astronautical Sciences 130, 2008).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from scipy import special

from data import se2
from data.inputs import Inputs
from data.motion.systematic import corrected_inputs
from data.result import Run, Trajectory
from data.se2 import Array, BoolArray
from eval.referee import effects, residuals, sources
from eval.referee.consistency import correlations, gated, lag1_correlation
from eval.referee.score import nis_of
from eval.referee.sources import SourceScore, key_of, score_source, sources_of

SHARE = 0.01  # least reduction of the filter's variance by later data, as a share, in a direction that is compared
TOLERANCE = 1e-6  # rounding of the eigenvalues of P_f - P_s, as a share of P_f
SINGULAR = 1e-11  # smallest eigenvalue of the correlation matrix of a filter that is compared
LARGEST = "largest_"  # how statistics begin that are the largest NIS among the fixes, or closures, of a source
COORDINATES = ("x", "y", "theta")
Key = tuple[str, str]  # estimator and statistic


class Statistic(NamedTuple):
    """A statistic with its expected value (NaN: unknown), standard error (NaN) and frame (-1)."""

    value: float
    expected: float = math.nan
    se: float = math.nan
    frame: int = -1

    @property
    def off(self) -> float:
        """Standard errors from what is expected; NaN: unknown."""
        return (self.value - self.expected) / self.se if self.se > 0.0 and math.isfinite(self.expected) else math.nan


@dataclass(frozen=True, eq=False)
class Difference:
    """An online trajectory against a smoothed one, by frame."""

    d: Array  # (N, 3) online minus smoothed, world frame, heading wrapped
    sigma: Array  # (N, 3) root of the diagonal of P_f - P_s; NaN where the reduction is below `SHARE`
    square: Array  # (N,) quadratic form over the compared directions; NaN without any
    dof: Array  # (N,) number of compared directions
    semidefinite: BoolArray  # (N,) whether P_f - P_s is
    comparable: BoolArray  # (N,) whether P_f is regular


def difference(online: Trajectory, smoothed: Trajectory) -> Difference:
    """Difference by frame, over the directions in which P_f - P_s exceeds `SHARE` of P_f."""
    d = se2.pose_error(online.pose, smoothed.pose)
    P, D = online.covariance, online.covariance - smoothed.covariance
    variance = np.einsum("nii->ni", P)
    finite = np.isfinite(d).all(axis=1) & np.isfinite(D).all(axis=(1, 2)) & (variance > 0.0).all(axis=1)
    n = len(d)
    lam, square, dof = np.full((n, 3), np.nan), np.full(n, np.nan), np.zeros(n)
    rows = np.flatnonzero(finite)
    correlation, scale = correlations(P[rows])
    size, axes = np.linalg.eigh(correlation)
    sound = size[:, 0] > SINGULAR
    rows, root = rows[sound], axes[sound] / np.sqrt(size[sound])[:, None, :]
    white = root / scale[sound, :, None]  # where P_f is the identity, the eigenvalues of P_f - P_s are shares of P_f
    shares, turned = np.linalg.eigh(white.transpose(0, 2, 1) @ D[rows] @ white)
    w = np.einsum("nji,njk,nk->ni", turned, white.transpose(0, 2, 1), d[rows])
    compared = shares > SHARE
    lam[rows], dof[rows] = shares, compared.sum(axis=1)
    square[rows] = np.sum(np.where(compared, w**2 / np.where(compared, shares, 1.0), 0.0), axis=1)
    square[dof == 0] = np.nan
    left = np.einsum("nii->ni", D)
    sigma = np.sqrt(np.where(finite[:, None] & (left > SHARE * variance), left, np.nan))
    comparable = np.isfinite(lam[:, 0])
    return Difference(d, sigma, square, dof, comparable & (lam[:, 0] >= -TOLERANCE), comparable)


def regular(covariance: Array) -> BoolArray:
    """Which covariances (n, 3, 3) are regular."""
    return np.asarray(np.linalg.eigvalsh(correlations(covariance)[0])[:, 0] > SINGULAR)


def filter_smoother(found: Difference, prefix: str = "filter_smoother") -> dict[str, Statistic]:
    """Mean and median of the quadratic form, share semidefinite, and d in stated sigmas."""
    result: dict[str, Statistic] = {}
    here = np.isfinite(found.square)
    if here.any():
        dof = found.dof[here]
        result["mean"] = Statistic(float(found.square[here].mean()), float(dof.mean()))
        result["median"] = Statistic(float(np.median(found.square[here])), _median(dof))
    if found.comparable.any():
        result["semidefinite"] = Statistic(float(found.semidefinite[found.comparable].mean()), 1.0)
    in_sigmas = found.d / found.sigma
    for i, name in enumerate(COORDINATES):
        u = in_sigmas[np.isfinite(in_sigmas[:, i]), i]
        if len(u):
            result[f"rms_{name}"] = Statistic(math.sqrt(float(np.mean(u**2))), 1.0)
            result[f"inside_{name}"] = Statistic(float(np.mean(np.abs(u) <= 3.0)), 1.0 - 2.0 * float(special.ndtr(-3)))
    if np.isfinite(in_sigmas).any():
        frame, axis = np.unravel_index(np.nanargmax(np.abs(in_sigmas)), in_sigmas.shape)
        result["largest"] = Statistic(float(abs(in_sigmas[frame, axis])), frame=int(frame))
    return {f"{prefix}_{name}": m for name, m in result.items()}


def _median(dof: Array) -> float:
    """Median of a mixture of chi-square variables with the frames' degrees of freedom."""
    kinds, counts = np.unique(dof, return_counts=True)
    share = counts / counts.sum()
    return float(scipy.optimize.brentq(lambda x: float(share @ special.chdtr(kinds, x)) - 0.5, 1e-9, 10.0))


def _nis(run: Run, phase: str) -> dict[str, Statistic]:
    total = nis_of(run, phase)
    return {"nis": Statistic(total[0] / total[1], gated(run, phase)[0])} if total is not None and total[1] > 0 else {}


def of_online(run: Run, smoother: Run | None, inputs: Inputs) -> dict[str, Statistic]:
    """Statistics of an online estimator; `smoother`: batch under the same decisions, if it ran."""
    result: dict[str, Statistic] = {}
    i = run.innovations
    if i is not None:
        result |= _nis(run, "online")
        r, error = lag1_correlation(i.white, inputs.observations.frame, run.decisions)
        if math.isfinite(r):
            result["innovation_lag1"] = Statistic(r, 0.0, error)
    for source in sources_of(inputs):
        result |= _of_source(score_source(run, source, "online"), key_of(source))
    if run.online is not None and smoother is not None and smoother.final is not None:
        result |= filter_smoother(difference(run.online, smoother.final))
    if run.online is not None and run.final is not None:
        result |= filter_smoother(difference(run.online, run.final), "own_smoother")
    return result


def _of_source(scored: SourceScore, key: str) -> dict[str, Statistic]:
    """NIS, correlation and largest innovation of the fixes or closures of a source, rejected ones included."""
    found: dict[str, Statistic] = {}
    if scored.nis_dof:
        found[f"nis_{key}"] = Statistic(scored.nis_mean, scored.expected)
    if math.isfinite(scored.lag1):
        found[f"innovation_{key}_lag1"] = Statistic(scored.lag1, 0.0, scored.lag1_se)
    if scored.formed:
        median = float(special.chdtri(scored.dof, -math.expm1(math.log(0.5) / scored.formed)))
        sigmas = -float(special.ndtri_exp(scored.log_chance))
        error = (scored.largest - median) / sigmas if sigmas else math.nan
        found[f"{LARGEST}{key}"] = Statistic(scored.largest, median, error)
    return found


def of_smoother(run: Run, inputs: Inputs) -> dict[str, Statistic]:
    """Of a batch smoother, without systematic errors that it estimated: of cost, residuals, slopes of such errors."""
    assert run.final is not None
    path = run.final.pose
    result = _nis(run, "final")
    used = residuals.used_by(run, inputs)
    rest = corrected_inputs(inputs, run.errors_final)
    found = residuals.smoothed_residuals(rest, path, used)
    summaries = residuals.summaries(found, rest, used) | sources.summaries(rest, path, used)
    result |= {n: Statistic(v, 0.0 if n.endswith("_mean") else math.nan) for n, v in summaries.items()}
    slopes = effects.scored(inputs, path, used, run.errors_final).slopes()
    return result | {f"slope_{name}": Statistic(value, 0.0, error) for name, (value, error) in slopes.items()}

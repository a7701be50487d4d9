"""Which assumption is violated: explanations of a log's statistics, compared with its bootstrap replicates ("twins").

Explanations are compared by their gain in log-likelihood: a systematic error by its score (z^2 / 2), a noise of F times
the stated variance by dof (F - 1 - ln F) / 2, with dof from the spread among twins.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from data.se2 import Array
from eval.referee.effects import Scored

MOST = 4  # largest number of systematic errors
AS_WELL = 0.97  # correlation of scores above which two systematic errors cannot be distinguished
NEES_BAND = (0.8, 1.25)  # accepted NEES per dof on twins: 10 % of a sigma
NIS_BAND = (0.95, 1.05)
"""Accepted NIS, as a share of the expected one, on twins: consistent filters (110 logs of arena, corridor and circle,
SLAM) have 0.988 to 1.032; one with half the odometry's covariance 1.06."""
SURE = 0.001  # p value below which the mean NEES or NIS of the twins is rejected
WRONG_PAIRINGS = 0.01  # share of wrong pairings above which the decisions are to blame: one in a hundred ruins a path
NOISE, ASSOCIATIONS, ESTIMATOR, NOTHING = "noise", "associations", "estimator", "nothing"
UNLISTED = "unlisted"  # the cause where no explanation removes what stands out
CONTRADICTED = "input"  # the cause where parts of the log contradict each other: its conventions are not those stated
UNTELLABLE = "unknown"  # the cause where the solution that the twins are drawn around is itself broken


@dataclass(frozen=True)
class Finding:
    """One explanation."""

    cause: str  # `NOISE`, `ASSOCIATIONS` or `ESTIMATOR`
    kind: str  # `systematic`, `sigma`, `tails`, `pairings`, `decisions`, `linearization` or `innovations`
    name: str  # of the systematic error, component or estimator
    size: float  # Systematic error, factor of the stated sigma, observations, or NEES per dof (NIS: share) on twins
    error: float = math.nan  # standard error of the size
    gain: float = math.nan  # of log-likelihood
    other: tuple[str, ...] = ()  # systematic errors that cannot be distinguished from it
    parts: "tuple[Finding, ...]" = ()  # of a vector of systematic errors
    frames: tuple[tuple[int, int], ...] = ()  # first and last of each jump, burst, or change of the noise
    outliers: int = 0
    unit: str = ""  # of size and error, once they are a person's (`eval.judgement.causes`)

    @property
    def said(self) -> str:
        """What tells it from others."""
        return f"{self.kind} {self.name}"

    @property
    def sizes(self) -> dict[str, float]:
        """Sizes by systematic error, of a vector those of its parts."""
        return {n: size for part in self.parts for n, size in part.sizes.items()} or {self.name: self.size}


def systematic_errors(scored: Scored, factors: Mapping[str, float], limit: float, most: int = MOST) -> list[Finding]:
    """At most `most` systematic errors by forward selection, with sizes; scores over `factors` of their sigmas."""
    # `<component>_<regressor>`, where that of odometry has two words
    components = ("_".join(n.split("_")[: 1 + n.startswith("odometry")]) for n in scored.names)
    weight = np.array([1.0 / max(1.0, factors.get(component, 1.0)) for component in components])
    chosen, gains = list[int](), list[float]()
    for _ in range(most):
        left = scored.score.given(np.array(chosen, np.int64)) if chosen else scored.score
        z = left.sigmas * weight
        best = int(np.argmax(np.abs(z))) if len(z) else -1
        if best < 0 or not abs(z[best]) > limit:
            break
        chosen.append(best)
        gains.append(0.5 * float(z[best]) ** 2)
    if not chosen:
        return []
    sizes, errors = scored.together(np.array(chosen, np.int64))
    information = scored.score.information
    root, found = np.sqrt(np.diag(information)), []
    for i, size, error, gain in zip(chosen, sizes.tolist(), errors.tolist(), gains, strict=True):
        correlation = np.divide(information[i], root[i] * root, out=np.zeros(len(root)), where=root > 0.0)
        like = tuple(n for j, n in enumerate(scored.names) if j != i and abs(correlation[j]) > AS_WELL)
        found.append(Finding(NOISE, "systematic", scored.names[i], size, error, gain, like))
    return found


def of_variance(squares: ArrayLike, dof: ArrayLike) -> Array:
    """Gain of a variance of its own, (F - 1 - ln F) dof / 2, with F the mean square over the expected one."""
    F = np.maximum(squares, 1e-12)
    return np.asarray(0.5 * np.asarray(dof) * (F - 1.0 - np.log(F)))


def decision_errors(counts: Mapping[str, Sequence[tuple[int, int, int, int]]]) -> list[Finding]:
    """Estimators with too many wrong pairings even on twins; `counts`: tp, tn, fp, fn of each twin, by estimator."""
    found = []
    for estimator, twins in counts.items():
        tp, tn, fp, fn = np.sum(np.array(twins).reshape(-1, 4), axis=0).tolist()
        if fp > WRONG_PAIRINGS * (tp + tn + fp + fn):
            found.append(Finding(ASSOCIATIONS, "decisions", estimator, fp / (tp + tn + fp + fn)))
    return found


def estimator_errors(nees: Mapping[tuple[str, str], Sequence[float]]) -> list[Finding]:
    """Estimators with a wrong NEES on the twins, whose noise is as stated: linearization, or the estimator itself."""
    return _off("linearization", [(e, np.asarray(v) / 3) for (e, _), v in nees.items()], NEES_BAND)


def innovation_errors(nis: Mapping[str, Sequence[float]]) -> list[Finding]:
    """Estimators with wrong innovations on the twins; `nis`: per dof, as a share of the expected one."""
    return _off("innovations", [(e, np.asarray(v)) for e, v in nis.items()], NIS_BAND)


def _off(kind: str, shares: Sequence[tuple[str, Array]], band: tuple[float, float]) -> list[Finding]:
    """Estimators whose mean share of the expected value over the twins is outside the band (t test)."""
    found = []
    for estimator, values in shares:
        known = values[np.isfinite(values)]
        if len(known) < 2:
            continue
        mean, error = float(known.mean()), float(known.std(ddof=1)) / math.sqrt(len(known))
        p = 2.0 * float(special.stdtr(len(known) - 1, -abs(mean - 1.0) / error)) if error > 0.0 else 0.0
        if p < SURE and not band[0] <= mean <= band[1]:
            found.append(Finding(ESTIMATOR, kind, estimator, mean, error))
    return found

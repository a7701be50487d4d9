"""Whose fault: what a log's statistics ask for, beside its twins'. Pure functions on what was measured.

Explanations are compared by the log-likelihood that each would gain: a systematic error by its score (z^2 / 2), a noise
that is F times as large in variance as stated by dof (F - 1 - ln F) / 2, its dof from the spread among twins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from data.se2 import Array
from eval.referee.effects import Scored

MOST = 4
"""Systematic errors that are told apart at most; one more explains what the others left."""
AS_WELL = 0.97
"""Another systematic error whose score correlates with the chosen one's by more cannot be told from it."""
NEES_BAND = (0.8, 1.25)
"""Share of its degrees of freedom that an estimator's NEES on twins may be without a word: 10 % of a sigma."""
NIS_BAND = (0.95, 1.05)
"""The same of its NIS, which many more degrees of freedom tell: sound filters (some 110 logs of arena, corridor and
circle, SLAM) have 0.988 to 1.032 on the twins of a log; one that believes half the odometry's covariance 1.06."""
SURE = 0.001
"""P value below which the mean NEES or NIS of the twins is off."""
LEAST_FACTOR = 1.05
"""A noise stated within 5 % of what it is is stated right."""
THRESHOLD = 3.0
"""sigma. Least size of a systematic error or of a wrong noise that is named, unless the twins themselves go further."""
WRONG_PAIRINGS = 0.01
"""Share of wrong pairings from which the decisions are to blame: one in a hundred ruins a path (docs/results.md)."""
POWER = 0.9
NOISE, ASSOCIATIONS, ESTIMATOR, NOTHING = "noise", "associations", "estimator", "nothing"


@dataclass(frozen=True)
class Finding:
    """One explanation.

    Attributes:
        cause: `NOISE`, `ASSOCIATIONS` or `ESTIMATOR`.
        kind: `systematic`, `sigma`, `tails`, `pairings`, `decisions`, `linearization` or `innovations`.
        name: of the systematic error, of the component, or of the estimator.
        size, error: of the systematic error with its standard error; factor of the stated sigma; number of readings;
            NEES per dof on twins (`innovations`: NIS per dof, as a share of what is expected).
        gain: of log-likelihood; NaN where there is none.
        other: systematic errors that this log cannot tell from it.
    """

    cause: str
    kind: str
    name: str
    size: float
    error: float = math.nan
    gain: float = math.nan
    other: tuple[str, ...] = ()


def component_of(name: str) -> str:
    """The component that a systematic error `<component>_<regressor>` is of."""
    return "_".join(name.split("_")[:2]) if name.startswith("odometry") else name.split("_")[0]


def systematic_errors(
    scored: Scored, factors: Mapping[str, float], threshold: float, most: int = MOST
) -> list[Finding]:
    """Systematic errors found one after the other, each beside those before; all sizes as they are together.

    `factors`: of the stated sigma of each component, by which a score counts less; `threshold`: in sigmas; `most`: no
    more than that.
    """
    weight = np.array([1.0 / max(1.0, factors.get(component_of(n), 1.0)) for n in scored.names])
    chosen: list[int] = []
    gains: list[float] = []
    for _ in range(most):
        left = scored.score.given(np.array(chosen, np.int64)) if chosen else scored.score
        z = left.sigmas * weight
        best = int(np.argmax(np.abs(z))) if len(z) else -1
        if best < 0 or not abs(z[best]) > threshold:
            break
        chosen.append(best)
        gains.append(0.5 * float(z[best]) ** 2)
    if not chosen:
        return []
    sizes, errors = scored.together(np.array(chosen, np.int64))
    return [
        Finding(NOISE, "systematic", scored.names[i], float(s), float(e), g, _like(scored, i))
        for i, s, e, g in zip(chosen, sizes, errors, gains, strict=True)
    ]


def _like(scored: Scored, i: int) -> tuple[str, ...]:
    """Systematic errors whose score says the same as that of error i."""
    information = scored.score.information
    root = np.sqrt(np.diag(information))
    with_own = np.divide(information[i], root[i] * root, out=np.zeros(len(root)), where=root > 0.0)
    return tuple(n for j, n in enumerate(scored.names) if j != i and abs(with_own[j]) > AS_WELL)


def factors_of(typical: Mapping[str, float], twins: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Factor of the stated sigma of each component: its typical residual over that of the twins."""
    result = {}
    for name, value in typical.items():
        usual = _median([t[name] for t in twins if name in t])
        if usual > 0.0:
            result[name] = value / usual
    return result


def noise_errors(factors: Mapping[str, float], twins: Sequence[Mapping[str, float]], threshold: float) -> list[Finding]:
    """Components whose noise is not what is stated, by more than `threshold` standard deviations of their twins."""
    found = []
    for name, factor in factors.items():
        logs = np.log([t[name] for t in twins if t.get(name, 0.0) > 0.0])
        spread = float(np.std(logs)) if len(logs) > 1 else math.nan
        if not (factor > 0.0 and spread > 0.0) or max(factor, 1.0 / factor) < LEAST_FACTOR:
            continue
        if abs(math.log(factor)) > threshold * spread:
            F, dof = factor**2, 0.5 / spread**2
            found.append(Finding(NOISE, "sigma", name, factor, gain=0.5 * dof * (F - 1.0 - math.log(F))))
    return sorted(found, key=lambda f: -f.gain)


def outlier_errors(
    outlying: int, elsewhere: int, twins: Sequence[int], squared_excess: float = math.nan
) -> list[Finding]:
    """Readings that do not fit: wrong pairings if most fit another landmark, else tails of the sensor's noise.

    `twins`: how many do not fit in each twin; as many as in the twins' upper tail (Poisson) are nothing to speak of.
    """
    usual = max(float(np.mean(twins)) if len(twins) else 0.0, 0.1)
    if not float(special.pdtrc(outlying - 1, usual)) < SURE or outlying < 2:
        return []
    found = []
    if 2 * elsewhere >= outlying:
        found.append(Finding(ASSOCIATIONS, "pairings", "readings", elsewhere, gain=squared_excess))
    else:
        found.append(Finding(NOISE, "tails", "readings", outlying, gain=squared_excess))
    return found


def decision_errors(counts: Mapping[str, Sequence[tuple[int, int, int, int]]]) -> list[Finding]:
    """Ways of deciding that pair wrongly even on twins; `counts`: tp, tn, fp, fn of each twin, by estimator.

    More wrong pairings than `WRONG_PAIRINGS` of the decisions are too many for least squares.
    """
    found = []
    for estimator, twins in counts.items():
        tp, tn, fp, fn = np.sum(np.array(twins).reshape(-1, 4), axis=0).tolist()
        if fp > WRONG_PAIRINGS * (tp + tn + fp + fn):
            found.append(Finding(ASSOCIATIONS, "decisions", estimator, fp / (tp + tn + fp + fn)))
    return found


def estimator_errors(nees: Mapping[tuple[str, str], Sequence[float]], dof: int = 3) -> list[Finding]:
    """Estimators whose NEES on the twins is off: linearization, or the estimator itself, as all else is as stated."""
    return _off("linearization", [(e, np.asarray(v) / dof) for (e, _), v in nees.items()], NEES_BAND)


def innovation_errors(nis: Mapping[str, Sequence[float]]) -> list[Finding]:
    """Estimators whose innovations on the twins are not as they claim; `nis`: per dof, as a share of the expected."""
    return _off("innovations", [(e, np.asarray(v)) for e, v in nis.items()], NIS_BAND)


def _off(kind: str, shares: Sequence[tuple[str, Array]], band: tuple[float, float]) -> list[Finding]:
    """Estimators whose share of what is expected is off by more than the band, on average over the twins (t test)."""
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


def detectable(
    slopes: Mapping[str, Sequence[float]], spreads: Mapping[str, Sequence[float]], critical: float
) -> dict[str, float]:
    """What would have been objected to with a probability of `POWER`: systematic errors, and factors of a sigma.

    `slopes` and `spreads`: of the twins by name; `critical`: what the largest standardized statistic must exceed. A
    residual's spread is taken to grow with the noise as stated, so a factor is what it would have to be at least.
    """
    reach = critical + float(special.ndtri(POWER))
    result = {name: reach * _spread(np.asarray(v)) for name, v in slopes.items()}
    for name, values in spreads.items():
        known = np.asarray(values)
        middle = _median(known.tolist())
        if middle > 0.0:
            result[name] = 1.0 + reach * _spread(known) / middle
    return {name: value for name, value in result.items() if math.isfinite(value)}


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else math.nan


def _spread(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.std(ddof=1)) if len(known) > 1 else math.nan

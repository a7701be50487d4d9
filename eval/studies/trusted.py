"""A log against its twins: p value of every statistic, cause of rejections, and power."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from data.inputs import Inputs
from data.log import Log
from data.motion.systematic import corrected_inputs
from data.notice import Code, Notice, notice
from data.result import Run
from data.se2 import Array, BoolArray
from eval.referee import attribution, battery, effects, residuals, trust
from eval.referee.attribution import ESTIMATOR, NOISE, NOTHING, UNTELLABLE, Finding
from eval.referee.headline import NEES_LIMIT
from eval.referee.plausibility import with_plausibility
from eval.referee.residuals import Used
from eval.referee.result_files import TRUST
from eval.referee.score import frame_of
from eval.referee.trust import Key, Measured
from eval.replay.batch import batch
from eval.studies.sampled import PLAIN, STAND_IN, Sample
from eval.studies.twins import inputs_of, with_noise

COLUMNS = TRUST.names
UNINFORMATIVE = 1e6
"""Factor of the covariance of an observation that is left out, so that its landmark stays determined."""
FEWEST = 19  # least number of twins for a family-wise level of 5 %


@dataclass(frozen=True)
class Row:
    """A line of trust.csv, without log, task and association."""

    estimator: str
    statistic: str
    measured: Measured
    expected: float
    twins: int
    p: float
    p_family: float


@dataclass(frozen=True)
class Blame:
    """Diagnosis of a log."""

    cause: str  # `NOISE`, `ASSOCIATIONS`, `ESTIMATOR`, `NOTHING` or `UNTELLABLE`
    findings: tuple[Finding, ...]  # evidence for it and for other causes, the strongest first
    objected: tuple[Key, ...]  # statistics rejected family-wise; `tested`: their number in all
    tested: int
    p: float  # the smallest family-wise p value
    detectable: dict[str, float]  # sizes detectable with a power of 90 %, by name


@dataclass(frozen=True, eq=False)
class Trust:
    """One log with one association method: its statistics, those of its twins, and the diagnosis."""

    log: str
    task: str
    association: str
    real: Sample
    twins: tuple[Sample, ...]
    rows: tuple[Row, ...]  # of trust.csv
    blame: Blame | None = None  # None without enough twins
    notices: tuple[Notice, ...] = ()  # why something is missing
    after: Trust | None = None  # the same log after the corrections `done`, if tried (`eval.studies.twins`)
    done: Mapping[str, float] = field(default_factory=dict)  # corrections by name


def judged(log: Log, task: str, association: str, real: Sample, twins: Sequence[Sample], smoother: Run | None) -> Trust:
    """P values of all statistics, and the cause; `smoother` as in `sample_of`."""
    keys = list(real.measured)
    values = np.array([real.measured[k].value for k in keys])
    drawn = np.array([[_value(s, k) for k in keys] for s in twins]).reshape(len(twins), len(keys))
    family = battery.family_p(values, drawn)
    rows = []
    for i, (estimator, name) in enumerate(keys):
        m, own = real.measured[estimator, name], drawn[:, i]
        known = own[np.isfinite(own)]
        expected = m.expected if math.isfinite(m.expected) or not len(known) else float(np.median(known))
        p_family = float(family[i]) if len(known) else math.nan
        rows.append(Row(estimator, name, m, expected, len(known), battery.rank_p(m.value, own), p_family))
    notices = _failures(log, real, twins)
    if smoother is not None and smoother.estimator == STAND_IN:
        notices += (notice(Code.STOOD_IN, stand_in=STAND_IN).about(estimator=PLAIN),)
    made = Trust(log.name, task, association, real, tuple(twins), tuple(rows), notices=notices)
    if len(twins) < FEWEST or smoother is None or smoother.flaw is not None:
        return made
    return replace(made, blame=_blame(made, inputs_of(log, task, association), smoother, drawn))


def is_exact(covariance: Array) -> bool:
    """Whether a covariance (3, 3) is singular."""
    return not trust.regular(covariance[None])[0]


def _value(sample: Sample, key: Key) -> float:
    """A statistic of a twin, NaN if it has none; a robust stand-in is compared with the twins' own smoother."""
    if key not in sample.measured and key[0] == STAND_IN:
        key = (PLAIN, key[1])
    return sample.measured[key].value if key in sample.measured else math.nan


def _failures(log: Log, real: Sample, twins: Sequence[Sample]) -> tuple[Notice, ...]:
    found = []
    if is_exact(log.recorded.prior.covariance):
        found.append(notice(Code.EXACT_PRIOR))
    found += [notice(Code.NOT_MEASURED, why=why).about(estimator=name) for name, why in real.failures.items()]
    for name in dict.fromkeys(name for s in twins for name in s.failures):
        failed = sum(name in s.failures for s in twins)
        found.append(notice(Code.NOT_MEASURED_ON_TWINS, failed=failed, twins=len(twins)).about(estimator=name))
    return tuple(found)


def _blame(made: Trust, inputs: Inputs, smoother: Run, drawn: Array) -> Blame:
    tested = [r for r in made.rows if math.isfinite(r.p_family)]
    objected = tuple((r.estimator, r.statistic) for r in tested if r.p_family <= battery.LEVEL)
    p = min((r.p_family for r in tested), default=math.nan)
    threshold = max(attribution.THRESHOLD, _largest_score(made.twins))
    findings: list[Finding] = []
    if objected:
        findings = _noise(made, inputs, smoother, threshold)
        findings.sort(key=lambda f: -f.gain)
    mispaired: list[Finding] = []
    if made.association != "known":
        names = dict.fromkeys(name for s in made.twins for name in s.counts)
        counts = {n: [s.counts[n] for s in made.twins if n in s.counts] for n in names}
        mispaired = attribution.decision_errors(counts)
    findings += mispaired + _estimators(made.twins)
    cause = NOTHING
    if objected and _broken(made.twins):
        cause = UNTELLABLE
    elif mispaired and not objected:
        pass  # a method's errors on this geometry with everything as stated: no finding about the log
    elif findings:
        cause = findings[0].cause
    elif objected:
        # no named cause: rejections of the smoother's residuals are due to the log, others to the estimator
        cause = NOISE if any(e == smoother.estimator for e, _ in objected) else ESTIMATOR
    return Blame(cause, tuple(findings), objected, len(tested), p, _detectable(made, drawn))


def _broken(twins: Sequence[Sample]) -> bool:
    """Whether the smoother is lost on most twins, though their noise is as stated: the solution itself is broken."""
    nees = [s.nees[PLAIN, "final"] for s in twins if (PLAIN, "final") in s.nees]
    return bool(nees) and float(np.median(nees)) > NEES_LIMIT


def _estimators(twins: Sequence[Sample]) -> list[Finding]:
    """Estimators that are inconsistent on the twins, in NEES, or else in NIS."""
    nees = {
        key: [s.nees[key] for s in twins if key in s.nees] for key in dict.fromkeys(k for s in twins for k in s.nees)
    }
    found = attribution.estimator_errors(nees)
    nis: dict[str, list[float]] = {}
    for m, estimator in ((s.measured[k], k[0]) for s in twins for k in s.measured if k[1] == "nis"):
        nis.setdefault(estimator, []).append(m.value / m.expected)
    convicted = {f.name for f in found}
    return found + [f for f in attribution.innovation_errors(nis) if f.name not in convicted]


def _largest_score(twins: Sequence[Sample]) -> float:
    """95 % quantile over the twins of the largest slope, in standard errors."""
    largest = [
        max((abs(m.value / m.se) for (_, n), m in s.measured.items() if n.startswith("slope_")), default=0.0)
        for s in twins
    ]
    return float(np.quantile(largest, 1.0 - battery.LEVEL))


def _noise(made: Trust, inputs: Inputs, smoother: Run, threshold: float) -> list[Finding]:
    """Findings about noise and pairings: outliers, then systematic errors, then noise.

    Each is tested without the former ones: an outlier bends path and map, and a systematic error adds to the residuals.
    Outliers are counted again without systematic errors.
    """
    typical = [s.typical for s in made.twins]
    outliers, less, fitted, left_out = _outliers(made, inputs, smoother)
    used = residuals.used_by(fitted, less)
    kept, path = _without(used, left_out), _path(fitted)
    factors = attribution.factors_of(_typical(less, fitted, kept), typical)
    scored = effects.scored(less, path, kept, fitted.errors_final)
    systematic = attribution.systematic_errors(scored, factors, threshold)
    if systematic:
        sizes = {f.name: f.size for f in systematic}
        corrected = effects.without(less, path, used, sizes)
        again = with_plausibility(batch("batch", corrected, _as_front(fitted)), corrected)
        if again.flaw is None:
            outliers, less, fitted, left_out = _outliers(made, effects.without(inputs, path, used, sizes), again)
            kept = _without(residuals.used_by(fitted, less), left_out)
            factors = attribution.factors_of(_typical(less, fitted, kept), typical)
    return outliers + systematic + attribution.noise_errors(factors, typical, threshold)


def _outliers(made: Trust, inputs: Inputs, smoother: Run) -> tuple[list[Finding], Inputs, Run, BoolArray]:
    """Outliers, if there are more than in twins; inputs and smoother without them, and which observations (M,).

    The Gaussian smoother bends to them: in the arena, 10 wrong labels leave 80 outliers. So they are taken from a
    robust smoother, in sigmas of its typical noise.
    """
    nothing = np.zeros(len(inputs.observations.frame), bool)
    usual = [s.outlying for s in made.twins]
    if not attribution.outlier_errors(made.real.outlying, 0, usual):
        return [], inputs, smoother, nothing
    robust = with_plausibility(batch("batch-cauchy", inputs, _as_front(smoother)), inputs)
    if robust.flaw is not None:
        robust = smoother
    path, used = _path(robust), residuals.used_by(robust, inputs)
    factors = attribution.factors_of(_typical(inputs, robust, used), [s.typical for s in made.twins])
    rest = corrected_inputs(inputs, robust.errors_final)
    scaled = with_noise(rest, {name: max(1.0, factors.get(name, 1.0)) for name in residuals.COMPONENTS[3:]})
    found = residuals.smoothed_residuals(scaled, path, used)
    outlying, elsewhere, excess = residuals.misfits(scaled, path, used, found)
    findings = attribution.outlier_errors(outlying, elsewhere, usual, excess)
    if not findings:
        return [], inputs, smoother, nothing
    left_out: BoolArray = found.squared > residuals.OUTLYING
    o = inputs.observations
    R = np.where(left_out[:, None, None], UNINFORMATIVE * o.R, o.R)
    less = replace(inputs, observations=replace(o, R=R))
    again = with_plausibility(batch("batch", less, _as_front(robust)), less)
    return (findings, less, again, left_out) if again.flaw is None else (findings, inputs, smoother, nothing)


def _typical(inputs: Inputs, smoother: Run, used: Used) -> dict[str, float]:
    rest = corrected_inputs(inputs, smoother.errors_final)
    return residuals.typical(residuals.smoothed_residuals(rest, _path(smoother), used))


def _without(used: Used, left_out: BoolArray) -> Used:
    return replace(used, number=np.where(left_out, -1, used.number))


def _path(smoother: Run) -> Array:
    assert smoother.final is not None
    return smoother.final.pose


def _as_front(smoother: Run) -> Run:
    return replace(smoother, online=smoother.final)


def _detectable(made: Trust, drawn: Array) -> dict[str, float]:
    names = [n for _, n in made.real.measured]
    of = {n: drawn[:, i] for i, n in enumerate(names)}
    slopes = {n.removeprefix("slope_"): v.tolist() for n, v in of.items() if n.startswith("slope_")}
    spreads = {n: v.tolist() for n, v in of.items() if n.endswith("_spread")}
    return attribution.detectable(slopes, spreads, battery.critical(drawn))


def trust_table(all_trust: Sequence[Trust]) -> pd.DataFrame:
    """The table trust.csv."""
    rows = []
    for t in all_trust:
        for r in t.rows:
            m = r.measured
            who = {"log": t.log, "task": t.task, "estimator": r.estimator, "association": t.association}
            statistic = {
                "statistic": r.statistic,
                "value": m.value,
                "se": m.se,
                "frame": m.frame if m.frame >= 0 else None,
            }
            tested = {"expected": r.expected, "twins": r.twins, "p": r.p, "p_family": r.p_family}
            rows.append(who | statistic | tested)
    return frame_of(rows, COLUMNS)

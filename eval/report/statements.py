"""Sentences that turn the referee's numbers into statements: what may be said, and no more.

The rules are those of the consistency tests: innovations of one run can be tested, the NEES of one run only describes,
a verdict on NEES needs many independent runs, and being inside bounds is no proof.
"""

from __future__ import annotations

import math

from data.terminal.words import counted
from eval.page.numbers import number
from eval.referee.consistency import CONSERVATIVE, CONSISTENT, INSIDE_3SIGMA, OVERCONFIDENT, TOO_FEW
from eval.replay.plausible import IMPLAUSIBLE
from eval.replay.settings import Setup


def nis_verdict(nis: float, lower: float, upper: float) -> str:
    """`overconfident`, `conservative` or `consistent` of a NIS per dof against its bounds."""
    return OVERCONFIDENT if nis > upper else CONSERVATIVE if nis < lower else CONSISTENT


def nis_statement(
    nis: float, lower: float, upper: float, *, expected: float = 1.0, rejected: int = 0, known: bool = True
) -> str:
    """What NIS per dof says about a filter, with everything that weakens the test; empty if no innovations were formed.

    `expected` behind the gates; `rejected` observations were gated out or discarded; `known`: the association was
    given, not decided.
    """
    if not all(math.isfinite(v) for v in (nis, lower, upper)):
        return ""
    behind = f"{expected:.3g} behind the gates" if expected < 0.9995 else "1"
    numbers = f"(NIS per dof {number(nis)}, expected {behind}, 95 % bounds {lower:.2f}–{upper:.2f})"
    verdict = nis_verdict(nis, lower, upper)
    text = {
        OVERCONFIDENT: f"innovations larger than claimed {numbers}: {OVERCONFIDENT}",
        CONSERVATIVE: f"innovations smaller than claimed {numbers}: {CONSERVATIVE}",
        CONSISTENT: f"innovations as large as claimed {numbers}: nothing against the filter in this test",
    }[verdict]
    if rejected > 0:
        text += f"; {counted(rejected, 'observation was', 'observations were')} left out"
    if not known:
        text += "; conditional on the association decisions"
    return text


def nees_statement(nees: float, dof: int = 3) -> str:
    """What the mean NEES of one run describes; never a verdict. Empty if it is not known."""
    if not math.isfinite(nees):
        return ""
    text = f"mean NEES {number(nees)} over the run (dof {dof}, so {dof} is expected)"
    scale = math.sqrt(max(nees, 0.0) / dof)
    if nees > 2.0 * dof:
        text += f": errors about {number(scale, 2)} times as large as the covariance claims"
    elif nees < 0.5 * dof:
        text += f": errors about {number(scale, 2)} of what the covariance claims"
    return text + "; a description without verdict, because errors along one run are strongly correlated"


def inside_statement(share: float) -> str:
    """Share of frames inside the 3 sigma ellipse against what a Gaussian gives in the plane; empty if not known."""
    if not math.isfinite(share):
        return ""
    expected = f"a Gaussian in the plane: {100 * INSIDE_3SIGMA:.1f} %"
    return f"{100 * share:.1f} % of positions inside their 3σ ellipse ({expected})"


def verdict_statement(
    mean: float, lower: float, upper: float, dof: int, runs: int, verdict: str, power: float = math.nan
) -> str:
    """A Monte Carlo verdict with its numbers, and how much the test could have seen."""
    if not math.isfinite(lower):
        return f"{verdict} ({counted(runs, 'run')}, dof {dof})"
    interval = f"95 % interval {number(lower)}–{number(upper)}"
    text = f"{verdict}: mean {number(mean)} where {dof} is expected, {interval}, {counted(runs, 'run')}"
    if verdict == TOO_FEW:
        return text + "; too few runs to tell a right covariance from a wrong one"
    if verdict == CONSISTENT and math.isfinite(power):
        text += f"; a covariance claimed at 0.8 of the true one would be noticed with probability {power:.2f}"
    return text


def association_statement(tp: int, tn: int, fp: int, fn: int) -> str:
    """The association outcomes in words."""
    total = tp + tn + fp + fn
    if total == 0:
        return "no observations to decide about"
    share = 100 * (tp + tn) / total
    right = f"of {counted(total, 'observation')} {counted(tp + tn, 'was', 'were')} decided rightly ({share:.1f} %)"
    return f"{right}, {fp} were paired with a wrong landmark, {fn} were not paired though their landmark was in the map"


def gate_sentence(setup: Setup, *, sensed: bool) -> str:
    """Which gate the readings paired by label had to pass; `sensed`: a sensor read the labels of this log."""
    gate = setup.settled(sensed).label_gate
    whose = "a sensor read the labels" if sensed else "no sensor read the labels"
    because = f" (the default where {whose}; `--gate-known` changes it)" if setup.gate_known == "auto" else ""
    if gate is None:
        return f"Readings paired by label pass no gate{because}."
    left = "" if setup.gate_smoothers else " for the filters; the smoothers keep them"
    return f"Readings paired by label are left out beyond the {gate:g} quantile of their innovation{left}{because}."


def failure_statement(log: str, task: str, estimator: str, association: str, status: str, frame: int, why: str) -> str:
    """Where and why an estimator stopped, or from where on it is not to be believed."""
    where = "from" if status == IMPLAUSIBLE else "stopped at"
    return f"{log}, {task}: {estimator} with association {association} is {status}, {where} frame {frame}: {why}"

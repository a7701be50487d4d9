"""Two minima of one least-squares problem: who is in the better one, and how far apart the paths are."""

from __future__ import annotations

import numpy as np

from data.result import Run
from eval.page.numbers import number
from eval.referee.errors import position_distance, rms
from eval.referee.score import Trial

STEP = 1e-3
"""Sigma: the largest Newton step that is left where an optimizer has converged. In each of n components it leaves a
cost of STEP^2 at most; n is about the number of degrees of freedom, and so is the cost: STEP^2 of it, ..."""
ROUNDING = 1e-2
"""... and this much where the least cost is next to nothing: sums of 10^5 squares, each rounded at 1e-7 of its size."""


def minima_statements(trial: Trial) -> list[str]:
    """A sentence for each pair of `batch` and `isam2` with the same decisions that ended in different minima."""
    found = []
    for batch in trial.runs:
        other = trial.find("isam2", batch.association)
        if batch.estimator == "batch" and other is not None:
            found += [text for text in (two_minima(batch, other),) if text]
    return found


def two_minima(batch: Run, other: Run) -> str:
    """Both costs, the better one, and the distance of the paths; empty unless both solved the same problem differently.

    The same problem: the same final decisions, by the same ways. Costs as in `Run.total_nis`.
    """
    if batch.failure is not None or other.failure is not None or batch.final is None or other.final is None:
        return ""
    if batch.total_nis is None or other.total_nis is None or batch.total_nis[1] != other.total_nis[1]:
        return ""
    same = np.array_equal(batch.final_decisions, other.final_decisions) and np.array_equal(
        batch.initialized, other.initialized
    )
    a, b = batch.total_nis[0], other.total_nis[0]
    if not same or abs(a - b) <= ROUNDING + STEP**2 * max(abs(a), abs(b)):
        return ""
    better, worse = (batch, other) if a < b else (other, batch)
    apart = position_distance(batch.final.pose, other.final.pose)
    costs = sorted([a, b])
    digits = max(0, 2 - int(np.floor(np.log10(costs[1] - costs[0]))))
    return (
        f"{batch.estimator} and {other.estimator} solve the same least-squares problem (association"
        f" {batch.association}, same decisions) and end in different minima: {better.estimator} at a cost of"
        f" {costs[0]:.{digits}f}, {worse.estimator} at {costs[1]:.{digits}f} ({batch.total_nis[1]} degrees of freedom)."
        f" {better.estimator}'s is the better one; the paths are {number(rms(apart))} m RMS apart, at most"
        f" {number(float(np.nanmax(apart)))} m"
    )

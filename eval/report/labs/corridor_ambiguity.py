"""How far did the robot go? What two scans of the corridor lab say of it alone, and what a motion prior adds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import logsumexp
from scipy.stats import chi2

from data.inputs import Increment, IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array, between
from eval.referee.score import Scores, Trial
from eval.report.labs.corridor_facts import BLIND, NAMES, TURN, Lab, rmse
from eval.report.page.document import Block, Section, Table
from eval.report.page.tables import number

STEPS = (-3, -2, -1, 0, 1, 2, 3)
"""Multiples of the true step that are looked at."""
NEAR = 0.15
"""m. A peak of the likelihood is looked for so far about each of them: readings are noisy."""
FLAT = 0.01
"""A peak that rises less above the middle, in log-likelihood, is none."""
GRID = 0.005
"""m, between the step lengths tried there."""


@dataclass(frozen=True)
class Peak:
    """The best step length [m] near a multiple of the true one: how many readings fit, and the log-likelihood."""

    step: float
    fitting: int
    likelihood: float


@dataclass(frozen=True)
class Pair:
    """Two scans, of frames `frame` - 1 and `frame`, with a true move of `true` m between: peaks at all `STEPS`."""

    frame: int
    true: float
    readings: int
    peaks: tuple[Peak, ...]

    def at(self, multiple: int) -> Peak:
        """The peak near a multiple of the true step."""
        return self.peaks[STEPS.index(multiple)]


def fit(log: Log, frame: int, steps: Array) -> tuple[Array, IntArray]:
    """Log-likelihood (K,) of a scan given the scan before, for straight moves of `steps` (K,) m, and readings that fit.

    Without names: each reading shows one of the points seen before, whichever, or with the same probability something
    else, anywhere in view. It fits if one of those points is within 99 % by the noise of both readings.
    """
    sensor, o, start = log.recorded.sensor, log.recorded.observations, log.recorded.start
    before, now = (slice(start[k], start[k + 1]) for k in (frame - 1, frame))
    (known, P), (seen, Q) = (sensor.body_points(o.z[rows], o.R[rows]) for rows in (before, now))
    S = P[None] + Q[:, None]
    weights = np.linalg.inv(S)
    constant = -0.5 * np.linalg.slogdet(2.0 * math.pi * S)[1] - math.log(len(known))
    reach = max(float(sensor.polar(o.z[rows])[:, 0].max()) for rows in (before, now))
    elsewhere = -math.log(0.5 * (sensor.max_angle - sensor.min_angle) * reach**2)
    ahead = np.column_stack([steps, np.zeros(len(steps))])
    off = (seen[:, None] - known[None])[None] + ahead[:, None, None]
    d2 = (off[..., 0] * weights[..., 0, 0] + 2.0 * off[..., 1] * weights[..., 0, 1]) * off[..., 0]
    d2 += off[..., 1] ** 2 * weights[..., 1, 1]
    each = np.logaddexp(logsumexp(constant - 0.5 * d2, axis=2), elsewhere) - math.log(2.0)
    return each.sum(axis=1), (d2.min(axis=2) < chi2.ppf(0.99, 2)).sum(axis=1)


def straight_pairs(log: Log) -> list[Pair]:
    """All pairs of scans with a straight move between, each with the likelihood of other moves."""
    truth = log.truth.pose
    assert truth is not None
    start = log.recorded.start
    found = []
    for k, move in enumerate(between(truth[:-1], truth[1:]), 1):
        readings = int(start[k + 1] - start[k])
        if abs(move[2]) > TURN or abs(move[0]) < 4.0 * NEAR or not readings or start[k] == start[k - 1]:
            continue
        peaks = []
        for multiple in STEPS:
            tried = multiple * move[0] + np.arange(-NEAR, NEAR + 0.5 * GRID, GRID)
            likelihood, fitting = fit(log, k, tried)
            best = int(np.argmax(likelihood))
            if likelihood[best] - likelihood[len(tried) // 2] < FLAT:
                best = len(tried) // 2
            peaks.append(Peak(float(tried[best]), int(fitting[best]), float(likelihood[best])))
        found.append(Pair(k, float(move[0]), readings, tuple(peaks)))
    return found


def prior_likelihood(stated: Increment, step: float) -> float:
    """Log of the density that a stated motion gives to a straight move [m]."""
    off = np.array([step, 0.0, 0.0]) - stated.mean
    P = stated.covariance
    return float(-0.5 * (off @ np.linalg.solve(P, off) + np.linalg.slogdet(2.0 * math.pi * P)[1]))


def ambiguity_sections(lab: Lab) -> list[Section]:
    """What the readings alone leave open, where a log without odometry was run."""
    bare, primed = lab.trials.get(BLIND), lab.primed.get(False)
    shown = bare or primed
    if shown is None:
        return []
    blocks = _two_peaks(shown.log, None if primed is None else primed.log)
    return [Section("Do two scans tell how far the robot went?", blocks, 3)] if blocks else []


def prior_sections(lab: Lab, scores: Scores) -> list[Section]:
    """What a motion prior changes, where a log with one was run."""
    primed = lab.primed.get(False)
    text = "" if primed is None else _what_a_prior_changes(primed, lab.trials.get(BLIND), scores)
    return [Section("What does a motion prior change?", (text,), 3)] if text else []


def _two_peaks(log: Log, primed: Log | None) -> tuple[Block, ...]:
    """Text and table; empty where there is no straight move to look at."""
    pairs = straight_pairs(log)
    if not pairs:
        return ()
    both = [p for p in pairs if p.at(-1).fitting >= p.at(1).fitting > 0]
    notes = [
        f"Two scans in a row of `{log.name}` without names of points: how well does the second one fit the first one if"
        f" the robot moved straight by so much? Of {len(pairs)} straight moves"
    ]
    if not both:
        notes.append("none could as well have been a move of the same length backwards: the readings alone decide.")
        return (" ".join(notes),)
    better = sum(p.at(-1).likelihood >= p.at(1).likelihood for p in both)
    notes.append(
        f"{len(both)} could as well have been one backwards: just as many readings fit, and in {better} of them"
        " backwards is even the likelier one. The points repeat every two steps, and a map that grew behind the"
        " robot repeats, too."
    )
    pair = min(both, key=lambda p: abs(p.at(-1).likelihood - p.at(1).likelihood))
    stated = log.recorded.increment(pair.frame)
    ahead, back = (prior_likelihood(stated, pair.at(m).step) for m in (1, -1))
    if primed is None or primed is not log:
        notes.append(
            "The motion stated with the log does not decide either: it is as dense at the one as at the other."
            if abs(ahead - back) < 1.0
            else f"The motion stated with the log makes the true one {number(math.exp(ahead - back), 2)} times as"
            " likely."
        )
    best = max(p.likelihood for p in pair.peaks)
    columns: dict[str, list[object]] = {
        "step [m]": [f"{p.step:+.2f}" for p in pair.peaks],
        f"readings that fit, of {pair.readings}": [p.fitting for p in pair.peaks],
        "log-likelihood − largest": [f"{p.likelihood - best:.1f}" for p in pair.peaks],
    }
    if primed is not None:
        given = primed.recorded.increment(pair.frame)
        ahead, back = (prior_likelihood(given, pair.at(m).step) for m in (1, -1))
        notes.append(
            f"The prior of `{primed.name}` does: there the true one is {number(math.exp(ahead - back), 2)} times as"
            " likely before anything is seen."
        )
        posterior = [p.likelihood + prior_likelihood(given, p.step) for p in pair.peaks]
        columns["with the prior − largest"] = [f"{v - max(posterior):.1f}" for v in posterior]
    caption = (
        f"Moves that explain the scan of frame {pair.frame}, given the one before; the true move is"
        f" {pair.true:.2f} m. Each row is the best step length within {NEAR:g} m of a multiple of it."
    )
    return " ".join(notes), Table(pd.DataFrame(columns), caption)


def _what_a_prior_changes(primed: Trial, bare: Trial | None, scores: Scores) -> str:
    """Position errors with the prior beside those without it; empty where nothing was run to the end."""
    note = next((n for n in primed.log.notes if "motion prior" in n), "")
    rows = []
    for run in primed.runs:
        if run.failure is not None or run.association == "none":
            continue
        without = None if bare is None else bare.find(run.estimator, run.association)
        line = f"{run.estimator} with {NAMES.get(run.association, run.association)} {_errors(scores, primed, run)}"
        if bare is not None and without is not None and without.failure is None:
            line += f" ({_errors(scores, bare, without)} without)"
        rows.append(line)
    if not rows:
        return ""
    notes = [
        f"`{primed.log.name}`. {note}".strip(),
        f"Position RMSE (online / final where there are both): {'; '.join(rows)}.",
    ]
    plain, again = primed.find("ekf"), primed.find("ekf-iterated")
    if plain is not None and again is not None and plain.flaw is None and again.flaw is None:
        a, b = rmse(scores, primed, plain), rmse(scores, primed, again)
        if b < a:
            notes.append(
                f"With the same pairings one linearization at the prediction costs a factor of {number(a / b, 2)}: a"
                " prior as wide as a turn is used well only by estimators that linearize again where the readings lead."
            )
    return " ".join(notes)


def _errors(scores: Scores, trial: Trial, run: Run) -> str:
    """Position RMSE [m] of each phase of a run, and its status if it is implausible."""
    mark = "" if run.doubt is None else f", {run.status}"
    return " / ".join(number(rmse(scores, trial, run, phase)) for phase in run.phases) + f" m{mark}"

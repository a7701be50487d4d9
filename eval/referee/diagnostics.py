"""Diagnostics of completed runs, as one list of notices; truth is used for the true ids of landmarks alone."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import scipy

from data.inputs import Inputs, IntArray
from data.log import Log
from data.motion.systematic import corrected_inputs
from data.notice import Code, Notice, Value, notice, ordered
from data.questions.asked import ask, assumed_noise
from data.result import Run
from data.wing import of_all
from data.words import sentence
from eval.referee.ambiguity import ambiguous
from eval.referee.errors import observed, position_distance, rms
from eval.referee.lost import FEWEST
from eval.referee.residuals import smoothed_residuals, used_by
from eval.referee.result_files import NOTICES, RUN
from eval.referee.score import Scores, Trial, score
from eval.referee.sources import source_notices

CROWDED = 0.5
"""Share of landmarks close to another one. With right labels it is at most 0.23 (Victoria Park; 0 in other logs); with
sigmas stated 2 or 3 times too small it is 0.64 to 0.97."""
ON_TOP = 5.0  # standard deviations of an observation within which two landmarks are close; the gate of new ones has 4.8


def _of(run: Run, code: Code, **values: Value) -> Notice:
    return notice(code, None, **values).about(estimator=run.estimator, association=run.association)


def crowded(run: Run, inputs: Inputs) -> Notice | None:
    """A notice where most landmarks are close to another one that no common frame saw."""
    if run.association == "none" or run.failure is not None:
        return None
    if run.task != "slam" or run.map is None or 2 * len(run.map) < FEWEST or not inputs.locates_points:
        return None
    o, places = inputs.observations, run.map
    if not len(o.z):  # corners of scans are the landmarks
        return None
    _, spread = inputs.sensor.body_points(o.z, o.R)
    reach = ON_TOP * float(np.sqrt(np.median(np.trace(spread, axis1=1, axis2=2))))
    if reach > float(np.median(inputs.sensor.polar(o.z)[:, 0])):  # bearings alone: sigmas say nothing of neighbours
        return None
    near = scipy.spatial.cKDTree(places.xy).query_pairs(reach, output_type="ndarray")
    if len(np.unique(near)) <= CROWDED * len(places):
        return None
    of = observed(run)
    frames = {i: np.unique(o.frame[of == places.number[i]]) for i in np.unique(near).tolist()}
    apart = [i for a, b in near.tolist() if not len(np.intersect1d(frames[a], frames[b])) for i in (a, b)]
    doubles = len(set(apart))
    if doubles <= CROWDED * len(places):
        return None
    return _of(run, Code.LANDMARKS, landmarks=len(places), doubles=doubles, reach=reach)


def ambiguity_of(run: Run, inputs: Inputs) -> Notice | None:
    """How many landmarks may be the same as a neighbour."""
    of = ambiguous(run, inputs)
    same = int((of >= 0).sum())
    return _of(run, Code.AMBIGUOUS, ambiguous=same, landmarks=len(of)) if same else None


STEP = 1e-3  # sigma, largest Newton step of a converged optimizer; it leaves a share STEP^2 of the cost at most
ROUNDING = 1e-2  # rounding of a cost: 10^5 squares, each rounded at 1e-7 of its size


def minima(trial: Trial) -> list[Notice]:
    """Pairs of `batch` and `isam2` that solved one problem and ended in different minima."""
    pairs = ((r, trial.find("isam2", r.association)) for r in trial.runs if r.estimator == "batch")
    found = (two_minima(batch, other) for batch, other in pairs if other is not None)
    return [n for n in found if n is not None]


def two_minima(batch: Run, other: Run) -> Notice | None:
    """Costs (`Run.total_nis`) and distance of the paths; None unless the same decisions ended in two minima."""
    if batch.failure is not None or other.failure is not None or batch.final is None or other.final is None:
        return None
    if batch.total_nis is None or other.total_nis is None or batch.total_nis[1] != other.total_nis[1]:
        return None
    decisions = np.array_equal(batch.final_decisions, other.final_decisions)
    same = decisions and np.array_equal(batch.initialized, other.initialized)
    a, b = batch.total_nis[0], other.total_nis[0]
    if not same or abs(a - b) <= ROUNDING + STEP**2 * max(abs(a), abs(b)):
        return None
    better, worse = (batch, other) if a < b else (other, batch)
    apart = position_distance(batch.final.pose, other.final.pose)
    names: dict[str, Any] = {"better": better.estimator, "worse": worse.estimator}
    costs, most = (min(a, b), max(a, b)), float(np.nanmax(apart))
    found = notice(Code.TWO_MINIMA, **names, costs=costs, dof=batch.total_nis[1], apart=rms(apart), apart_most=most)
    return found.about(association=batch.association)


DISPUTABLE = 0.02
"""Share of pairings in which two methods differ. `jcbb` and `jcbb-hindsight` differ in less than 0.8 % on 38 of 39 logs
of another simulator with noise as stated, and in 11 % on the other, where `jcbb` makes 15 % wrong pairings."""


def disputed(trial: Trial, scores: Scores) -> list[Notice]:
    """Pairs of methods without labels that made one estimator's pairings otherwise, with FP of both if scored."""
    kept: dict[str, dict[str, Run]] = {}
    for r in trial.runs:
        if r.decides and r.association not in ("known", "none") and r.failure is None and len(r.final_decisions):
            kept.setdefault(r.estimator, {})[r.association] = r
    found: dict[tuple[str, str], Notice] = {}
    for estimator, runs in kept.items():
        for pair in combinations(runs, 2):
            share = differing(observed(runs[pair[0]]), observed(runs[pair[1]]))
            if pair not in found and share > DISPUTABLE:
                rows = (_row(runs[m], trial.log.name) for m in pair)
                fp = tuple(n for row in rows for n in _numbers(scores.association, row, ("fp",)))
                known = fp if np.isfinite(fp).all() else None
                found[pair] = notice(Code.DISPUTED, methods=pair, share=share, fp=known).about(estimator=estimator)
    return list(found.values())


def differing(first: IntArray, second: IntArray) -> float:
    """Share of observations that two runs pair differently, of those (M,) that both pair; numbers may differ. Landmarks
    correspond by the most common number of the other run, in the direction that leaves more over.
    """
    both = (first >= 0) & (second >= 0)
    if not both.any():
        return 0.0
    table = pd.crosstab(first[both], second[both]).to_numpy()
    return float(1.0 - min(table.max(axis=0).sum(), table.max(axis=1).sum()) / both.sum())


WRONG, AGREE = 0.05, 0.99  # least share of FP in the pairings, and least `majority_agreement` beside it
OTHER = 0.05  # least relative difference of the landmark RMSE with true ids by majority


def naming(run: Run, scores: Scores, log: str) -> Notice | None:
    """A notice where true ids by majority change the counts of a run or its landmark RMSE."""
    key = _row(run, log)
    tp, fp, agree = _numbers(scores.association, key, ("tp", "fp", "majority_agreement"))
    stated, by_majority = _numbers(scores.metrics, key, ("rmse_landmark_m", "rmse_landmark_majority_m"))
    wrong = agree > AGREE and fp > WRONG * (tp + fp)
    off = abs(stated - by_majority) > OTHER * stated
    if not wrong and not off:
        return None
    shares: dict[str, Value] = {"false_share": fp / (tp + fp) if wrong else None, "agree": agree if wrong else None}
    return _of(run, Code.NAMING, **shares, rmse=stated if off else None, rmse_majority=by_majority if off else None)


def _row(run: Run, log: str) -> tuple[str, ...]:
    """Names of a run's row of its last phase."""
    return log, run.task, run.estimator, run.association, run.phases[-1] if run.phases else ""


def _numbers(table: pd.DataFrame, key: tuple[str, ...], columns: Sequence[str]) -> list[float]:
    """Columns of a run's row; NaN without it."""
    rows = table[(table[list(RUN)] == list(key)).all(axis=1)]
    return [float("nan") if rows.empty or pd.isna(v := rows.iloc[0][c]) else float(v) for c in columns]


def origin(run: Run, trial: Trial) -> Notice | None:
    """The pairing that fits worst in the first frame of an implausible run, or None: `observation` counts within the
    frame, `began`: it initialized the landmark, `off` [m]: of its place from the final estimate.
    """
    if run.implausible is None:
        return None
    recorded, k = trial.log.recorded, run.implausible.frame
    inputs = recorded if run.task == "localization" else recorded.without_map()
    used, path = used_by(run, inputs), run.trajectory(run.phases[-1]).pose
    squared = smoothed_residuals(corrected_inputs(inputs, run.errors), path, used).squared
    if run.innovations is not None:
        white = np.sum(run.innovations.white**2, axis=1)
        squared = np.where(np.isfinite(white), white, squared)
    rows = np.arange(inputs.start[k], inputs.start[k + 1])
    rows = rows[used.number[rows] >= 0]
    if not len(rows):
        return None
    i = int(rows[np.argmax(np.where(np.isfinite(squared), squared, np.inf)[rows])])
    o, sensor, there = recorded.observations, recorded.sensor_at(i), used.landmarks[used.number[i]]
    if sensor.sees_points and sensor.locates:
        off = float(np.hypot(*(there - sensor.inverse(path[k], o.z[i : i + 1])[0][0])))
    else:
        off = abs(float(sensor.residual(o.z[i], sensor.predict(path[k], there)[0])[0]))
    place, landmark = i - int(inputs.start[k]), int(used.identity[used.number[i]])
    return notice(Code.ORIGIN, k, observation=place, landmark=landmark, began=bool(run.initialized[i] >= 0), off=off)


def of_logs(logs: Iterable[Log]) -> Iterator[Notice]:
    """Notes and questions about each log, which need no run."""
    for log in {log.name: log for log in logs}.values():
        yield from (notice(Code.NOTE, text=text).about(log=log.name) for text in log.notes)
        yield from assumed_noise(log)
        yield from ask(log)


def notices(
    trials: Sequence[Trial], scores: Scores | None = None, known: Iterable[Notice] | None = None
) -> list[Notice]:
    """All notices about logs and runs, each once: errors (stopped, implausible, lost), warnings, facts.

    Args:
        trials: of one or several logs.
        scores: of these trials, if they are known already.
        known: notices found before, those about the logs among them; None: the logs are asked.

    Example:
        >>> [(n.estimator, n.code) for n in slamref.notices([trial])]
    """
    scores = scores or score(trials)
    found = list(of_logs(t.log for t in trials if t.variant_of is None) if known is None else known)
    for trial in trials:
        each = ((r, n) for r in trial.runs for n in _all(r, trial, scores))
        own = [n.about(estimator=r.estimator, association=r.association) for r, n in each]
        others = (*of_wings(trial, trials), *minima(trial), *disputed(trial, scores))
        found += [n.about(log=trial.log.name, task=trial.task) for n in (*own, *others)]
    return ordered(found)


def of_wings(trial: Trial, trials: Sequence[Trial]) -> list[Notice]:
    """Notices of wings about a trial's runs; its variants are among the `trials`."""
    return [found for of_wing in of_all("notices") for found in of_wing(trial, trials)]


def _all(run: Run, trial: Trial, scores: Scores) -> Iterator[Notice]:
    if run.flaw is not None:
        yield run.flaw.notice.about(frame=run.flaw.frame)
    names = run.estimator, run.association
    found = [origin(run, trial), trial.lost.get(names), naming(run, scores, trial.log.name)]
    yield from (n for n in found if n is not None)
    yield from run.notes
    found = [trial.unused.get(names), crowded(run, trial.log.recorded), ambiguity_of(run, trial.log.recorded)]
    yield from (n for n in found if n is not None)
    yield from source_notices(run, trial.log.recorded)


def notices_table(found: Sequence[Notice]) -> pd.DataFrame:
    """The rows of notices.csv."""
    rows = []
    for n in found:
        values = json.dumps({name: _plain(value) for name, value in n.values}, ensure_ascii=False)
        row = {name: getattr(n, name) for name in ("log", "task", "estimator", "association", "frame")}
        row |= {"code": n.code.value, "severity": n.severity.value, "values": values}
        rows.append(row | {"text": " ".join(sentence(n).split())})
    return NOTICES.table(rows)


def _plain(value: Value) -> object:
    """A value for JSON: numbers that are not finite are null."""
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

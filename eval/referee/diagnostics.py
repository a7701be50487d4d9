"""What is to be doubted about runs that got to their end, as notices; truth is used for landmarks' names alone.

Nearly nothing used, or more landmarks than the readings make sense of; landmarks that cannot be told from a neighbour,
or may be two; two minima of one least-squares problem; landmarks named by a first observation that showed a neighbour;
where an implausible run probably went wrong.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
import scipy

from data import se2
from data.inputs import Inputs, IntArray
from data.motion.systematic import corrected_inputs
from data.notice import Code, Notice, Severity, Value, notice
from data.questions import ask
from data.result import Run
from data.se2 import Array
from data.sensors import RangeBearing
from data.words import sentence
from eval.referee.ambiguity import ambiguous
from eval.referee.errors import named, position_distance, rms
from eval.referee.metrics import RUN
from eval.referee.plausibility import ABSURD, first_misfit
from eval.referee.residuals import Used, smoothed_residuals, used_by
from eval.referee.result_files import NOTICES
from eval.referee.score import Scores, Trial, lost_of, score

UNUSED = 0.1
"""Share of the readings paired with a landmark below which an estimate is dead reckoning under another name."""
FEWEST = 20
"""Fewer readings, or half as many landmarks, say nothing."""
CROWDED = 0.5
"""Share of landmarks that stand on top of another. With right labels it is at most 0.23 in every world and recording
this was measured on (Victoria Park; 0 in all others); 20 landmarks mapped as 95 to 330, because sigmas were stated 2 or
3 times too small, give 0.64 to 0.97."""
ON_TOP = 5.0
"""Standard deviations of a reading within which two landmarks that were never seen in one frame may be one: the gate
outside which a new landmark is made is 4.8 of them wide."""


def _of(run: Run, code: Code, **values: Value) -> Notice:
    return notice(code, Severity.WARNING, None, **values).about(estimator=run.estimator, association=run.association)


def questions_of_run(run: Run, inputs: Inputs) -> list[Notice]:
    """What to ask about one run; nothing about dead reckoning or one that failed. No truth is used."""
    if run.association == "none" or run.failure is not None:
        return []
    return [found for found in (unused(run), _crowded(run, inputs)) if found is not None]


def unused(run: Run) -> Notice | None:
    """Next to no reading was paired: the estimate is dead reckoning under another name."""
    if run.association == "none" or run.failure is not None:
        return None
    used, seen = int((run.final_decisions >= 0).sum()), len(run.final_decisions)
    if seen < FEWEST or used >= UNUSED * seen:
        return None
    return _of(run, Code.UNUSED, used=used, readings=seen, task=run.task)


def _crowded(run: Run, inputs: Inputs) -> Notice | None:
    """Most landmarks stand on top of another one that was never seen beside them."""
    if run.task != "slam" or run.map is None or 2 * len(run.map) < FEWEST or not inputs.sensor.sees_points:
        return None
    o, places = inputs.observations, run.map
    _, spread = inputs.sensor.body_points(o.z, o.R)
    reach = ON_TOP * float(np.sqrt(np.median(np.trace(spread, axis1=1, axis2=2))))
    near = scipy.spatial.cKDTree(places.xy).query_pairs(reach, output_type="ndarray")
    if len(np.unique(near)) <= CROWDED * len(places):
        return None
    of = np.where(run.initialized >= 0, run.initialized, run.final_decisions)
    frames = {i: np.unique(o.frame[of == places.number[i]]) for i in np.unique(near).tolist()}
    apart = [i for a, b in near.tolist() if not len(np.intersect1d(frames[a], frames[b])) for i in (a, b)]
    doubles = len(set(apart))
    if doubles <= CROWDED * len(places):
        return None
    return _of(run, Code.LANDMARKS, landmarks=len(places), doubles=doubles, reach=reach)


def ambiguity_of(run: Run, inputs: Inputs) -> list[Notice]:
    """How many landmarks of its map cannot be told from a neighbour, and how many may be two."""
    if run.map is None:
        return []
    of = ambiguous(run, inputs)
    own = of == run.map.number
    apart, double, found = int(((of >= 0) & ~own).sum()), int(own.sum()), []
    if apart:
        found.append(_of(run, Code.AMBIGUOUS, ambiguous=apart, landmarks=len(of)))
    if double:
        found.append(_of(run, Code.DOUBLE, double=double, landmarks=len(of)))
    return found


STEP = 1e-3
"""Sigma: the largest Newton step that is left where an optimizer has converged. In each of n components it leaves a
cost of STEP^2 at most; n is about the number of degrees of freedom, and so is the cost: STEP^2 of it, ..."""
ROUNDING = 1e-2
"""... and this much where the least cost is next to nothing: sums of 10^5 squares, each rounded at 1e-7 of its size."""


def minima(trial: Trial) -> list[Notice]:
    """Pairs of `batch` and `isam2` with the same decisions that ended in different minima."""
    pairs = ((r, trial.find("isam2", r.association)) for r in trial.runs if r.estimator == "batch")
    found = (two_minima(batch, other) for batch, other in pairs if other is not None)
    return [n for n in found if n is not None]


def two_minima(batch: Run, other: Run) -> Notice | None:
    """Both costs, the better one, and the distance of the paths; None unless both solved one problem differently.

    The same problem: the same final decisions, by the same ways. Costs as in `Run.total_nis`.
    """
    if batch.failure is not None or other.failure is not None or batch.final is None or other.final is None:
        return None
    if batch.total_nis is None or other.total_nis is None or batch.total_nis[1] != other.total_nis[1]:
        return None
    same = np.array_equal(batch.final_decisions, other.final_decisions) and np.array_equal(
        batch.initialized, other.initialized
    )
    a, b = batch.total_nis[0], other.total_nis[0]
    if not same or abs(a - b) <= ROUNDING + STEP**2 * max(abs(a), abs(b)):
        return None
    better, worse = (batch, other) if a < b else (other, batch)
    apart = position_distance(batch.final.pose, other.final.pose)
    return notice(
        Code.TWO_MINIMA,
        better=better.estimator,
        worse=worse.estimator,
        costs=(min(a, b), max(a, b)),
        dof=batch.total_nis[1],
        apart=rms(apart),
        apart_most=float(np.nanmax(apart)),
    ).about(association=batch.association)


WRONG, AGREE = 0.05, 0.99
"""More than this share of the pairings is FP, and yet more than that share shows what most of its landmark's do."""
OTHER = 0.05
"""Landmark RMSE differs by more than this share when landmarks are named by majority."""


def naming(run: Run, scores: Scores, log: str) -> Notice | None:
    """Where the name of a landmark changes what the counts of a run, or the RMSE of its landmarks, say."""
    phase = run.phases[-1] if run.phases else ""
    key = (log, run.task, run.estimator, run.association, phase)
    tp, fp, agree = _numbers(scores.association, key, ("tp", "fp", "majority_agreement"))
    stated, by_majority = _numbers(scores.metrics, key, ("rmse_landmark_m", "rmse_landmark_majority_m"))
    wrong = agree > AGREE and fp > WRONG * (tp + fp)
    off = abs(stated - by_majority) > OTHER * stated
    if not wrong and not off:
        return None
    return _of(
        run,
        Code.NAMING,
        false_share=fp / (tp + fp) if wrong else None,
        agree=agree if wrong else None,
        rmse=stated if off else None,
        rmse_majority=by_majority if off else None,
    )


def _numbers(table: pd.DataFrame, key: tuple[str, ...], columns: Sequence[str]) -> list[float]:
    """Columns of a run's row, NaN where there is none."""
    rows = table[(table[list(RUN)] == list(key)).all(axis=1)]
    return [float("nan") if rows.empty or pd.isna(v := rows.iloc[0][c]) else float(v) for c in columns]


JUMP = ABSURD**0.5
"""Claimed sigmas that an online pose may be from the smoothed one: their difference has a smaller covariance."""
NEAR = 3.0
"""Sigmas of the range: nearer, a landmark may be on any side of the robot, and its bearing means nothing."""


def origin(run: Run, trial: Trial) -> Notice | None:
    """What happened first, in which frame, and to which pairing; None for a run without doubt."""
    if run.implausible is None:
        return None
    inputs = trial.log.recorded if run.task == "localization" else trial.log.recorded.without_map()
    found = [_difference(run, trial), _innovations(run)]
    first = min((f for f in found if f is not None), default=None)
    k, sign, online, size = first or (first_misfit(run, inputs), "misfit", "", 0.0)
    used = used_by(run, inputs)
    path = run.trajectory(run.phases[-1]).pose
    squared = smoothed_residuals(corrected_inputs(inputs, run.errors), path, used).squared
    rows = np.arange(inputs.start[k], inputs.start[k + 1])
    rows = rows[used.number[rows] >= 0]
    of_pairing: dict[str, Value] = dict.fromkeys(("observation", "landmark", "began", "right", "off"))
    beside: tuple[float, ...] = ()
    if len(rows):
        i = int(rows[np.argmax(_surprise(run, squared)[rows])])
        of_pairing, beside = _pairing(run, trial, used, path, i), _beside(trial, rows)
    return notice(Code.ORIGIN, Severity.WARNING, k, sign=sign, online=online, size=size, beside=beside, **of_pairing)


Sign = tuple[int, str, str, float]
"""The frame, what is seen there (`path` or `innovation`), of which online path, and its size."""


def _difference(run: Run, trial: Trial) -> Sign | None:
    """The first frame in which an online path under the run's decisions is far from the run's last path."""
    if run.final is None:
        return None
    others = (r for r in trial.runs if r.online is not None and r.association == run.association)
    online = run if run.online is not None else next((r for r in others if _alike(r, run)), None)
    if online is None or online.online is None or online.failure is not None:
        return None
    variance = np.einsum("nii->ni", online.online.covariance)
    d = np.abs(se2.pose_error(online.online.pose, run.final.pose))
    in_sigmas = np.max(d / np.sqrt(np.where(variance > 0.0, variance, np.inf)), axis=1)
    far = in_sigmas > JUMP
    if not far.any():
        return None
    k = int(np.argmax(far))
    return k, "path", online.estimator, float(in_sigmas[k])


def _alike(a: Run, b: Run) -> bool:
    return a.estimator != "dead-reckoning" and np.array_equal(a.final_decisions, b.final_decisions)


def _innovations(run: Run) -> Sign | None:
    """The first frame whose innovations are ten times as large as claimed."""
    if run.innovations is None:
        return None
    nis, dof = run.innovations.nis, run.innovations.dof
    wild = np.isfinite(nis) & (nis > ABSURD * np.maximum(dof, 1))
    if not wild.any():
        return None
    k = int(np.argmax(wild))
    return k, "innovation", run.estimator, float(nis[k]) / max(int(dof[k]), 1)


def _surprise(run: Run, squared: Array) -> Array:
    """How little each reading (M,) fitted: by its innovation where there is one, else by what is left in the end."""
    if run.innovations is not None:
        white = np.sum(run.innovations.white**2, axis=1)
        squared = np.where(np.isfinite(white), white, squared)
    return np.where(np.isfinite(squared), squared, np.inf)


def _pairing(run: Run, trial: Trial, used: Used, path: Array, i: int) -> dict[str, Value]:
    """Observation `i` of the log, its landmark, whether it began with it, whether that is right, and how far it is off.

    Off [m]: where the last map has the landmark, from where the reading puts it.
    """
    recorded = trial.log.recorded
    o, frame = recorded.observations, int(recorded.observations.frame[i])
    landmark = int(used.identity[used.number[i]])
    there = used.landmarks[used.number[i]]
    if recorded.sensor.sees_points:
        put = recorded.sensor.inverse(path[frame], o.z[i : i + 1])[0][0]
        off = float(np.hypot(*(there - put)))
    else:
        off = abs(float(recorded.sensor.residual(o.z[i], recorded.sensor.predict(path[frame], there)[0])[0]))
    began = bool(run.initialized[i] >= 0)
    right = None if began else _is_right(run, trial, landmark, i)
    place = i - int(recorded.start[frame])
    return {"observation": place, "landmark": landmark, "began": began, "right": right, "off": off}


def _is_right(run: Run, trial: Trial, landmark: int, i: int) -> bool | None:
    """Whether a pairing is right, where the truth is known."""
    own: IntArray | None = trial.log.truth.landmark_of
    if own is None:
        return None
    if run.task == "localization":
        return int(own[i]) == landmark
    first = np.flatnonzero(named(run) == landmark)
    return int(own[i]) == int(own[first[0]]) if len(first) else None


def _beside(trial: Trial, rows: IntArray) -> tuple[float, ...]:
    """Ranges [m] of the readings that are so near that their bearing means nothing."""
    recorded = trial.log.recorded
    if not isinstance(recorded.sensor, RangeBearing):
        return ()
    o = recorded.observations
    return tuple(o.z[rows[o.z[rows, 0] < NEAR * np.sqrt(o.R[rows, 0, 0])], 0].tolist())


def notices(trials: Sequence[Trial], scores: Scores | None = None) -> list[Notice]:
    """Everything that was found about logs and runs, log by log: questions, notes, flaws, who is lost, what is doubted.

    `scores`: of these trials, where they are known already.
    """
    scores = scores or score(trials)
    found: list[Notice] = []
    for log in {t.log.name: t.log for t in trials if t.variant_of is None}.values():
        found += [notice(Code.NOTE, Severity.INFO, text=text).about(log=log.name) for text in log.notes]
        found += ask(log)
    for trial in trials:
        own = [
            n.about(estimator=r.estimator, association=r.association)
            for r in trial.runs
            for n in _all(r, trial, scores)
        ]
        found += [n.about(log=trial.log.name, task=trial.task) for n in (*own, *minima(trial))]
    return found


def _all(run: Run, trial: Trial, scores: Scores) -> Iterator[Notice]:
    """All about one run."""
    if run.flaw is not None:
        yield run.flaw.notice.about(frame=run.flaw.frame)
    for found in (origin(run, trial), lost_of(run, trial.log), naming(run, scores, trial.log.name)):
        if found is not None:
            yield found
    yield from run.notes
    yield from questions_of_run(run, trial.log.recorded)
    yield from ambiguity_of(run, trial.log.recorded)


def notices_table(found: Sequence[Notice]) -> pd.DataFrame:
    """The rows of notices.csv."""
    return NOTICES.table(
        [
            {
                **{name: getattr(n, name) for name in ("log", "task", "estimator", "association", "frame")},
                "code": n.code.value,
                "severity": n.severity.value,
                "values": json.dumps({name: _plain(value) for name, value in n.values}, ensure_ascii=False),
                "text": " ".join(sentence(n).split()),
            }
            for n in found
        ]
    )


def _plain(value: Value) -> object:
    """What JSON has a word for: numbers that are not finite are unknown."""
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

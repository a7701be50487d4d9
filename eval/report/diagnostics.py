"""Questions about a run that got to its end: nearly nothing used, or more landmarks than the readings make sense of.

Landmarks that cannot be told from a neighbour, or may be two: how many of a run's map, in a sentence.

Two minima of one least-squares problem: who is in the better one, and how far apart the paths are.

Where the name of a landmark, which is that of the observation that initialized it, changes what the counts say.

Where an implausible run probably went wrong: the first frame that jumps, and the pairing there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from data import se2
from data.inputs import Inputs, IntArray
from data.motion.systematic import corrected_inputs
from data.questions import Question, ask
from data.result import Run
from data.se2 import Array
from data.sensors import RangeBearing
from eval.referee.ambiguity import ambiguous
from eval.referee.errors import named, position_distance, rms
from eval.referee.plausibility import ABSURD, first_misfit
from eval.referee.residuals import Used, smoothed_residuals, used_by
from eval.referee.score import Trial
from eval.report.page.document import Section
from eval.report.page.tables import number
from eval.report.rows import Row, value_of

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

TEXT = """\
Asked by checks of what a log says and of what came out of it. A question is no verdict: where the answer is fine,
nothing is wrong."""


def questions_of_run(run: Run, inputs: Inputs) -> list[Question]:
    """What to ask about one run; nothing about dead reckoning or one that failed. No truth is used."""
    if run.association == "none" or run.failure is not None:
        return []
    return [*_unused(run), *_crowded(run, inputs)]


def _unused(run: Run) -> list[Question]:
    """Next to no reading was paired."""
    used, seen = int((run.final_decisions >= 0).sum()), len(run.final_decisions)
    if seen < FEWEST or used >= UNUSED * seen:
        return []
    advice = (
        "look at the frame of map and prior, at units and signs of the readings"
        if run.task == "localization"
        else "nothing is seen twice: look at units and signs of odometry and readings, and at the stated sigmas"
    )
    return [Question("unused", f"{used} of {seen} observations used, so this is dead reckoning: {advice}")]


def _crowded(run: Run, inputs: Inputs) -> list[Question]:
    """Most landmarks stand on top of another one that was never seen beside them."""
    if run.task != "slam" or run.map is None or 2 * len(run.map) < FEWEST or not inputs.sensor.sees_points:
        return []
    o, places = inputs.observations, run.map
    _, spread = inputs.sensor.body_points(o.z, o.R)
    reach = ON_TOP * float(np.sqrt(np.median(np.trace(spread, axis1=1, axis2=2))))
    near = cKDTree(places.xy).query_pairs(reach, output_type="ndarray")
    if len(np.unique(near)) <= CROWDED * len(places):
        return []
    of = np.where(run.initialized >= 0, run.initialized, run.final_decisions)
    frames = {i: np.unique(o.frame[of == places.number[i]]) for i in np.unique(near).tolist()}
    apart = [i for a, b in near.tolist() if not len(np.intersect1d(frames[a], frames[b])) for i in (a, b)]
    doubles = len(set(apart))
    if doubles <= CROWDED * len(places):
        return []
    return [
        Question(
            "landmarks",
            f"{len(places)} landmarks, of which {doubles} stand within {number(reach)} m (five sigmas of a reading) of "
            "another that was never seen with them: more than make sense; are the stated sigmas too small "
            "(`python -m eval.tune` fits them), or would another --association do better?",
        )
    ]


def said_after(trials: Sequence[Trial]) -> list[tuple[str, Question]]:
    """Questions about every run, each with whom it is about: log, task, and the estimators that share it."""
    said: dict[tuple[str, Question], list[str]] = {}
    for trial in trials:
        for run in trial.runs:
            for question in questions_of_run(run, trial.log.recorded):
                key = (f"{trial.log.name}, {trial.task}, {run.association}", question)
                said.setdefault(key, []).append(run.estimator)
    return [(f"{who}: {', '.join(names)}", question) for (who, question), names in said.items()]


def said_before(trials: Sequence[Trial]) -> list[tuple[str, Question]]:
    """Questions about every log, each with the log's name."""
    logs = {t.log.name: t.log for t in trials if t.beside is None}
    return [(name, question) for name, log in logs.items() for question in ask(log)]


def questions_section(trials: Sequence[Trial]) -> list[Section]:
    """A section with all of them; none where there is nothing to ask."""
    said = [*said_before(trials), *said_after(trials)]
    lines = [f"* **{question.name}** ({who}): {_ended(question.text)}" for who, question in said]
    return [Section("Questions", (TEXT, "\n".join(dict.fromkeys(lines))))] if lines else []


def _ended(text: str) -> str:
    return text if text.endswith("?") else f"{text}."


def is_unused(run: Run) -> bool:
    """Whether an estimate is dead reckoning under another name, as next to no reading was paired."""
    return run.association != "none" and run.failure is None and bool(_unused(run))


def unused_statement(trial: Trial) -> str:
    """For the headline: who used next to nothing, and how much; empty if nobody."""
    said = [
        f"{run.estimator} ({run.association}): {question.text}."
        for run in trial.runs
        for question in (_unused(run) if run.association != "none" and run.failure is None else ())
    ]
    return " ".join(said)


APART = (
    "cannot be told from a neighbour",
    "no frame saw both, and they are nearer than their covariances and the noise of a reading can tell",
)
TWO = (
    "may be two each",
    "what is read beside them in the same frames, or the scatter of their own readings, speaks for two",
)
"""What is said of a kind, and why."""


def ambiguity_statements(trial: Trial) -> list[str]:
    """A sentence for each kind and outcome that some run of a trial has, where it is not that all are told apart."""
    told: dict[tuple[str, str, str], list[str]] = {}
    for run in trial.runs:
        if run.map is None:
            continue
        of = ambiguous(run, trial.log.recorded)
        own = of == run.map.number
        for which, (what, why), column in (
            ((of >= 0) & ~own, APART, ""),
            (own, TWO, ", which then names the same one"),
        ):
            if which.any():
                text = f"{run.association}: {int(which.sum())} of {len(of)} landmarks {what}"
                told.setdefault((text, why, column), []).append(run.estimator)
    return [
        f"{', '.join(names)} with {text}: {why}; column ambiguous in landmarks.csv{column}"
        for (text, why, column), names in told.items()
    ]


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


WRONG, AGREE = 0.05, 0.99
"""More than this share of the pairings is FP, and yet more than that share shows what most of its landmark's do."""
OTHER = 0.05
"""Landmark RMSE differs by more than this share when landmarks are named by majority."""
REASON = "a landmark is named by the observation that initialized it; where that showed a neighbour, all others are FP"


def naming_statements(trial: Trial, metrics: Sequence[Row], association: Sequence[Row]) -> list[str]:
    """A sentence for each run of a trial where it matters, one for runs with the same numbers; rows of its log."""
    told: dict[str, list[str]] = {}
    for run in trial.runs:
        phase = run.phases[-1] if run.phases else ""
        scored = _row(association, run.estimator, run.association, phase)
        parts = (_pairings(scored), _places(_row(metrics, run.estimator, run.association, phase)))
        text = "; ".join(p for p in parts if p)
        if text:
            told.setdefault(f"{run.association}: {text}", []).append(run.estimator)
    return [f"{', '.join(names)} with {text}: {REASON}." for text, names in told.items()]


def _row(rows: Sequence[Row], estimator: str, association: str, phase: str) -> Row:
    key = (estimator, association, phase)
    return next((r for r in rows if (r["estimator"], r["association"], r["phase"]) == key), {})


def _pairings(row: Row) -> str:
    tp, fp, agree = (value_of(row, c) for c in ("tp", "fp", "majority_agreement"))
    if not (agree > AGREE and fp > WRONG * (tp + fp)):
        return ""
    return (
        f"{100.0 * fp / (tp + fp):.1f} % of the pairings are FP, yet {100.0 * agree:.1f} % of them show what most"
        " observations of their landmark do"
    )


def _places(row: Row) -> str:
    stated, by_majority = value_of(row, "rmse_landmark_m"), value_of(row, "rmse_landmark_majority_m")
    if not abs(stated - by_majority) > OTHER * stated:
        return ""
    return f"landmark RMSE is {number(stated)} m, by majority {number(by_majority)} m"


JUMP = ABSURD**0.5
"""Claimed sigmas that an online pose may be from the smoothed one: their difference has a smaller covariance."""
NEAR = 3.0
"""Sigmas of the range: nearer, a landmark may be on any side of the robot, and its bearing means nothing."""


def origin_statement(run: Run, trial: Trial) -> str:
    """What happened first, and to which pairing; empty for a run without doubt."""
    if run.doubt is None:
        return ""
    inputs = trial.log.recorded if run.task == "localization" else trial.log.recorded.without_map()
    misfit = first_misfit(run, inputs)
    found = [_difference(run, trial), _innovations(run)]
    jumped = min((f for f in found if f is not None), default=(misfit, "the last path is furthest from what was read"))
    k, what = jumped
    used = used_by(run, inputs)
    path = run.trajectory(run.phases[-1]).pose
    squared = smoothed_residuals(corrected_inputs(inputs, run.errors), path, used).squared
    rows = np.arange(inputs.start[k], inputs.start[k + 1])
    rows = rows[used.number[rows] >= 0]
    text = f"it probably began in frame {k}, where {what}"
    if not len(rows):
        return f"{text}; no observation of that frame was used"
    i = int(rows[np.argmax(_surprise(run, squared)[rows])])
    return f"{text}: {_pairing(run, trial, used, path, i)}{_near(run, trial, rows)}"


def _difference(run: Run, trial: Trial) -> tuple[int, str] | None:
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
    return k, f"the pose of {online.estimator} online is {number(float(in_sigmas[k]))} of its sigmas from the final one"


def _alike(a: Run, b: Run) -> bool:
    return a.estimator != "dead-reckoning" and np.array_equal(a.final_decisions, b.final_decisions)


def _innovations(run: Run) -> tuple[int, str] | None:
    """The first frame whose innovations are ten times as large as claimed."""
    if run.innovations is None:
        return None
    nis, dof = run.innovations.nis, run.innovations.dof
    wild = np.isfinite(nis) & (nis > ABSURD * np.maximum(dof, 1))
    if not wild.any():
        return None
    k = int(np.argmax(wild))
    return k, f"NIS per degree of freedom jumps to {number(float(nis[k]) / max(int(dof[k]), 1))}"


def _surprise(run: Run, squared: Array) -> Array:
    """How little each reading (M,) fitted: by its innovation where there is one, else by what is left in the end."""
    if run.innovations is not None:
        white = np.sum(run.innovations.white**2, axis=1)
        squared = np.where(np.isfinite(white), white, squared)
    return np.where(np.isfinite(squared), squared, np.inf)


def _pairing(run: Run, trial: Trial, used: Used, path: Array, i: int) -> str:
    """Observation `i` of the log, its landmark, and how far that is from where the reading puts it."""
    recorded = trial.log.recorded
    o, frame = recorded.observations, int(recorded.observations.frame[i])
    landmark = int(used.identity[used.number[i]])
    there = used.landmarks[used.number[i]]
    if recorded.sensor.sees_points:
        put = recorded.sensor.inverse(path[frame], o.z[i : i + 1])[0][0]
        off = float(np.hypot(*(there - put)))
    else:
        off = abs(float(recorded.sensor.residual(o.z[i], recorded.sensor.predict(path[frame], there)[0])[0]))
    paired = f"was paired{_in_truth(run, trial, landmark, i)} with"
    how = "initialized" if run.initialized[i] >= 0 else paired
    return (
        f"observation {i - int(recorded.start[frame])} {how} landmark {landmark}, which the last map has"
        f" {number(off)} m from where the reading puts it"
    )


def _in_truth(run: Run, trial: Trial, landmark: int, i: int) -> str:
    """Whether that was right, where the truth is known."""
    own: IntArray | None = trial.log.truth.landmark_of
    if own is None or run.initialized[i] >= 0:
        return ""
    first = np.flatnonzero(named(run) == landmark)
    right = landmark if run.task == "localization" else int(own[first[0]]) if len(first) else None
    if right is None:
        return ""
    return " (rightly, says the truth)" if int(own[i]) == right else " (wrongly, says the truth)"


def _near(run: Run, trial: Trial, rows: IntArray) -> str:
    """Readings so near that their bearing means nothing."""
    recorded = trial.log.recorded
    if not isinstance(recorded.sensor, RangeBearing):
        return ""
    o = recorded.observations
    near = rows[o.z[rows, 0] < NEAR * np.sqrt(o.R[rows, 0, 0])]
    if not len(near):
        return ""
    which = ", ".join(f"{number(float(r))} m" for r in o.z[near, 0])
    return f". A reading of that frame is next to the robot ({which}), where a bearing means nothing: a known cause"

"""Where an implausible run probably went wrong: the first frame that jumps, and the pairing there."""

from __future__ import annotations

import numpy as np

from data import se2
from data.inputs import IntArray
from data.motion.corrected_inputs import corrected_inputs
from data.result import Run
from data.se2 import Array
from data.sensors import RangeBearing
from eval.page.numbers import number
from eval.referee.errors import named
from eval.referee.residuals import Used, smoothed_residuals, used_by
from eval.referee.score import Trial
from eval.replay.plausible import ABSURD, first_misfit

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

"""Detection of lost estimators without truth: unpaired observations, missed landmarks, absurd innovations."""

import numpy as np

from data.inputs import Inputs, IntArray
from data.notice import Code, Notice, notice
from data.result import Run
from data.se2 import Array, BoolArray
from eval.referee.consistency import gated

FRAMES = 10  # least number of frames with observations in a stretch
OBSERVATIONS = 30  # least number of observations, or of expected ones, in a stretch
SHARE = 0.1  # share of paired or detected ones below which the estimator is lost
ESTABLISHED = 3  # observations of a SLAM landmark before it can be missed
OLD = 20  # frames from its initialization before it can be missed: a kidnapped robot initializes others at once
EDGE = 0.9  # share of range and field of view in which a landmark is expected
ABSURD = 100.0
"""NIS per degree of freedom, or squared innovation in sigmas: 10 sigma; sigmas stated at half give 4, lost runs above
400."""
CHANCE, USED = 1.8, 0.7
"""Factor of the expected NIS, and share of paired observations: pairings by chance fill the gate evenly, while sigmas
stated at half give 1.9 and pair nearly all."""
UNUSED = 0.1  # share of paired observations below which an estimate is dead reckoning
FEWEST = 20  # least number of observations, or twice the landmarks, to ask about
TOGETHER = 3  # successive absurd innovations; fewer may be wrong labels


def lost(run: Run, inputs: Inputs, label: IntArray | None = None) -> Notice | None:
    """The first reason why a run is lost, with its frame; None for none, for dead reckoning and failed runs. `label`
    (M,): labels of known association, negative where an observation is of no landmark.
    """
    if run.association == "none" or run.failure is not None:
        return None
    view = inputs if run.task == "localization" else inputs.without_map()
    found = (_unused(run, view, label), _unseen(run, view), _absurd(run, view), _by_chance(run))
    return min((f for f in found if f is not None), key=lambda f: f.frame or 0, default=None)


def _unused(run: Run, inputs: Inputs, label: IntArray | None) -> Notice | None:
    """A stretch in a known map, or a whole run of SLAM, with hardly any pairing."""
    known = np.ones(len(run.decisions), bool)
    if label is not None:
        known = np.isin(label, inputs.map.id) if inputs.map is not None else label >= 0
    n, frame = len(inputs), inputs.observations.frame
    if inputs.map is None:
        later = known & (frame >= FRAMES)  # with a map
        share = float((_decisions(run)[later] >= 0).mean()) if later.sum() >= OBSERVATIONS else 1.0
        return notice(Code.HARDLY_USED, FRAMES, share=share, after=FRAMES) if share < SHARE else None
    could = np.bincount(frame[known], minlength=n)
    return _stretch(could, np.bincount(frame[known & (_decisions(run) >= 0)], minlength=n), could > 0, Code.UNPAIRED)


def _unseen(run: Run, inputs: Inputs) -> Notice | None:
    """A stretch of SLAM in which the landmarks in view are hardly ever detected."""
    if inputs.map is not None or run.map is None or run.online is None:
        return None
    if not inputs.locates_points:  # whether a wall is in view depends on where it ends
        return None
    could, did, sensed = former_observations(run, inputs)
    rate = min(1.0, did.sum() / could.sum()) if could.sum() else 0.0
    if rate <= 0.0:
        return None
    # neighbours are occluded together, so a low detection probability needs a longer stretch
    return _stretch(rate * could, did, sensed, Code.MISSED, OBSERVATIONS / rate)


def former_observations(run: Run, inputs: Inputs) -> tuple[Array, IntArray, BoolArray]:
    """By frame (N,): old landmarks in view, old landmarks that were paired, and whether there was an observation. A
    landmark is old `OLD` frames after its initialization, if it was observed `ESTABLISHED` times.
    """
    assert run.map is not None
    assert run.online is not None
    settled = run.map.times_seen >= ESTABLISHED
    number, xy, first = run.map.number[settled], run.map.xy[settled], run.map.first_frame[settled]
    n, frame = len(inputs), inputs.observations.frame
    slot = np.clip(np.searchsorted(number, run.decisions), 0, max(len(number) - 1, 0))
    paired = np.isin(run.decisions, number)
    paired[paired] = frame[paired] >= first[slot[paired]] + OLD
    sensed: BoolArray = np.bincount(frame, minlength=n) > 0
    could, s = np.zeros(n), inputs.sensor
    middle, half = 0.5 * (s.min_angle + s.max_angle), 0.5 * (s.max_angle - s.min_angle)
    for k in np.flatnonzero(sensed):
        r, angle = s.polar(s.predict(run.online.pose[k], xy[first <= k - OLD])).T
        could[k] = ((r < EDGE * s.max_range) & (np.abs(angle - middle) < EDGE * half)).sum()  # well inside
    return could, np.bincount(frame[paired], minlength=n), sensed


def _absurd(run: Run, inputs: Inputs) -> Notice | None:
    """Innovations, or a smoother's cost, that no noise explains."""
    frame = inputs.observations.frame
    if run.innovations is not None:
        squared = np.sum(run.innovations.white**2, axis=1)
        used = np.flatnonzero(np.isfinite(squared))
        wild = squared[used] > ABSURD
        if len(wild) >= TOGETHER:
            row = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(wild, TOGETHER).all(axis=1))
            if len(row):
                return notice(Code.TEN_SIGMA, int(frame[used[row[0]]]), innovations=TOGETHER)
    total = run.total_nis
    if total is not None and total[1] > 0 and total[0] / total[1] > ABSURD:
        return notice(Code.NIS, 0, per_dof=total[0] / total[1], over_run=False)
    return None


def _by_chance(run: Run) -> Notice | None:
    """Few pairings whose innovations fill the gate."""
    total, expected = run.total_nis, gated(run, run.phases[-1])[0]
    if total is None or total[1] < OBSERVATIONS or expected > 0.9995 or not len(_decisions(run)):
        return None
    nis, used = total[0] / total[1], float((_decisions(run) >= 0).mean())
    return None if nis < CHANCE * expected or used > USED else notice(Code.BY_CHANCE, 0, used=used, nis=nis)


def _stretch(
    could: Array | IntArray, did: IntArray, sensed: BoolArray, code: Code, enough: float = OBSERVATIONS
) -> Notice | None:
    """The first stretch of the frames `sensed` (N,) with `did` (N,) below a tenth of `could` (N,)."""
    at = np.flatnonzero(sensed)
    sums = np.concatenate([[0.0], np.cumsum(could[at])])
    done = np.concatenate([[0], np.cumsum(did[at])])
    need = enough if enough > OBSERVATIONS else min(enough, sums[-1])  # a log that is too short is one stretch
    if len(at) == 0 or not 1.0 <= need <= sums[-1]:
        return None
    begin = np.arange(len(at))
    end = np.maximum(np.searchsorted(sums, sums[:-1] + need - 1e-9), np.minimum(begin + FRAMES, len(at)))
    whole = (end <= len(at)) & (end - begin >= min(FRAMES, len(at)))
    end = np.minimum(end, len(at))
    bad = np.flatnonzero(whole & (done[end] - done[begin] < SHARE * (sums[end] - sums[begin])))
    if not len(bad):
        return None
    i, j = int(bad[0]), int(end[bad[0]])
    first, last = int(at[i]), int(at[j - 1])
    return notice(code, first, did=int(done[j] - done[i]), could=float(sums[j] - sums[i]), last=last)


def _decisions(run: Run) -> IntArray:
    return run.decisions if run.online is not None else run.final_decisions


def informed(run: Run) -> bool:
    """Whether a run had innovations, if only of other robots."""
    return run.total_nis is not None and run.total_nis[1] > 0


def unused(run: Run, inputs: Inputs | None = None) -> Notice | None:
    """A notice where hardly any observation is paired, or there is none; None where fixes or closures were used."""
    sources = (run.fixes, run.closures, run.fixes_final, run.closures_final)
    if run.association == "none" or run.failure is not None or any(s is not None and s.used.any() for s in sources):
        return None
    used, seen = int((run.final_decisions >= 0).sum()), len(run.final_decisions)
    nothing = not seen and inputs is not None and inputs.scans is None and not run.handed_in and not informed(run)
    if not nothing and (seen < FEWEST or used >= UNUSED * seen):
        return None
    moves = inputs is None or bool(np.any(inputs.increments.mean))
    found = notice(Code.UNUSED, used=used, readings=seen, task=run.task, moves=moves)
    return found.about(estimator=run.estimator, association=run.association)

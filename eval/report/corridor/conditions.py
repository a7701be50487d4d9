"""Two of the lab's questions, about what is around the method: no odometry, and map maintenance."""

from __future__ import annotations

import math

import numpy as np

from data.result import Run
from data.se2 import Array
from data.truth import CLUTTER
from eval.page.numbers import number
from eval.plan.lab import switched_on
from eval.referee.errors import landmark_true_ids, position_distance
from eval.referee.score import Scores, Trial
from eval.report.corridor.facts import Lab, furthest_from_start, look, pair_of, run_of, true_against_stated
from eval.report.corridor.phrases import BLIND, NAMES, PEOPLE, WORSE, count_move, missing, move, plural, rmse


def without_odometry(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """Known association and JCBB when the wheels are not read."""
    trial = lab.trials.get(BLIND)
    known, jcbb = run_of(trial, "known"), run_of(trial, "jcbb")
    if trial is None or (known is None and jcbb is None):
        return missing(lab, BLIND, "known", "jcbb"), False
    m, truth = true_against_stated(trial.log), trial.log.truth.pose
    assert truth is not None
    notes = [
        f"On `{trial.log.name}` no motion is stated, with standard deviations meant to cover it. The true motions are"
        f" on average {number(m.moves, 2)} σ from that (moves)"
        + (f" and {number(m.turns, 2)} σ (turns)" if math.isfinite(m.turns) else "")
        + f": a step of {number(m.step_off, 3)} m where σ is {number(m.step_sigma, 2)} m. Of {m.count} motions"
        f" {m.within} are inside the 99 % ellipsoid of what is stated"
        + (
            ": what is stated is wrong and not merely uncertain."
            if m.within < 0.5 * m.count
            else ", so the statement is not unreasonable."
        )
    ]
    for run in (known, jcbb):
        if run is None:
            continue
        notes.append(_how_it_ends(trial, run, scores, truth))
    if known is not None and jcbb is None:
        notes.append("JCBB was not run on this log.")
    smoother = trial.find("batch", "known")
    if known is not None and smoother is not None and smoother.flaw is None:
        a, b = rmse(scores, trial, known), rmse(scores, trial, smoother, "final")
        if b < a / WORSE:
            notes.append(
                f"With the same pairings the batch smoother has {number(b)} m: the readings would suffice, but"
                f" {known.estimator} linearizes each frame at a prediction that is a whole motion off, once and for"
                " all."
            )
        else:
            notes.append(f"The batch smoother with the same pairings is no better ({number(b)} m).")
    if jcbb is not None:
        c = look(jcbb, trial.log).counts
        if c.fp > c.tp:
            notes.append(
                f"JCBB makes {c.fp} wrong pairings and {c.tp} right ones: the points look alike and repeat, so that a"
                " robot which stands still is a consistent explanation, too, and the joint test asks for consistency"
                " only."
            )
        else:
            notes.append(f"JCBB still gets {c.tp} pairings right and {c.fp} wrong.")
    return " ".join(notes), True


def _how_it_ends(trial: Trial, run: Run, scores: Scores, truth: Array) -> str:
    path = run.trajectory("online").pose
    off = position_distance(path, truth)
    name = NAMES[run.association]
    m = scores.metrics
    same = (m["log"] == trial.log.name) & (m["estimator"] == run.estimator) & (m["association"] == run.association)
    nees = m[same & (m["phase"] == "online")]["nees_pose"].tolist()
    sure = f", mean pose NEES {number(float(nees[0]))} where 3 is expected" if nees and nees[0] is not None else ""
    far, reached = float(np.nanmax(off)), [number(furthest_from_start(p)) for p in (path, truth)]
    mark = "" if run.doubt is None else f", {run.status} from frame {run.doubt.frame} on,"
    return (
        f"With {name} {run.estimator}{mark} has a position RMSE of {number(rmse(scores, trial, run))} m, is up to"
        f" {number(far)} m off and {number(float(off[-1]))} m at the end{sure}; it believes to have been at most"
        f" {reached[0]} m from the start (in truth {reached[1]} m)."
    )


def what_maintenance_changes(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """JCBB with and without map maintenance, where there are people; other methods if it was not run."""
    for switches in (PEOPLE, *lab.maintained):
        plain, kept = lab.trials.get(switches), lab.maintained.get(switches)
        for method in ("jcbb", "nn", "singles"):
            both = pair_of(plain, kept, method)
            if plain is not None and kept is not None and both is not None:
                return _maintained(plain, kept, *both, scores), True
    return missing(lab, PEOPLE, "jcbb", maintained=True), False


def _maintained(plain: Trial, kept: Trial, a: Run, b: Run, scores: Scores) -> str:
    before, after = look(a, plain.log).counts, look(b, kept.log).counts
    sizes = [0 if r.map is None else len(r.map) for r in (a, b)]
    people, _ = switched_on(plain.log)
    notes = [
        f"On `{plain.log.name}` with {NAMES[a.association]} ({a.estimator}) the map ends with {sizes[1]} landmarks with"
        f" maintenance and {sizes[0]} without."
    ]
    if b.removed is not None and np.any(b.removed >= 0):
        ids = landmark_true_ids(b.created, kept.log.truth, np.flatnonzero(b.removed >= 0))
        ghosts = int((ids == CLUTTER).sum())
        notes.append(
            f"It removed {plural(len(ids), 'landmark')} that had been seen only once, {ghosts} of them initialized on"
            f" people and {len(ids) - ghosts} on points."
        )
    else:
        notes.append("It removed nothing.")
    if a.state_size is not None and b.state_size is not None:
        mean = [float(np.mean(r.state_size)) for r in (a, b) if r.state_size is not None]
        entries = [float(np.sum(np.asarray(r.state_size, float) ** 2)) for r in (a, b) if r.state_size is not None]
        notes.append(
            f"The state is {number(mean[1])} long on average ({number(mean[0])} without), so an update that touches"
            f" the whole covariance handles {100.0 * entries[1] / entries[0]:.0f} % of the entries over the run; the"
            " seconds are in `timing.csv`."
        )
    notes.append(
        f"FP are {count_move(before.fp, after.fp)} (spurious: {count_move(before.spurious, after.spurious)}), FN"
        f" {count_move(before.fn, after.fn)}, and the position RMSE"
        f" {move(rmse(scores, plain, a), rmse(scores, kept, b))} m."
    )
    if sizes[1] >= sizes[0]:
        notes.append("Here it made the map no smaller.")
    elif after.fp >= before.fp:
        notes.append(
            "It makes the map smaller and not the pairings better: who is seen twice in a row"
            + (", as people who walk slowly are, stays." if people else " stays.")
        )
    else:
        notes.append(
            "The map is smaller and fewer pairings are wrong: what is gone cannot be taken for something else."
        )
    return " ".join(notes)

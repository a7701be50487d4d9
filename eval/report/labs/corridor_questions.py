"""The corridor lab's five questions, answered from the runs of a report: pure functions of trials and scores to text.

Every number is taken from the runs, and every sentence turns round where the numbers do. Seconds differ from run to
run, so they stand in timing.csv only; here the cost of a filter is counted in covariance entries.

Two of the lab's questions, about what is around the method: no odometry, and map maintenance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from data.result import Run
from data.se2 import Array
from data.truth import CLUTTER
from eval.plan.lab import switched_on
from eval.referee.errors import landmark_true_ids, position_distance
from eval.referee.score import Scores, Trial
from eval.report.labs.corridor_ambiguity import ambiguity_sections, prior_sections
from eval.report.labs.corridor_facts import (
    BLIND,
    NAMES,
    ODOMETRY,
    PEOPLE,
    WORSE,
    Lab,
    Pairings,
    count_change,
    count_move,
    find_lab,
    furthest_from_start,
    look,
    missing,
    move,
    pair_of,
    plural,
    rmse,
    run_of,
    share,
    true_against_stated,
)
from eval.report.page.document import Section
from eval.report.page.tables import number


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


def lab_sections(trials: Sequence[Trial], scores: Scores, *, answered_above: bool = False) -> list[Section]:
    """The section with its questions; nothing where no corridor was run with what at least one of them needs.

    `answered_above`: the questions stand elsewhere, and only what goes beyond them is said here.
    """
    lab = find_lab(trials)
    if lab is None:
        return []
    if answered_above:
        beyond = [*ambiguity_sections(lab), *prior_sections(lab, scores)]
        return [Section("More on the lab", ()), *beyond] if beyond else []
    questions: tuple[tuple[str, Callable[[Lab, Scores], tuple[str, bool]]], ...] = (
        ("Why does NN fail?", why_nn_fails),
        ("Why do people break NN and SINGLES?", why_people_break_it),
        ("Why does JCBB cope better?", why_jcbb_copes),
        ("What happens without odometry?", without_odometry),
        ("What does map maintenance change?", what_maintenance_changes),
    )
    answered = [(head, *ask(lab, scores)) for head, ask in questions]
    if not any(known for _, _, known in answered) and not lab.primed:
        return []
    logs = ", ".join(f"`{t.log.name}`" for t in (*lab.trials.values(), *lab.maintained.values(), *lab.primed.values()))
    first = f"Answered from the runs on {logs}: SLAM, decisions and paths as they were online."
    sections = [Section(head, (text,), 3) for head, text, _ in answered]
    blind = [head for head, _ in questions].index("What happens without odometry?")
    return [
        Section("The lab's questions", (first,)), *sections[:blind], *ambiguity_sections(lab), sections[blind],
        *prior_sections(lab, scores), *sections[blind + 1 :],
    ]  # fmt: skip


def why_nn_fails(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """NN beside known association, without people."""
    trial = lab.trials.get(ODOMETRY)
    nn, known = run_of(trial, "nn"), run_of(trial, "known")
    if trial is None or nn is None or known is None:
        return missing(lab, ODOMETRY, "nn", "known"), False
    p = look(nn, trial.log)
    c = p.counts
    mine, best = rmse(scores, trial, nn), rmse(scores, trial, known)
    where = f"On `{trial.log.name}` NN ({nn.estimator})"
    if p.first_wrong is None:
        return (
            f"{where} does not fail: none of its {c.tp} pairings is wrong, and its position RMSE is {number(mine)} m"
            f" ({number(best)} m with known association).",
            True,
        )
    notes = [
        f"{where} pairs {c.fp} of {len(c.outcome)} observations wrongly: {p.neighbour} with the landmark of another"
        f" point though their own was in the map, {p.copy} with a second landmark of their own point, {c.spurious}"
        " though their point was not in the map yet."
    ]
    if math.isfinite(p.apart):
        notes.append(
            f"The points confused are {number(p.apart, 2)} m apart (median), and these observations, placed in the"
            f" world from the predicted pose, are {number(p.off, 2)} m off their own point:"
            + (
                " more than half that spacing, enough to make another landmark the nearest one; and since each"
                " observation is decided on its own, nothing notices that all are off the same way."
                if p.off >= 0.5 * p.apart
                else " less than half that spacing, so the error of the pose alone does not explain them."
            )
        )
    if math.isfinite(p.before):
        notes.append(
            f"The first wrong pairing is in frame {p.first_wrong}; the position error is {number(p.before)} m RMS"
            f" before and {number(p.after)} m from then on."
        )
    else:
        notes.append(f"The first wrong pairing is in frame {p.first_wrong} already.")
    size = 0 if nn.map is None else len(nn.map)
    points = len(known.map) if known.map is not None else 0
    notes.append(
        f"It initializes {plural(c.duplicate, 'landmark')} on points that were in the map already, and its map ends"
        f" with {size} landmarks where known association has {points}."
    )
    notes.append(
        f"The position RMSE is {number(mine)} m against {number(best)} m with known association"
        + (
            f", {number(mine / best, 2)} times as large."
            if mine > WORSE * best
            else ": on this log the wrong pairings cost little."
        )
    )
    return " ".join(notes), True


def why_people_break_it(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """NN and SINGLES with and without people."""
    quiet, busy = lab.trials.get(ODOMETRY), lab.trials.get(PEOPLE)
    found = [(m, run_of(quiet, m), run_of(busy, m)) for m in ("nn", "singles")]
    pairs = [(m, a, b) for m, a, b in found if a is not None and b is not None]
    if quiet is None or busy is None or not pairs:
        switches = PEOPLE if quiet is not None else ODOMETRY
        return missing(lab, switches, "nn", "singles"), False
    notes: list[str] = []
    broken: list[str] = []
    ghosts = points = 0
    for method, without, with_people in pairs:
        a, b = look(without, quiet.log), look(with_people, busy.log)
        if not notes:
            notes.append(f"On `{busy.log.name}` {b.clutter} of {len(b.counts.outcome)} observations show people.")
        ghosts, points = ghosts + b.clutter_again, points + b.clutter_paired - b.clutter_again
        before, after = rmse(scores, quiet, without), rmse(scores, busy, with_people)
        if after > WORSE * before:
            broken.append(NAMES[method])
        notes.append(
            f"**{NAMES[method]}** pairs {b.clutter_paired} of them, {b.clutter_again} with a landmark initialized on a"
            f" person and {b.clutter_paired - b.clutter_again} with one of a point, and initializes"
            f" {plural(b.clutter_initializing, 'landmark')} on others."
            + (
                f" {plural(b.ghost, 'observation')} of points {'is' if b.ghost == 1 else 'are'} paired with people's"
                " landmarks."
                if b.ghost
                else ""
            )
            + f" FP {count_change(a.counts.fp, b.counts.fp)}, recall is {share(a.counts.recall)} without people and"
            f" {share(b.counts.recall)} with them, the position RMSE {move(before, after)} m."
        )
        if method == "singles":
            notes.append(_unpaired(a, b))
    if broken:
        notes.append(f"People break {' and '.join(broken)} here. {_pulled(ghosts, points)}")
    else:
        notes.append("So people do not break them on this log: the errors are hardly larger than without.")
    for method, without_people, with_them in found:
        if without_people is None or with_them is None:
            notes.append(f"{NAMES[method]} was not run on both logs.")
    return " ".join(notes), True


def _pulled(ghosts: int, points: int) -> str:
    """How pairings of people do harm, by what they are mostly paired with."""
    if not ghosts + points:
        return "None of them is paired, so what does harm are the landmarks initialized on them."
    what = (
        "a landmark initialized on a person has moved on when it is paired again"
        if ghosts >= points
        else "a person in the gate of a point passes as that point"
    )
    return (
        f"Mostly {what}, and since no pairing is held against the others of the frame, it pulls the pose of the robot"
        " along; pairings of points that are tested alone go wrong in turn."
    )


def _unpaired(a: Pairings, b: Pairings) -> str:
    """What the caution of SINGLES costs."""
    fewer = "fewer" if b.counts.tp < a.counts.tp else "not fewer"
    return (
        f"It leaves {b.counts.missed} observations of points unpaired that were in the map ({a.counts.missed} without"
        " people), as whatever has a second candidate is not used: right pairings to correct the pose with are"
        f" {fewer}, {b.counts.tp} ({a.counts.tp} without people)."
    )


def why_jcbb_copes(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """JCBB beside NN, SINGLES and known association on the same log: with people, or else without."""
    switches = next((s for s in (PEOPLE, ODOMETRY) if run_of(lab.trials.get(s), "jcbb") is not None), PEOPLE)
    trial = lab.trials.get(switches)
    jcbb, nn = run_of(trial, "jcbb"), run_of(trial, "nn")
    if trial is None or jcbb is None or nn is None:
        return missing(lab, switches, "jcbb", "nn"), False
    notes, seen, errors = [], {}, {}
    for method in ("jcbb", "nn", "singles", "known"):
        run = run_of(trial, method)
        if run is not None:
            seen[method], errors[method] = look(run, trial.log), rmse(scores, trial, run)
    rows = [f"{NAMES[m]} {p.counts.fp} / {p.counts.fn} / {number(errors[m])} m" for m, p in seen.items()]
    notes.append(f"FP / FN / position RMSE on `{trial.log.name}` ({jcbb.estimator}): {'; '.join(rows)}.")
    mine, other = seen["jcbb"], seen["nn"]
    wrong = (mine.counts.fp + mine.counts.fn, other.counts.fp + other.counts.fn)
    notes.append(
        f"Pairings with the landmark of another point: JCBB {mine.neighbour}, NN {other.neighbour}; people paired:"
        f" {mine.clutter_paired} and {other.clutter_paired} of {mine.clutter}."
        if mine.clutter
        else f"Pairings with the landmark of another point: JCBB {mine.neighbour}, NN {other.neighbour}."
    )
    if mine.clutter_paired:
        notes.append(
            f"Of the people that JCBB pairs, {mine.clutter_again} go to a landmark initialized on a person:"
            + (
                " somebody who walks slowly agrees with the map nearly as well as a point does."
                if 2 * mine.clutter_again >= mine.clutter_paired
                else " most are taken for points."
            )
        )
    if wrong[0] < wrong[1] and errors["jcbb"] < errors["nn"]:
        notes.append(
            "The pairings of a frame share one error of the pose, and JCBB accepts only those that agree on it: a"
            " person or a neighbour may be in the gate of a landmark, but rarely where the other pairings say that"
            " landmark should be seen."
        )
    else:
        notes.append(
            f"JCBB does not cope better than NN here ({wrong[0]} wrong decisions against {wrong[1]}, RMSE"
            f" {number(errors['jcbb'])} m against {number(errors['nn'])} m): that pairings agree with each other does"
            " not make them right."
        )
    if "known" in errors:
        close = errors["jcbb"] <= WORSE * errors["known"]
        notes.append(
            f"Its path is {'about as good as' if close else 'still worse than'} with known association"
            f" ({number(errors['jcbb'] / errors['known'], 2)} times the RMSE)."
        )
    return " ".join(notes), True

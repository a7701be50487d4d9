"""Of many runs the few that are drawn: known association, joint compatibility, and the one that went astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.notice import stopped
from data.result import Failure
from eval.figures.figure_style import FigureStyle, figure_style
from eval.figures.growth import growing as for_growth
from eval.figures.kinds import every, for_map, for_panels, left_out, worst
from eval.referee.score import Trial
from eval.replay.settings import associations
from tests.eval.handmade import circle_log, run_with_error

PHASES = {"ekf": ("online",), "isam2": ("online", "final"), "batch": ("final",), "dead-reckoning": ("online",)}


def run(estimator, association, off=0.1, **more):
    error = np.array([off, 0.0, 0.0])
    return run_with_error(error, estimator=estimator, association=association, phases=PHASES[estimator], **more)


DEAD = run("dead-reckoning", "none", mapped=False)
KNOWN = [run(e, "known") for e in ("ekf", "isam2", "batch")]
OTHERS = [run("ekf", "nn", 2.0), run("ekf", "singles", 0.5), run("ekf", "gnn", 0.3)]
JCBB = [run(e, "jcbb") for e in ("ekf", "isam2", "batch")]
LAB = Trial(circle_log(), "slam", (DEAD, *KNOWN, *OTHERS, *JCBB))


def names(runs):
    return [(r.estimator, r.association) for r in runs]


def test_known_association_and_joint_compatibility_come_first():
    assert associations(LAB.runs) == ["known", "jcbb", "nn", "singles", "gnn"]


def test_a_map_of_few_runs_shows_all_of_them_and_one_of_many_the_telling_ones():
    few = [OTHERS[0], *KNOWN, DEAD]
    assert names(for_map(Trial(circle_log(), "slam", tuple(few)))) == names(few)
    assert names(for_map(LAB)) == [
        ("dead-reckoning", "none"), ("ekf", "known"), ("batch", "known"), ("ekf", "jcbb"), ("batch", "jcbb"),
        ("ekf", "nn"),
    ]  # fmt: skip


def test_a_map_with_several_associations_shows_a_smoother_with_its_final_path_only():
    alone, mixed = (for_map(Trial(circle_log(), "slam", tuple(runs))) for runs in (KNOWN, [*KNOWN, *JCBB[:2]]))
    assert [r.phases for r in alone] == [("online",), ("online", "final"), ("final",)]
    assert [r.phases for r in mixed] == [("online",), ("final",), ("final",), ("online",), ("final",)]


def test_the_worst_is_the_one_furthest_from_the_true_path_that_got_to_the_end():
    assert worst(LAB) is OTHERS[0]
    halted = run("ekf", "ml", 9.0, failure=Failure("diverged", 3, stopped("lost")))
    assert worst(Trial(LAB.log, "slam", (*LAB.runs, halted))) is OTHERS[0]
    assert worst(Trial(circle_log(truth=False), "slam", LAB.runs)) is None
    assert worst(Trial(LAB.log, "slam", tuple(KNOWN))) is None


def test_four_panels_show_filter_and_smoothers_and_the_final_path_once():
    shown = for_panels(LAB.runs[1:])
    assert names(shown) == [("ekf", "known"), ("ekf", "jcbb"), ("isam2", "jcbb"), ("batch", "jcbb")]
    assert shown[2].phases == ("online",)
    assert for_panels(KNOWN) == KNOWN


def test_without_the_batch_smoother_an_incremental_one_keeps_its_final_path():
    shown = for_panels([*KNOWN[:2], *OTHERS, *JCBB[:2]])
    assert names(shown) == [("ekf", "known"), ("ekf", "jcbb"), ("isam2", "jcbb")]
    assert shown[2].phases == ("online", "final")
    beside = for_panels([*KNOWN[:2], *JCBB[:2]], complete=("known",))
    assert [(r.estimator, r.association, r.phases) for r in beside][-1] == ("isam2", "jcbb", ("online", "final"))


def test_growth_is_shown_of_filter_and_incremental_smoother_under_known_association():
    assert names(for_growth(LAB)) == [("ekf", "known"), ("isam2", "known")]
    assert names(for_growth(Trial(LAB.log, "slam", (*OTHERS, *JCBB)))) == [("ekf", "jcbb"), ("isam2", "jcbb")]
    assert for_growth(Trial(LAB.log, "slam", (DEAD,))) == []


def test_a_caption_names_the_shown_only_if_others_are_not():
    assert left_out(LAB, LAB.runs) == ""
    halted = run("ekf", "ml", 9.0, failure=Failure("diverged", 3, stopped("lost")))
    few = Trial(LAB.log, "slam", (DEAD, *KNOWN, halted))
    assert left_out(few, KNOWN[:2]) == (
        " Not shown, for want of room: batch with known. Not shown, stopped before the end: ekf with ml."
    )
    assert "without covariances: batch with known" in left_out(few, KNOWN[:2], lambda run: "covariance")
    assert left_out(LAB, [KNOWN[0], JCBB[2]]) == (
        " Shown: ekf with known, batch with jcbb; files of all runs: `runs/`."
    )


def test_a_narrow_figure_of_errors_names_in_its_caption_what_it_has_no_room_for():
    mine = replace(run("isam2", "known"), estimator="MySlam")
    trial = Trial(circle_log(), "slam", (DEAD, KNOWN[0], KNOWN[2], mine))
    _, wide = every()["error"].drawn(trial, ())
    with figure_style(FigureStyle(width=3.4)):
        drawn, narrow = every()["error"].drawn(trial, ())
    assert wide["others"] == ""
    missing = [r.estimator for r in trial.runs[1:] if f"{r.estimator} with known" in narrow["others"]]
    assert len(missing) == 1
    assert len(drawn.axes) == 3 * 2
    assert "for want of room" in narrow["others"]


def test_growth_says_who_has_no_map_online():
    trial = Trial(circle_log(), "slam", (KNOWN[0], KNOWN[2]))
    _, facts = every()["growth"].drawn(trial, ())
    assert "Not shown, without a map online: batch with known." in facts["others"]

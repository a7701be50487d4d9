"""Of many runs the few that are drawn, and which pictures a log gets with what captions."""

from dataclasses import replace

import numpy as np
import pytest

from data.formats.results.path import GivenPath
from data.inputs import Systematic
from data.logs import open_log
from data.notice import stopped
from data.result import Failure, Systematics
from data.truth import Truth
from eval.figures.claims import growing as for_growth, nees_figure
from eval.figures.error import difference_figure, error_figure, has_outcomes
from eval.figures.kinds import every, for_map, for_panels, left_out, worst
from eval.figures.map import map_figure
from eval.judgement.runs import filters_in, judged_runs, smoothers_in
from eval.plan.flags.table import Output
from eval.referee.given.runs import TruePath, given_run
from eval.referee.result_files import rows_of
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.replay.settings import associations
from eval.report import publish
from eval.report.publish import draw, kinds, publish_runs
from tests.eval.handmade import FRAMES, circle_log, run_with_error

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


def test_a_map_of_few_runs_shows_all_and_one_of_many_the_telling_ones_with_final_paths_only():
    assert associations(LAB.runs) == ["known", "jcbb", "nn", "singles", "gnn"]
    few = [OTHERS[0], *KNOWN, DEAD]
    assert names(for_map(Trial(circle_log(), "slam", tuple(few)))) == names(few)
    assert names(for_map(LAB)) == [
        ("dead-reckoning", "none"), ("ekf", "known"), ("batch", "known"), ("ekf", "jcbb"), ("batch", "jcbb"),
        ("ekf", "nn"),
    ]  # fmt: skip
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
    shown = for_panels([*KNOWN[:2], *OTHERS, *JCBB[:2]])
    assert names(shown) == [("ekf", "known"), ("ekf", "jcbb"), ("isam2", "jcbb")]
    assert shown[2].phases == ("online", "final")
    beside = for_panels([*KNOWN[:2], *JCBB[:2]], complete=("known",))
    assert [(r.estimator, r.association, r.phases) for r in beside][-1] == ("isam2", "jcbb", ("online", "final"))


def test_growth_is_shown_of_filter_and_incremental_smoother_and_says_who_has_no_map():
    assert names(for_growth(LAB)) == [("ekf", "known"), ("isam2", "known")]
    assert names(for_growth(Trial(LAB.log, "slam", (*OTHERS, *JCBB)))) == [("ekf", "jcbb"), ("isam2", "jcbb")]
    assert for_growth(Trial(LAB.log, "slam", (DEAD,))) == []
    trial = Trial(circle_log(), "slam", (KNOWN[0], KNOWN[2]))
    _, facts = every()["growth"].drawn(trial, ())
    assert "Not shown, without a map online: batch with known." in facts["others"]


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


OFF = np.array([0.1, -0.1, 0.02])
FILTER = run_with_error(OFF)
BATCH = run_with_error(0.5 * OFF, estimator="batch", phases=("final",))
NN = run_with_error(OFF, association="nn")
WHEELS = replace(run_with_error(OFF, estimator="dead-reckoning", mapped=False), association="none")


def trial(*runs, log=None, task="slam", **more):
    return Trial(circle_log(name="hall") if log is None else log, task, runs, **more)


@pytest.fixture
def saved(monkeypatch):
    found = []
    monkeypatch.setattr(publish, "save_for_page", lambda draw, folder, stem, drawn: found.append((drawn, stem)))
    return found


def test_pictures_of_a_log_follow_its_truth_its_decisions_and_its_task():
    assert {"map", "error", "nees"} <= set(kinds(trial(FILTER)))
    assert not {"difference", "claims"} & set(kinds(trial(FILTER, BATCH)))
    blind = circle_log(truth=False, name="hall")
    assert {"map", "claims", "difference"} <= set(kinds(trial(FILTER, BATCH, log=blind)))
    assert not {"error", "nees", "growth"} & set(kinds(trial(FILTER, BATCH, log=blind)))
    assert "difference" not in kinds(trial(BATCH, log=blind)), "of batch from itself"
    assert "difference" not in kinds(trial(FILTER, NN, log=blind))
    assert not has_outcomes(trial(FILTER, BATCH))
    assert has_outcomes(trial(FILTER, NN))
    assert has_outcomes(trial(FILTER), [trial(NN)])
    blind = circle_log(name="hall")
    blind = replace(blind, truth=replace(blind.truth, landmark_of=None))
    assert not has_outcomes(trial(NN, log=blind))
    assert "growth" in kinds(trial(FILTER))
    known = replace(FILTER, task="localization", map=None)
    assert "growth" not in kinds(trial(known, log=circle_log(known_map=True), task="localization"))


def calibrated(run):
    found = Systematics(("scale",), np.full((FRAMES, 1), 0.02), np.full((FRAMES, 1), 0.01))
    return replace(run, errors_online=found)


def test_systematic_errors_have_a_picture_where_they_were_estimated(saved, tmp_path):
    log = circle_log(name="hall")
    log = replace(log, recorded=replace(log.recorded, systematic=Systematic(("scale",), np.array([0.05]))))
    given = trial(calibrated(FILTER), calibrated(NN), BATCH, log=log)
    assert "systematic" in kinds(given)
    assert "systematic" not in kinds(trial(FILTER, BATCH, log=log))
    assert "systematic" not in kinds(replace(given, variant_of="other"))
    picture = draw(tmp_path, given, "systematic")
    assert "association known" in picture.caption
    assert picture.alt.endswith("as ekf estimate them")


def test_files_are_written_of_every_run_and_films_only_where_asked_for(monkeypatch, tmp_path):
    written = []
    monkeypatch.setattr(publish, "write_run", lambda folder, t, run: written.append(run))
    monkeypatch.setattr(publish, "of_all", lambda table: [lambda *about: written.append(table)])
    monkeypatch.setattr(publish, "write_films", lambda folder, t, speed: written.append("films"))
    publish_runs(tmp_path, Output(), trial(FILTER, BATCH))
    assert written == ["files", FILTER, "run_files", BATCH, "run_files"]
    written.clear()
    publish_runs(tmp_path, Output(animate=True), trial(WHEELS, variant_of="other"))
    assert written == [WHEELS, "run_files", "films"]


LOG = circle_log()


def made(*runs):
    return Trial(LOG, "slam", tuple(run_with_error(0.01 * (i + 1), **run) for i, run in enumerate(runs)))


def test_who_brought_an_estimator_sees_it_as_filter_or_smoother_in_the_figures():
    trial = made({"estimator": "mine"}, {"estimator": "theirs", "phases": ("online", "final")}, {"estimator": "ekf"})
    rows = judged_runs(rows_of(score([trial]).metrics))
    assert [n for n in filters_in(rows) if n in ("mine", "theirs", "ekf")] == ["ekf", "mine"]
    assert [n for n in smoothers_in(rows) if n in ("mine", "theirs", "ekf")] == ["theirs"]
    names = ["ekf", "ekf-iterated", "isam2", "batch", "gnc", "mine"]
    trial = made(*({"estimator": n, "association": a} for a in ("known", "nn", "jcbb", "way") for n in names))
    for shown in (for_map(trial), for_panels(trial.runs), for_growth(trial)):
        assert "mine" in {r.estimator for r in shown}
        assert "ekf" in {r.estimator for r in shown}
    assert associations(trial.runs) == ["known", "way", "jcbb", "nn"]


ARENA = open_log("arena:0")
TRUE_PATH = TruePath(ARENA.recorded.time, ARENA.truth.pose)


@pytest.fixture(scope="module")
def handed_in():
    """Five phases of ours, and two results at a third of the frames, 30 ms late; one has no covariance."""
    runs = [r for a in ("known", "nn") for r in compare(ARENA.inputs(labels=True), "localization", ("ekf", "batch"), a)]
    time, pose = ARENA.recorded.time[:-1:3] + 0.03, ARENA.truth.pose[:-1:3] + 0.05
    certain = GivenPath("a.tum", "TUM", time, pose, np.tile(0.01 * np.eye(3), (len(time), 1, 1)), "local")
    a = given_run("a", "localization", {"final": certain}, ARENA, TRUE_PATH)
    b = given_run("b", "localization", {"online": GivenPath("b.tum", "TUM", time, pose)}, ARENA, TRUE_PATH, align="se2")
    return Trial(ARENA, "localization", (*runs, a, b))


def estimators(runs):
    return {r.estimator for r in runs}


def test_what_was_handed_in_is_shown_with_some_of_ours(handed_in):
    for chosen in (for_panels(handed_in.runs), for_map(handed_in)):
        assert {"a", "b"} < estimators(chosen)
    assert worst(handed_in).estimator in ("ekf", "batch")  # the others have other frames


def test_every_picture_takes_its_own_stamps_and_truth(handed_in):
    fig = error_figure(ARENA, for_panels(handed_in.runs))
    assert "b, aligned (online)" in [ax.get_title() for ax in fig.axes[:4]]
    line = next(ax for ax in fig.axes if ax.get_title() == "a (final)").lines[-1]
    assert len(line.get_xdata()) == len(ARENA.recorded.time[:-1:3])
    assert nees_figure(ARENA, for_panels(handed_in.runs)).axes
    assert map_figure(ARENA, for_map(handed_in)).axes


def test_without_truth_it_stands_beside_batch_at_its_own_stamps(handed_in):
    bare = replace(ARENA, truth=Truth())
    batch = handed_in.find("batch")
    pose = batch.final.pose[:-1:3].copy()
    pose[:, 0] += 0.5
    late = GivenPath("c.tum", "TUM", ARENA.recorded.time[:-1:3], pose)
    c = given_run("c", "localization", {"final": late}, bare, None)
    (_, row) = score([Trial(bare, "localization", (batch, c))]).metrics.to_dict("records")
    assert row["rms_from_batch_m"] == pytest.approx(0.5, rel=1e-12)
    drawn = difference_figure(bare, [c], batch).axes[0].lines[-1].get_ydata()
    assert drawn == pytest.approx(np.full(len(drawn), 0.5))


def test_results_in_space_have_a_file(tmp_path):
    from data.formats.results.reading import read_path
    from eval.referee.given.runs import TruePath, truth_log
    from eval.report.results import space_rows
    from tests.oracle.evo_numbers import files_in_space as files

    files(tmp_path)
    truth, estimate = (read_path(str(tmp_path / f"{name}.tum")) for name in ("truth", "estimate"))
    log = truth_log("truth", truth)
    run = given_run("a", "slam", {"final": estimate}, log, TruePath.of(truth), align="yaw")
    rows = {row["quantity"]: row["value"] for row in space_rows([Trial(log, "slam", (run,))])}
    assert rows["rmse_position_3d_m"] == pytest.approx(rows["rmse_position_3d_yaw_m"])

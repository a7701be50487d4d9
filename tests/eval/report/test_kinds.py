"""Which pictures a log gets, and what their captions say in numbers of the runs they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Systematic
from data.result import MapEstimate, Systematics, Trajectory
from eval.figures.association import has_outcomes
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.report import publish
from eval.report.publish import draw, kinds, publish_runs
from tests.eval.handmade import FRAMES, circle_log, run_with_error

ZERO, OFF = np.zeros(3), np.array([0.1, -0.1, 0.02])
FILTER = run_with_error(OFF)
BATCH = run_with_error(0.5 * OFF, estimator="batch", phases=("final",))
NN = run_with_error(OFF, association="nn")
WHEELS = replace(run_with_error(OFF, estimator="dead-reckoning", mapped=False), association="none")


def trial(*runs, log=None, task="slam", **more):
    return Trial(circle_log(name="hall") if log is None else log, task, runs, **more)


@pytest.fixture
def saved(monkeypatch):
    found = []
    monkeypatch.setattr(publish, "save", lambda fig, folder, stem, formats=None: found.append((fig, stem, formats)))
    return found


def test_a_log_with_truth_shows_errors_and_one_without_what_runs_say_of_themselves():
    assert {"map", "error", "nees"} <= set(kinds(trial(FILTER)))
    assert not {"difference", "claims", "fate"} & set(kinds(trial(FILTER, BATCH)))
    blind = circle_log(truth=False, name="hall")
    assert {"map", "claims", "difference"} <= set(kinds(trial(FILTER, BATCH, log=blind)))
    assert not {"error", "nees", "growth"} & set(kinds(trial(FILTER, BATCH, log=blind)))
    assert "difference" not in kinds(trial(BATCH, log=blind)), "of batch from itself"
    assert "difference" not in kinds(trial(FILTER, NN, log=blind))


def test_a_quick_report_shows_a_part_of_what_a_whole_one_does_in_the_same_order():
    whole, quick = kinds(trial(FILTER, BATCH, NN)), kinds(trial(FILTER, BATCH, NN), quick=True)
    assert list(quick) == ["map", "error", "association"]
    assert [k for k in whole if k in quick] == list(quick)
    assert len(whole) > len(quick)


def test_outcomes_are_those_of_decisions_that_were_made_here_or_beside():
    assert not has_outcomes(trial(FILTER, BATCH))
    assert has_outcomes(trial(FILTER, NN))
    assert has_outcomes(trial(FILTER), [trial(NN)])
    blind = circle_log(name="hall")
    blind = replace(blind, truth=replace(blind.truth, landmark_of=None))
    assert not has_outcomes(trial(NN, log=blind))


def test_growth_is_of_slam_with_truth_and_the_tests_without_truth_of_a_log_of_its_own_alone():
    assert "growth" in kinds(trial(FILTER))
    known = replace(FILTER, task="localization", map=None)
    assert "growth" not in kinds(trial(known, log=circle_log(known_map=True), task="localization"))
    assert "filter-smoother" in kinds(trial(FILTER, BATCH))
    assert "filter-smoother" not in kinds(trial(FILTER, BATCH, variant_of="other"))


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


def test_a_picture_is_saved_under_its_log_and_task(saved, tmp_path):
    picture = draw(tmp_path, trial(FILTER), "error")
    assert picture.stem == "hall-slam-error"
    assert [(stem, f) for _, stem, f in saved] == [("hall-slam-error", None)]
    assert picture.caption.startswith("`hall`, slam: error of each coordinate")


def test_the_growth_of_uncertainty_is_told_in_numbers_of_robot_and_landmarks(saved, tmp_path):
    sizes = np.linspace(0.1, 0.4, FRAMES)
    sizes[20] = 0.9
    path = Trajectory(FILTER.online.pose, sizes[:, None, None] ** 2 * np.eye(3))
    mapped = MapEstimate(
        np.array([0, 5, 6]), np.zeros((3, 2)), np.array([0.2, 0.8, 0.3])[:, None, None] ** 2 * np.eye(2),
        np.zeros(3, int), np.ones(3, int),
    )  # fmt: skip
    caption = draw(tmp_path, trial(replace(FILTER, online=path, map=mapped)), "growth").caption
    assert caption.endswith(
        "ekf: robot at most 0.900 m, 0.400 m at the end; first landmark 0.200 m, last 0.300 m, least certain 0.800 m"
        " (number 5)."
    )
    assert "dotted line" not in caption


def test_the_difference_from_batch_is_that_of_the_others_and_not_of_batch_itself(saved, tmp_path):
    picture = draw(tmp_path, trial(FILTER, BATCH, log=circle_log(truth=False, name="hall")), "difference")
    fig = saved[0][0]
    assert len(fig.axes) == 1
    assert "EKF" in fig.axes[0].get_title(loc="left")
    assert "no error, as the log has no ground truth." in picture.caption


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

"""Bad ground truth and a map with swapped rows: what is scored, and what the headline says first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.formats.mrclam.load import load_mrclam
from data.formats.open_log.writer import write_folder
from data.inputs import LandmarkMap
from data.log import Log
from data.logs import open_log
from data.truth_windows import scored
from eval.compare import compare
from eval.judgement.judgement import Judgement, Verdict, judge
from eval.judgement.runs import Objection
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.referee.lost import lost
from eval.referee.score import Trial
from eval.replay.settings import Setup
from eval.report.overview import trust_mark
from eval.report.terminal import trust_line


def judged(log: Log) -> tuple[Judgement, Trial]:
    """Localization with sensed labels, which are gated."""
    runs = compare(log.inputs(labels=True), "localization", ("ekf", "batch"), "known", Setup().settled(sensed=True))
    trial = Trial(log, "localization", tuple(runs))
    return judge(trial), trial


def swapped(log: Log) -> Log:
    """The two landmarks that are observed most often change places in the map."""
    known, (ids, times) = log.recorded.map, np.unique(log.truth.landmark_of, return_counts=True)
    xy, rows = known.xy.copy(), known.rows(ids[np.argsort(times)[-2:]])
    xy[rows] = xy[rows[::-1]]
    return replace(log, recorded=replace(log.recorded, map=LandmarkMap(known.id, xy)), labels_are_sensed=True)


def test_swapped_map_rows_are_the_first_objection_and_no_tick_stands_there():
    facts, _ = judged(swapped(open_log("arena:3")))
    assert facts.objections[0].objection is Objection.MAP
    assert facts.tone != "good"
    mark = trust_mark(facts)
    assert mark.note.startswith("map rows ")
    assert "look swapped" in trust_line(facts)


def test_right_maps_have_no_such_objection():
    facts, _ = judged(open_log("arena:3"))
    assert facts.log_faults.map_rows is None
    assert facts.tone == "good"


def bad(log: Log) -> Log:
    pose = log.truth.pose.copy()
    pose[70:111, :2] += [2.0, -2.0]
    return replace(log, truth=replace(log.truth, pose=pose))


def test_a_bad_window_is_no_error_of_an_estimator():
    log = bad(open_log("arena:3"))
    kept, _ = judged(scored(log, keep=True))
    left_out, _ = judged(log)
    assert kept.compared.smoothed.nees > 100.0 > 9.0 > left_out.compared.smoothed.nees
    assert [j.tone == "good" for j in (kept, left_out)] == [False, True]


@pytest.mark.parametrize(
    ("flags", "missing"),
    [
        ([], set(range(70, 111))),
        (["--keep-truth"], set()),
        (["--keep-truth", "--exclude-truth", "0:1"], {0, 1, 2}),
        (["--exclude-truth", "35:55"], set(range(70, 111))),
    ],
)
def test_run_scores_what_its_flags_say(tmp_path, flags, missing):
    write_folder(bad(open_log("arena:3")), tmp_path / "log")
    (experiment,) = make_plan(read_options([str(tmp_path / "log"), *flags]), print).experiments
    assert set(np.flatnonzero(np.isnan(experiment.log.truth.pose[:, 0])).tolist()) == missing
    assert bool(experiment.log.truth.left_out) == (not flags)


@pytest.mark.slow
def test_utias_dataset_1_as_published_is_not_lost_but_has_swapped_rows(mrclam):
    facts, trial = judged(load_mrclam(mrclam / "MRCLAM_Dataset1.zip", 1))
    for run in trial.runs:  # without the truth it looks lost
        assert lost(run, trial.log.recorded, trial.log.granted) is not None
        assert (run.estimator, run.association) not in trial.lost
    assert (facts.verdict, facts.unusable) == (Verdict.SMOOTHER, ())
    assert [o.objection for o in facts.objections] == [Objection.MAP]
    assert facts.log_faults.map_rows.named["swapped"] == (11, 17)
    assert trust_mark(facts).note.startswith("map rows 11 and 17 look swapped")

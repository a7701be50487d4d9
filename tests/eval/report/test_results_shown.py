"""Results that were handed in are in the pictures, with stamps of their own, whatever else was run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.formats.results.path import GivenPath
from data.logs import open_log
from data.truth import Truth
from eval.figures.claims import nees_figure
from eval.figures.error import difference_figure, error_figure
from eval.figures.kinds import for_map, for_panels, worst
from eval.figures.map import map_figure
from eval.referee.given.runs import TruePath, given_run
from eval.referee.score import Trial, score
from eval.replay.run import compare

LOG = open_log("arena:0")
KNOWN = TruePath(LOG.recorded.time, LOG.truth.pose)


@pytest.fixture(scope="module")
def trial():
    """Five phases of ours, and two results at a third of the frames, 30 ms late; one has no covariance."""
    runs = [r for a in ("known", "nn") for r in compare(LOG.inputs(labels=True), "localization", ("ekf", "batch"), a)]
    time, pose = LOG.recorded.time[:-1:3] + 0.03, LOG.truth.pose[:-1:3] + 0.05
    certain = GivenPath("a.tum", "TUM", time, pose, np.tile(0.01 * np.eye(3), (len(time), 1, 1)), "local")
    a = given_run("a", "localization", {"final": certain}, LOG, KNOWN)
    b = given_run("b", "localization", {"online": GivenPath("b.tum", "TUM", time, pose)}, LOG, KNOWN, align="se2")
    return Trial(LOG, "localization", (*runs, a, b))


def names(runs):
    return {r.estimator for r in runs}


def test_what_was_handed_in_is_shown_with_some_of_ours(trial):
    for chosen in (for_panels(trial.runs), for_panels(trial.runs, 3), for_map(trial), for_map(trial, 4)):
        assert {"a", "b"} < names(chosen)
    assert worst(trial).estimator in ("ekf", "batch")  # the others have other frames


def test_every_picture_takes_its_own_stamps_and_truth(trial):
    fig = error_figure(LOG, for_panels(trial.runs))
    titles = [ax.get_title() for ax in fig.axes[:4]]
    assert "b, aligned (online)" in titles
    line = next(ax for ax in fig.axes if ax.get_title() == "a (final)").lines[-1]
    assert len(line.get_xdata()) == len(LOG.recorded.time[:-1:3])
    assert nees_figure(LOG, for_panels(trial.runs)).axes
    assert map_figure(LOG, for_map(trial)).axes


def test_without_truth_it_stands_beside_batch_at_its_own_stamps(trial):
    bare = replace(LOG, truth=Truth())
    batch = trial.find("batch")
    pose = batch.final.pose[:-1:3].copy()
    pose[:, 0] += 0.5
    late = GivenPath("c.tum", "TUM", LOG.recorded.time[:-1:3], pose)
    c = given_run("c", "localization", {"final": late}, bare, None)
    (_, row) = score([Trial(bare, "localization", (batch, c))]).metrics.to_dict("records")
    assert row["rms_from_batch_m"] == pytest.approx(0.5, rel=1e-12)
    drawn = difference_figure(bare, [c], batch).axes[0].lines[-1].get_ydata()
    assert drawn == pytest.approx(np.full(len(drawn), 0.5))


def test_a_result_is_in_no_comparison_of_filter_and_smoother_frame_by_frame(trial):
    table = score([trial]).differences
    assert not (set(table["a"]) | set(table["b"])) & {"a", "b"}


def test_results_without_covariance_alone_end_in_no_empty_words(tmp_path, capsys):
    from eval.run_all import main

    rows = "\n".join(f"{k} {0.5 * k} {0.1 * k} 0.2 0 0 0 1" for k in range(30))
    for name in ("a", "gt"):
        (tmp_path / f"{name}.tum").write_text(rows + "\n")
    command = ["--truth", f"{tmp_path}/gt.tum", "--result", f"a={tmp_path}/a.tum", "--out", f"{tmp_path}/out"]
    assert main([*command, "--no-plots"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert not [line for line in said if line.strip() == "()" or "nothing ran" in line]


def test_results_in_space_have_a_table_a_file_and_two_projections(tmp_path):
    from data.formats.results.reading import read_path
    from eval.figures.map import space_figure
    from eval.referee.given.runs import TruePath, truth_log
    from eval.report.publish import kinds
    from eval.report.results import space_rows
    from tests.oracle.evo_space import files

    files(tmp_path)
    truth, estimate = (read_path(str(tmp_path / f"{name}.tum")) for name in ("truth", "estimate"))
    log = truth_log("truth", truth)
    run = given_run("a", "slam", {"final": estimate}, log, TruePath.of(truth), align="yaw")
    trial = Trial(log, "slam", (run,))
    rows = {row["quantity"]: row["value"] for row in space_rows([trial])}
    assert rows["rmse_position_3d_m"] == pytest.approx(rows["rmse_position_3d_yaw_m"])
    assert "space" in kinds(trial)
    above, side = space_figure(trial.runs).axes
    drawn = above.lines[1].get_xydata(), side.lines[1].get_xydata()
    assert drawn[0] == pytest.approx(run.space["final"].estimate.position[:, :2])
    assert drawn[1] == pytest.approx(run.space["final"].estimate.position[:, ::2])
    assert "space" not in kinds(replace(trial, runs=(replace(run, space={}),)))

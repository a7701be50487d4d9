"""The recorded UTIAS logs through the whole product: the accuracy that the README states, and the tutorials' rows."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from association.expectation import gate_threshold
from data.convert.__main__ import main as convert
from data.formats.mrclam.load import Treatment, load_mrclam
from eval.plan.flags.options import read_options
from eval.plan.tutorials import original_of, tutorial_run, variant_log
from eval.referee.score import Trial, metrics_row
from eval.replay.batch import batch
from eval.replay.run import compare, filter_known
from eval.replay.settings import Setup
from eval.run_all import main

pytestmark = pytest.mark.usefixtures("tables_parsed_once")
BAD = [(755.0, 836.0), (945.0, 1050.0)]


def errors(source, robot, **options):
    """Position RMSE [m] of the gated EKF online and of batch-cauchy over its pairings, localization."""
    log = load_mrclam(source, robot, Treatment(**options))
    inputs = log.inputs(labels=True)
    front = filter_known(inputs, "localization", threshold=gate_threshold(0.9999))
    smoothed = batch("batch-cauchy", inputs, front)
    rows = metrics_row(front, "online", log, None), metrics_row(smoothed, "final", log, None)
    return np.array([[r["rmse_position_m"], r["rmse_time_m"]] for r in rows], float)


@pytest.mark.slow
def test_dataset_9_on_which_the_numbers_were_tuned(shared_data):
    ekf, cauchy = errors(shared_data / "mrclam" / "MRCLAM_Dataset9.zip", 3, exclude_truth=BAD)
    assert ekf[0] < 0.04
    assert cauchy[0] < 0.033


@pytest.mark.slow
def test_dataset_6_on_which_they_were_not(shared_data):
    source = shared_data / "mrclam" / "MRCLAM_Dataset6.zip"
    ekf, cauchy = np.mean([errors(source, robot) for robot in range(1, 6)], axis=0)
    assert ekf[0] < 0.105
    assert ekf[1] < 0.125
    assert cauchy[0] < 0.075
    assert cauchy[1] < 0.08


def test_misread_barcodes_do_no_harm_by_default(shared_data):
    # four readings of a barcode that was not there, 252 to 256 s into the recording
    log = load_mrclam(shared_data / "mrclam" / "MRCLAM_Dataset6.zip", 3, Treatment(225.0, 275.0))
    inputs, where = log.inputs(labels=True), "localization"
    ekf, default = (score(log, r) for r in compare(inputs, where, ["ekf", "batch"]))
    gated = score(log, compare(inputs, where, ["batch"], setup=Setup(gate_known=0.9999))[0])
    plain, *robust = (
        score(log, r) for r in compare(inputs, where, ["ekf", "batch-huber", "gnc"], setup=Setup(gate_known=None))
    )
    assert default < 1.05 * min(gated, *robust)
    assert ekf < 0.5 * plain


def score(log, run):
    """Position RMSE [m] of a run's last phase."""
    return float(metrics_row(run, run.phases[-1], log, None)["rmse_position_m"])


@pytest.mark.slow
def test_tutorials_join_the_table_of_the_log_they_treat(shared_data, tmp_path, monkeypatch):
    monkeypatch.chdir(shared_data / "mrclam")  # where the recording is found by its name
    folder = tmp_path / "window"
    source = shared_data / "mrclam" / "MRCLAM_Dataset1.zip"
    landmarks = shared_data / "mrclam" / "Landmark_Groundtruth.corrected.dat"
    assert (
        convert(["mrclam", str(source), str(folder), "--robot", "1", "--stop", "120", "--landmarks", str(landmarks)])
        == 0
    )
    out = tmp_path / "report"
    assert main([
        "--log", str(folder), *(f"--config=tutorial-step{i}" for i in range(1, 5)), "--estimator", "ekf",
        "--out", str(out), "--no-plots", "-q", "--jobs", "1",
    ]) == 0  # fmt: skip
    with (out / "metrics.csv").open(newline="") as f:
        rows = {(r["log"], r["task"]): r for r in csv.DictReader(f)}
    assert set(rows) == {
        ("window", "localization"), ("window", "slam"),
        ("window:tutorial-step1", "localization"), ("window:tutorial-step2", "localization"),
        ("window:tutorial-step3", "slam"), ("window:tutorial-step4", "slam"),
    }  # fmt: skip
    one, three = rows["window:tutorial-step1", "localization"], rows["window:tutorial-step3", "slam"]
    assert abs(int(one["frames"]) - 50 * (120 - 11.98)) < 5
    for row in (one, three):
        assert row["status"] == "ok"
        assert float(row["sse_position_m2"]) == pytest.approx(
            int(row["frames"]) * float(row["rmse_position_m"]) ** 2, rel=1e-6
        )
        assert float(row["rmse_position_m"]) > float(rows["window", row["task"]]["rmse_position_m"])
    assert float(three["sse_landmark_m2"]) > 0
    text = (out / "report.md").read_text()
    with (out / "association.csv").open(newline="") as f:
        counts = {r["log"]: r for r in csv.DictReader(f) if r["phase"] == "online" and "step" in r["log"]}
    assert [r["association"] for r in counts.values()] == ["known", "ml", "known", "ml-ratio"]
    assert counts["window:tutorial-step2"]["tn"] == counts["window:tutorial-step2"]["fn"] == "0"  # every reading paired
    assert (out / "tables" / "window-knowledge.csv").exists()
    assert "From labels and map to nothing" in text
    assert (out / "figures" / "window-knowledge.png").exists() is False  # --no-plots
    for named in (
        "running minimum", "all nine entries", "does not wrap", "first 599 frames", "from before the prediction",
        "whose first reading is of landmark 6", "reads the state one entry too early", "at its own instant",
    ):  # fmt: skip
        assert named in text
    assert "The original program" not in text  # it was not run on this window


@pytest.mark.slow
@pytest.mark.parametrize(("step", "lost"), [(1, False), (2, True), (3, False), (4, True)])
def test_on_their_own_recording_the_tutorials_give_the_numbers_of_their_programs(shared_data, step, lost):
    source, landmarks = (
        shared_data / "mrclam" / name for name in ("MRCLAM_Dataset1.zip", "Landmark_Groundtruth.corrected.dat")
    )
    variant = read_options(["--config", f"tutorial-step{step}"]).variants[0]
    log = variant_log(load_mrclam(source, 1, Treatment(landmarks=landmarks)), variant)
    row = metrics_row(tutorial_run(log, variant), "online", log, None)
    squares, rmse = original_of(Trial(log, variant.task, ()))
    # their last frame has no ground truth and adds up to 15 m^2
    assert float(row["sse_position_m2"]) == pytest.approx(squares, rel=0.002, abs=4.0)
    assert float(row["rmse_position_m"]) == pytest.approx(rmse, abs=0.0006)
    assert (rmse > 1.0) == lost


@pytest.mark.slow
def test_a_tutorial_needs_the_recording_it_was_made_from(shared_data, tmp_path, capsys):
    copy = tmp_path / "MRCLAM_Dataset9.zip"
    copy.write_bytes((shared_data / "mrclam" / "MRCLAM_Dataset9.zip").read_bytes())
    folder = tmp_path / "nine"
    assert convert(["mrclam", str(copy), str(folder), "--robot", "3", "--stop", "60"]) == 0
    copy.unlink()
    assert (
        main(["--log", str(folder), "--config", "tutorial-step1", "--out", str(tmp_path / "r"), "-q", "--jobs", "1"])
        == 2
    )
    assert "convert again" in capsys.readouterr().err


@pytest.mark.slow
def test_a_robot_without_truth_runs_with_blank_errors(shared_data, tmp_path):
    folder, out = tmp_path / "blind", tmp_path / "report"
    source = shared_data / "mrclam" / "MRCLAM_Dataset1.zip"
    assert convert(["mrclam", str(source), str(folder), "--robot", "5", "--stop", "100"]) == 0
    assert main(["--log", str(folder), "--estimator", "ekf,batch", "--out", str(out), "-q", "--jobs", "1"]) == 0
    with (out / "metrics.csv").open(newline="") as f:
        for row in csv.DictReader(f):
            assert (row["status"], row["rmse_position_m"], row["nees_pose"]) == ("ok", "", "")
            assert float(row["nis"]) > 0

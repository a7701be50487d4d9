"""The recorded UTIAS logs through the whole product: the accuracy that the README states, and the tutorials' rows."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from association.expectation import gate_threshold
from data.convert.__main__ import main as convert
from data.formats.mrclam.load import Treatment, load_mrclam
from eval.referee.score import metrics_row
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
def test_a_robot_without_truth_runs_with_blank_errors(shared_data, tmp_path):
    folder, out = tmp_path / "blind", tmp_path / "report"
    source = shared_data / "mrclam" / "MRCLAM_Dataset1.zip"
    assert convert(["mrclam", str(source), str(folder), "--robot", "5", "--stop", "100"]) == 0
    assert main(["--log", str(folder), "--estimator", "ekf,batch", "--out", str(out), "-q", "--jobs", "1"]) == 0
    with (out / "metrics.csv").open(newline="") as f:
        for row in csv.DictReader(f):
            assert (row["status"], row["rmse_position_m"], row["nees_pose"]) == ("ok", "", "")
            assert float(row["nis"]) > 0

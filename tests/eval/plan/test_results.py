"""`run_all --result`: a run of ours handed back has its numbers; a folder that is handed on tells no places."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from data.convert.__main__ import main as convert
from data.errors import DataError
from data.formats.open_log import write_folder
from data.worlds.registry import named_log
from eval.plan.flags.table import Results
from eval.plan.results import asked_results, truth_of
from eval.run_all import main

HOW = ("nis", "nis_lower", "nis_upper", "nis_expected", "innovation_lag1", "innovation_lag1_se", "iterations")
"""What a run says of the way it was made, and a path does not."""
LOG, NAME = "arena:0:frames=60", "arena_0_frames=60"


def run(out, *command):
    assert main([*command, "--out", str(out), "--no-plots", "-q", "--jobs", "1", "--formats", "csv"]) == 0
    return pd.read_csv(out / "metrics.csv"), pd.read_csv(out / "association.csv")


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A report on a log, whose runs are the results of others in the tests."""
    out = tmp_path_factory.mktemp("results") / "first"
    run(out, "--log", LOG, "--task", "slam", "--association", "jcbb-hindsight", "--estimator", "ekf,isam2")
    return out


@pytest.fixture(scope="module")
def again(first):
    """The same, with its own runs handed back, and the filter's path at half the frames and 20 ms late."""
    runs = first / "runs" / NAME
    rows = np.loadtxt(runs / "slam-ekf-jcbb-hindsight/online.tum")[::2]
    rows[:, 0] += 0.02
    late = first.parent / "late.tum"
    np.savetxt(late, rows, fmt="%.17g")
    out = first.parent / "again"
    tables = run(
        out, "--log", LOG, "--task", "slam", "--association", "jcbb-hindsight", "--estimator", "ekf,isam2",
        "--result", f"e={runs}/slam-ekf-jcbb-hindsight", "--result", f"i={runs}/slam-isam2-jcbb-hindsight",
        "--result", f"late={late}", "--result", f"tum={runs}/slam-isam2-jcbb-hindsight/final.tum",
    )  # fmt: skip
    return out, *tables


def test_our_own_folder_handed_back_has_the_same_numbers(again):
    _, metrics, association = again
    names = ["estimator", "association"]
    metrics = metrics.drop(columns=[*HOW, "last_step_sigma", "matched", "unmatched"])
    for table in (metrics, association):
        for ours, theirs in (("ekf", "e"), ("isam2", "i")):
            a, b = (table[table["estimator"] == n].drop(columns=names).astype(str) for n in (ours, theirs))
            assert len(a)
            assert a.to_numpy().tolist() == b.to_numpy().tolist()


def test_other_stamps_are_matched_by_interpolation_and_counted(again):
    _, metrics, _ = again
    row = metrics[metrics["estimator"] == "late"].iloc[0]
    assert (row["association"], row["phase"]) == ("none", "final")
    assert row["matched"] + row["unmatched"] == row["frames"] == 30
    assert row["matched"] > 0
    assert np.isnan(row["nees_pose"])  # without a covariance
    ours = metrics[metrics["estimator"] == "ekf"].iloc[0]
    assert row["rmse_position_m"] == pytest.approx(ours["rmse_position_m"], rel=0.5)


def test_every_log_has_its_truth_as_tum_and_a_truth_may_be_alone(first, tmp_path):
    runs = first / "runs" / NAME
    truth = runs / "truth.tum"
    a, b = f"a={runs}/slam-ekf-jcbb-hindsight/online.csv", f"b={runs}/slam-isam2-jcbb-hindsight/final.csv"
    command = ("--truth", str(truth), "--align", "se2", "--result", a, "--result", b)
    metrics, _ = run(tmp_path / "alone", *command)
    assert metrics["log"].tolist() == [NAME] * 2
    assert metrics["estimator"].tolist() == ["a", "b"]
    own = pd.read_csv(first / "metrics.csv").set_index(["estimator", "phase"])
    assert metrics["rmse_position_m"].tolist() == pytest.approx(
        [own.loc["ekf", "online"]["rmse_aligned_m"], own.loc["isam2", "final"]["rmse_aligned_m"]], rel=1e-9
    )
    assert "Exception: a, b" in (tmp_path / "alone/report.md").read_text()


def test_a_truth_without_stamps_has_a_pose_for_each_frame(tmp_path):
    np.savetxt(tmp_path / "t.txt", named_log(LOG).truth.pose[:-3])
    asked = asked_results(Results(truth=str(tmp_path / "t.txt")), [LOG], ())
    with pytest.raises(DataError, match="57 poses without stamps, 60 frames: which belong together"):
        truth_of(named_log(LOG), asked.file)


@pytest.mark.parametrize(("command", "wanted"), [
    (["--log", LOG, "--log", "arena:1", "--result", "a=b.tum"], "--result a=b.tum: belongs to one log"),
    (["--result", "a=b.tum"], "on which log? name one, or type --truth FILE"),
    (["--truth", "b.tum"], "nothing to score"), (["--log", LOG, "--result", "b.tum"], "NAME=FILE is needed"),
    (["--log", LOG, "--result", "ekf=b.tum"], "ekf is one of our estimators"),
    (["--log", LOG, "--result", "a=b.tum", "--result", "a=c.tum"], "two results are named a"),
    (["--log", LOG, "--result", "a/b=b.tum"], "'a/b' is no name"),
    (["--log", LOG, "--align", "se2"], "--align: for results only; type --result NAME=FILE"),
    (["--log", LOG, "--result", "a=x", "--result", "b=y", "--cov", "c"], "of which result? NAME=c"),
    (["--log", LOG, "--result", "a=x", "--cov-frame", "body"], "--cov-frame body: unknown; known: world, local, left"),
    (["--scenario", "arena", "--truth", "b.tum"], "--truth and --scenario exclude each other"),
    (["--log", LOG, "--result", "a=/nowhere.tum"], "/nowhere.tum: no such file"),
])  # fmt: skip
def test_what_makes_no_sense_is_one_line_and_status_2(command, wanted, tmp_path, refused):
    assert wanted in refused(main, [*command, "--out", str(tmp_path / "out")])


def test_latitudes_of_a_result_are_about_the_datum_of_the_log_and_else_refused(tmp_path):
    log = named_log("arena:0")
    t, (x, y, _) = log.recorded.time[::5], log.truth.pose[::5].T
    table = np.column_stack([t, 49.0 + y / 111.2e3, 8.0 + x / 73.1e3])
    np.savetxt(tmp_path / "gps.csv", table, fmt="%.12f", delimiter=",", header="t,lat,lon", comments="")
    asked = asked_results(replace(Results(), result=(f"gps={tmp_path}/gps.csv",)), ["arena:0"], [])
    _, there = asked.settled(replace(log, source={"datum": [49.0, 8.0]}))
    assert there.results[0].paths["final"].pose[:, :2] == pytest.approx(np.stack([x, y], 1), abs=0.05)
    with pytest.raises(DataError, match="no datum; --align se2"):
        asked.settled(log)


def test_decisions_about_another_log_and_stamps_beside_a_log_without_some_are_refused(first, tmp_path, refused):
    (tmp_path / "a.csv").write_text("t,x,y,theta\n0.5,0,0,0\n")
    runs = first / "runs" / NAME / "slam-ekf-jcbb-hindsight"
    for log, result, said in (
        ("arena:2", runs, "decisions.csv: "),
        ("corridor:0", tmp_path / "a.csv", "t is the index"),
    ):
        command = ["--log", log, "--task", "slam", "--estimator", "ekf", "--result", f"a={result}"]
        assert said in refused(main, [*command, "--out", str(tmp_path / "out")])


def test_a_log_without_truth_says_so_and_has_the_distance_from_batch(tmp_path):
    write_folder(named_log(LOG), tmp_path / "untold")
    (tmp_path / "untold/truth.csv").unlink()
    command = [
        "--log", str(tmp_path / "untold"), "--task", "slam", "--association", "known", "--estimator", "ekf,batch",
    ]  # fmt: skip
    run(tmp_path / "first", *command)
    path = tmp_path / "first/runs/untold/slam-ekf-known/online.tum"
    (tmp_path / "own.tum").write_bytes(path.read_bytes())
    metrics, _ = run(tmp_path / "second", *command, "--result", f"own={tmp_path / 'own.tum'}")
    ours, theirs = (metrics[metrics["estimator"] == n].iloc[0] for n in ("ekf", "own"))
    assert theirs["rms_from_batch_m"] == ours["rms_from_batch_m"]
    assert np.isnan(theirs["rmse_position_m"])
    assert np.isnan(theirs["matched"])
    assert "only the distance from batch is measured" in (tmp_path / "second/report.md").read_text()
    assert not (tmp_path / "second/runs/untold/truth.tum").exists()


OWN = """
from ekf.slam import EkfSlam

class Mine(EkfSlam):
    def update(self, observations, decisions, **more):
        raise LookupError("injected")
"""


def test_logs_reports_and_tracebacks_are_without_folders(tmp_path, monkeypatch):
    (tmp_path / "start").mkdir()
    monkeypatch.chdir(tmp_path / "start")
    made = []
    for place in ("one", "another/place"):
        folder = tmp_path / place
        folder.mkdir(parents=True)
        (folder / "own.py").write_text(OWN)
        assert convert(["arena", str(folder / "log"), "--seed", "0", "--frames", "8"]) == 0
        asked = ["--out", str(folder / "r"), "--no-plots", "-q", "--jobs", "1", "--task", "slam"]
        assert main([str(folder / "log"), *asked, "--estimator", f"ekf,m={folder / 'own.py'}:Mine"]) == 0
        files = sorted(p for p in (folder / "r").rglob("*") if p.is_file() and p.name != "timing.csv")
        made.append({p.relative_to(folder / "r"): p.read_bytes() for p in files})
        assert not [name for name, content in made[-1].items() if str(folder).encode() in content]
        log = (folder / "r/run.log").read_text()
        assert 'File "own.py", line 6' in log
        assert "report: r/report.html" in log
    assert made[0] == made[1]

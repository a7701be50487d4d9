"""A log with a window of bad truth has the same numbers in every command and from Python."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import slamref
from data.formats.open_log import write_folder
from data.log import Log
from data.logs import open_log
from eval.plan.results import PLAIN, true_path
from eval.report.publish import write_tum
from tests.builders.unpacked import unpacked
from tests.eval.player.test_document import chunk_of

FIRST, LAST = 70, 110
NOTICE = "left out of scoring, unless --keep-truth"
ESTIMATE = "out/runs/log/localization-ekf-known/online.csv"
NUMBERS = ("rmse_position_m", "nees_pose")


def bad(log: Log) -> Log:
    pose = log.truth.pose.copy()
    pose[FIRST : LAST + 1, :2] += [2.0, -2.0]
    return replace(log, truth=replace(log.truth, pose=pose))


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The folder of a log and of its report, what `slamref run` said, and its row of metrics.csv."""
    folder = tmp_path_factory.mktemp("windows")
    write_folder(bad(open_log("arena:3")), folder / "log")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert slamref.main(["run", "log", "--estimator", "ekf", "--no-plots", "--out", "out"]) == 0
        row = pd.read_csv("out/metrics.csv").iloc[0]
    return SimpleNamespace(folder=folder, said=(folder / "out" / "run.log").read_text(), row=row)


@pytest.fixture(autouse=True)
def there(ran, monkeypatch):
    monkeypatch.chdir(ran.folder)


def numbers(out: str) -> dict[str, float]:
    """The first number of each line of `score`, or the last table of `step`, by its name."""
    found = (line.rsplit(maxsplit=1) for line in out.splitlines() if len(line.split()) > 1)
    return {name.strip(): float(v) for name, v in found if v.replace(".", "", 1).replace("e-", "", 1).isdigit()}


def test_scoring_its_file_gives_the_numbers_of_the_run_and_on_request_the_window_counts(ran, capsys):
    assert NOTICE in ran.said
    assert ran.row.nees_pose < 9.0
    assert np.array_equal(true_path("log", [], PLAIN).pose, open_log("log").truth.pose, equal_nan=True)
    assert slamref.main(["score", ESTIMATE, "log"]) == 0
    out, err = capsys.readouterr()
    assert {n: numbers(out)[n] for n in NUMBERS} == pytest.approx({n: ran.row[n] for n in NUMBERS}, rel=1e-5)
    assert NOTICE in err
    python = slamref.score_files(ESTIMATE, "log")
    assert {n: python[n] for n in NUMBERS} == pytest.approx({n: ran.row[n] for n in NUMBERS})
    assert slamref.main(["score", ESTIMATE, "log", "--keep-truth"]) == 0
    assert numbers(capsys.readouterr().out)["rmse_position_m"] > 1.0
    assert slamref.score_files(ESTIMATE, "log", keep_truth=True)["nees_pose"] > 100.0


def test_step_ends_with_the_numbers_of_the_run(ran, capsys):
    assert slamref.main(["step", "log", "--association", "known", "--run-through"]) == 0
    out = capsys.readouterr().out
    assert NOTICE in out
    assert numbers(out)["position RMSE [m]"] == pytest.approx(ran.row.rmse_position_m, rel=2e-2)
    assert slamref.main(["step", "log", "--association", "known", "--run-through", "--keep-truth"]) == 0
    assert numbers(capsys.readouterr().out)["position RMSE [m]"] > 1.0


def test_tune_scores_as_the_run_and_writes_the_truth_of_the_file(ran, capsys):
    assert slamref.main(["tune", "log", "tuned", "--fit", "sensor"]) == 0
    out = capsys.readouterr().out
    assert NOTICE in out
    (stated,) = [line for line in out.splitlines() if line.startswith("RMSE as stated")]
    assert float(stated.split("position ")[1].split()[0]) == pytest.approx(ran.row.rmse_position_m, rel=1e-3)
    assert float(stated.split("NEES ")[1].split()[0]) == pytest.approx(ran.row.nees_pose, rel=1e-2)
    assert Path("tuned/truth.csv").read_bytes() == Path("log/truth.csv").read_bytes()
    assert slamref.main(["tune", "log", "tuned", "--fit", "sensor", "--keep-truth"]) == 0
    (stated,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("RMSE as stated")]
    assert float(stated.split("position ")[1].split()[0]) > 1.0


def test_play_shows_no_truth_and_no_nees_there(ran, capsys):
    assert slamref.main(["play", "log", "--estimator", "ekf", "--association", "known", "--out", "page.html"]) == 0
    assert NOTICE in capsys.readouterr().out
    page = chunk_of(Path("page.html").read_text(encoding="utf-8"))
    nees = unpacked(page)[f"{page['runs'][0]['key']}online_nees"][:, 0]
    assert np.isnan(nees[FIRST : LAST + 1]).all()
    assert np.nanmean(nees) == pytest.approx(ran.row.nees_pose, rel=2e-2)


def test_a_lab_leaves_them_out_as_well(tmp_path, monkeypatch):
    from eval.plan.experiments import make_plan
    from eval.plan.flags.options import read_options
    from wings.labs.plan import corridor_names

    monkeypatch.chdir(tmp_path)
    for i, name in enumerate(corridor_names("corridor:3")):
        log = open_log(name)
        pose = log.truth.pose.copy()
        pose[20:26, :2] += [3.0, 3.0] if i == 0 else 0.0
        write_folder(replace(log, truth=replace(log.truth, pose=pose)), tmp_path / "lab" / f"c{i}")
    logs = {e.log.name: e.log for e in make_plan(read_options(["lab"], "slamref lab", "lab"), print).experiments}
    assert [bool(logs[f"c{i}"].truth.left_out) for i in range(4)] == [True, False, False, False]


def test_the_truth_of_a_file_counts_without_results_of_others_too(ran):
    log = open_log("log")
    write_tum(ran.folder / "shifted.tum", log.recorded.time, log.truth.pose + [5.0, 0.0, 0.0])
    words = ["run", "log", "--truth", "shifted.tum", "--estimator", "ekf", "--no-plots", "--out", "shifted"]
    assert slamref.main(words) == 0
    assert pd.read_csv("shifted/metrics.csv").rmse_position_m[0] > 4.0

"""The visual lab through the commands: rendered, written in the lab's format, read again, localized, reported."""

import pandas as pd
import pytest

from data.convert.__main__ import main as convert
from eval.run_all import main
from wings.camera import observations as visual_log

FRAMES = 4
SMALL = ["--image-width", "400", "--image-height", "300", "--reference-width", "300"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab") / "my_lab"
    assert convert(["visual", str(folder), "--seed", "1", "--frames", str(FRAMES), "--form", "npy", *SMALL]) == 0
    return folder


@pytest.fixture(scope="module")
def report(lab):
    out = lab.parent / "report"
    asked = ["--estimator", "dead-reckoning,ekf,batch", "--task", "localization,slam"]
    asked += ["--quick", "--formats", "csv,tex"]
    assert main(["--log", str(lab), *asked, "--out", str(out), "-q", "--jobs", "1"]) == 0
    return out


@pytest.mark.slow
def test_a_lab_folder_is_localized_and_mapped(report):
    table = pd.read_csv(report / "metrics.csv")
    assert set(table["task"]) == {"localization", "slam"}
    assert set(table["status"]) == {"ok"}
    assert table["rmse_position_m"].isna().all()  # the lab's format holds no truth
    assert (table[(table["task"] == "slam") & (table["estimator"] == "ekf")]["landmarks"] % 4 == 0).all()


@pytest.mark.slow
def test_the_report_holds_models_plan_contact_sheet_and_statistics(report):
    figures = {f.name for f in (report / "figures").iterdir()}
    assert "my_lab-detections.png" in figures
    assert "my_lab-localization-plan.png" in figures
    assert "\\begin{bmatrix}" in (report / "tables" / "my_lab-models.tex").read_text()
    assert pd.read_csv(report / "tables" / "my_lab-detections.csv")["detections"].sum() > 0
    assert "http" not in (report / "report.html").read_text().split("<body", 1)[1].replace("http-equiv", "")


@pytest.mark.slow
def test_a_second_run_looks_at_no_image(lab, report, monkeypatch):
    def never(*arguments, **more):
        raise AssertionError("the images were looked at again")

    monkeypatch.setattr(visual_log, "Detector", never)
    monkeypatch.setattr("wings.camera.opening.find_pictures", never)
    out = lab.parent / "again"
    assert main(["--log", str(lab), "--estimator", "ekf", "--out", str(out), "-q", "--no-plots", "--jobs", "1"]) == 0
    a, b = (pd.read_csv(p / "metrics.csv") for p in (report, out))
    first = a[(a["estimator"] == "ekf") & (a["task"] == "localization") & (a["log"] == "my_lab")]
    assert first["nis"].tolist() == b[(b["estimator"] == "ekf") & (b["log"] == "my_lab")]["nis"].tolist()


def test_an_open_log_is_made_of_it(lab, tmp_path, capsys):
    assert convert(["lab", str(lab), str(tmp_path / "log")]) == 0
    assert f"frames: {FRAMES} (" in capsys.readouterr().out
    assert main([
        "--log", str(tmp_path / "log"), "--estimator", "ekf", "--out", str(tmp_path / "r"), "-q", "--no-plots",
        "--jobs", "1",
    ]) == 0  # fmt: skip


def test_a_wrong_unit_is_warned_of(lab, tmp_path, capsys):
    asked = ["--camera-translation", "m", "--estimator", "ekf", "--no-plots", "--jobs", "1"]
    assert main(["--log", str(lab), *asked, "--out", str(tmp_path / "r")]) == 0
    told = capsys.readouterr().out
    assert "my_lab: " in told
    assert "0 of the first 24 observations fit a landmark of the map" in told


@pytest.mark.parametrize(("arguments", "words"), [
    (["--log", "visual:x"], "whole number"),
    (["--log", "visual:0", "--camera-translation", "inch"], "known: cm, mm, m"),
    (["--log", "visual:0", "--corner-noise", "none"], "known: lab, depth"),
])  # fmt: skip
def test_nonsense_is_one_line_and_exit_2(arguments, words, tmp_path, refused):
    assert words in refused(main, [*arguments, "--out", str(tmp_path / "r"), "-q"])

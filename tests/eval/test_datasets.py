"""Public data sets: what is known of each, and one table of those that a folder has."""

import pandas as pd

from eval import datasets as listed
from eval.datasets import commands, datasets
from slamref import main


def _helps(words):
    try:
        return main(words) == 0
    except SystemExit as end:
        return end.code == 0


def test_every_data_set_has_a_page_a_licence_and_commands_that_exist(capsys):
    assert main(["datasets"]) == 0
    said = capsys.readouterr().out
    for entry in datasets():
        assert entry["page"].startswith("http")
        assert entry["licence"]
        assert entry["name"] in said
        for convert, run in commands(entry, "FILE", "OUT"):
            assert {word for word in run if word.startswith("--")} <= {"--task", "--estimator", "--association"}
            assert not convert or _helps(["convert", convert[0], "--help"])


def test_a_folder_is_run_to_one_table_and_what_it_lacks_is_named(tmp_path, monkeypatch, capsys):
    tiny = {"name": "tiny", "log": "arena:0:frames=12", "run": "--task localization --estimator ekf"}
    absent = {"name": "far", "file": "far.zip", "page": "http://far", "convert": "dlr {file} {log}"}
    broken = {"name": "broken", "file": "*.circles", "convert": "dlr {file} {log}", "sha256": "0"}
    (tmp_path / "map.circles").write_text("nonsense\n")
    monkeypatch.setattr(listed, "datasets", lambda: [tiny, absent, broken])
    assert main(["study", "datasets", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "far.zip is not in" in said.err
    assert "map.circles is another copy than ours" in said.err
    assert "not run: broken" in said.out
    table = pd.read_csv(tmp_path / "out" / "datasets.csv")
    assert set(table["dataset"]) == {"tiny"}
    assert table["rmse_position_m"].notna().all()


def test_a_folder_without_any_is_refused(tmp_path, refused):
    assert "no such folder" in refused(main, ["study", "datasets", str(tmp_path / "none")])

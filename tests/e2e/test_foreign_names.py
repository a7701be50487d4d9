"""Foreign names through the whole command: tables, run.log, provenance, studies, processes, a cluster."""

import json
import sys
from pathlib import Path

import pandas as pd
import pytest

from eval.run_all import main

THINGS = """
from association.methods import singles
from ekf.slam import EkfSlam

class Mine(EkfSlam):
    pass

class Crashing(EkfSlam):
    def update(self, observations, decisions, **more):
        if self.created > 3:
            raise RuntimeError("no room")
        return super().update(observations, decisions, **more)

def refusing(expectation, gate):
    raise LookupError("nothing here")
"""
STUDY = """
about = "a small one"
runs = 2
task = ["slam"]
association = ["known", "s=./things.py:singles"]
[estimators."m=./things.py:Mine"]
must_be = "consistent"
[estimators.ekf]
[world]
kind = "arena"
frames = 12
"""
ARENA = ("--log", "arena:0", "--task", "slam", "--quick", "--no-plots", "-q")


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    Path("things.py").write_text(THINGS, encoding="utf-8")
    Path("study.toml").write_text(STUDY, encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_names_stand_in_tables_files_and_provenance_and_crashes_in_the_log():
    asked = ["--estimator", "ekf,batch,m=./things.py:Mine,./things.py:Crashing"]
    asked += ["--association", "known,s=./things.py:singles"]
    assert main([*ARENA, *asked, "--jobs", "1", "--out", "r"]) == 0
    metrics = pd.read_csv("r/metrics.csv").set_index(["estimator", "association"])
    same = metrics.drop(columns=["log", "task", "phase"])
    for association in ("known", "s"):
        pd.testing.assert_series_equal(same.loc["m", association], same.loc["ekf", association], check_names=False)
        assert metrics.loc[("Crashing", association), "status"] == "diverged"
        assert Path("r/runs/arena_0", f"slam-m-{association}", "online.csv").is_file()
    said = Path("r/run.log").read_text(encoding="utf-8")
    assert "Crashing diverged at frame" in said
    assert 'raise RuntimeError("no room")' in said
    report = Path("r/report.md").read_text(encoding="utf-8")
    assert "Crashing.update raised RuntimeError: no room (things.py, line 11)" in report
    foreign = json.loads(Path("r/provenance.json").read_text(encoding="utf-8"))["foreign"]
    assert {name: entry["is"].rpartition("/")[2] for name, entry in foreign.items()} == {
        "m": "things.py:Mine", "Crashing": "things.py:Crashing", "s": "things.py:singles",
    }  # fmt: skip
    assert all(len(entry["sha256"]) == 64 for entry in foreign.values())
    assert main([*ARENA, *asked, "--jobs", "2", "--out", "r2"]) == 0
    for name in ("metrics.csv", "association.csv", "trust.csv"):
        assert Path("r", name).read_bytes() == Path("r2", name).read_bytes()


@pytest.mark.parametrize(("asked", "words"), [
    (["--estimator", "./things.py:Nobody"], "no 'Nobody' in things.py"),
    (["--association", "./things.py:nobody"], "no 'nobody' in things.py"),
    (["--estimator", "./things.py:Mine", "--task", "localization"], "Mine does slam only"),
    (["--estimator", "./nowhere.py:Mine"], "there is no file ./nowhere.py"),
])  # fmt: skip
def test_what_cannot_be_is_one_line_before_any_work(asked, words, refused):
    assert words in refused(main, ["--log", "arena:0", *asked, "--out", "r", "-q"])
    assert not Path("r").exists()

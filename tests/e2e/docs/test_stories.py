"""docs/stories.md, run as it is written: what four users type, each at most five commands."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pandas as pd
import pytest

import slamref
from tests.e2e.docs.test_extending import EXAMPLES
from tests.e2e.docs.test_own_log import write_files

PAGE = Path(__file__).parents[3] / "docs" / "stories.md"
STORIES = dict(re.findall(r"```sh (\w+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL))


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "ukf.py").write_text(EXAMPLES["ukf.py"], encoding="utf-8")
    write_files(tmp_path)
    return tmp_path


def tell(story):
    commands = [shlex.split(line) for line in STORIES[story].strip().splitlines()]
    for program, *words in commands:
        assert program == "slamref"
        assert slamref.main(words) == 0, words


@pytest.mark.slow
def test_the_student_has_answers_steps_and_a_player(here):
    tell("student")
    text = (here / "lab" / "report.md").read_text(encoding="utf-8")
    assert [f"## Question {n}:" in text for n in range(1, 7)] == [True] * 6
    assert "Not answered" not in text
    assert (here / "lab" / "write-up.tex").exists()
    assert len(list((here / "steps").glob("*.png"))) >= 12
    assert (here / "people.html").stat().st_size < 1e6


@pytest.mark.slow
def test_the_researchers_filter_is_scored_beside_ours(here, capsys):
    tell("researcher")
    said = capsys.readouterr().out
    metrics = pd.read_csv(here / "mine" / "metrics.csv").set_index(["estimator", "association"])
    assert (metrics["status"] == "ok").all()
    off = metrics.loc[("Ukf", "known"), "rmse_position_m"]
    assert off == pytest.approx(metrics.loc[("ekf", "known"), "rmse_position_m"], rel=0.05)
    assert f"rmse_position_m {off:.6g}" in said
    study = pd.read_csv(here / "study" / "consistency.csv").query("estimator == 'Ukf' and quantity == 'pose'")
    assert len(study) > 0
    assert (study["verdict"] == "consistent").all()


@pytest.mark.slow
def test_the_engineer_learns_what_to_trust(here):
    tell("engineer")
    metrics = pd.read_csv(here / "report" / "metrics.csv").query("estimator != 'dead-reckoning'")
    assert set(metrics["association"]) == {"jcbb-hindsight"}
    assert metrics["nis"].between(0.8, 1.2).all()
    trust = pd.read_csv(here / "trust" / "trust.csv")
    assert trust["p"].notna().any()


@pytest.mark.slow
def test_the_writer_has_tables_that_fit(here):
    tell("writer")
    for folder in ("study", "paper"):
        tables = list((here / folder / "tables").glob("*.tex"))
        assert (here / folder / "tables" / "notes.tex") in tables
        assert not any("resizebox" in t.read_text(encoding="utf-8") for t in tables)
    assert (here / "paper" / "write-up.tex").exists()

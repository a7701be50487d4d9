"""The benchmark of the variety: its rows, that it goes on where it ended, its goals and its figure."""

from __future__ import annotations

import pytest

from tests.research.__main__ import main
from tests.research.rows import read
from tests.research.variety.goals import goals, worlds_of
from tests.research.variety.measure import METHODS, Row


def row(number, method, rmse=1.0, fp=10, landmarks=100, status="ok", world="arena"):
    return Row(number, method, world, 50, 1000, 100, 95, rmse, fp, 3, landmarks, 0.5, status)


def pairs(n, **hindsight):
    return [r for i in range(n) for r in (row(i, "jcbb"), row(i, "jcbb-hindsight", **hindsight))]


def test_all_goals_are_met_where_hindsight_is_better():
    found = goals(worlds_of(pairs(20, rmse=0.5, fp=1, landmarks=95)))
    assert [(g.value, g.met) for g in found] == [(1.0, True), (0.1, True), (1.0, True)]


def test_no_goal_is_met_where_it_is_worse():
    found = goals(worlds_of(pairs(20, rmse=1.3, fp=9, landmarks=120)))
    assert [(g.value, g.met) for g in found] == [(0.0, False), (0.9, False), (0.0, False)]


@pytest.mark.slow
def test_the_command_writes_rows_goals_and_figure_and_goes_on(tmp_path, capsys):
    arguments = ["variety", str(tmp_path), "--half", "choose", "--worlds"]
    assert main([*arguments, "1"]) == 0
    first = read(Row, tmp_path / "variety.csv")
    assert main([*arguments, "2"]) == 0
    rows = read(Row, tmp_path / "variety.csv")
    assert rows[:3] == first
    assert [(r.number, r.method) for r in rows] == [(i, m) for i in (0, 2) for m in METHODS]
    assert all(r.fp == 0 and r.landmarks == r.visible for r in rows if r.method == "known")
    assert (tmp_path / "variety.png").exists()
    assert "landmarks within" in capsys.readouterr().out

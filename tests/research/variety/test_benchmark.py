"""The benchmark of the variety: its rows, that it goes on where it ended, its goals and its figure."""

from __future__ import annotations

import math
from functools import partial

import pytest

from eval.figures.style import save
from tests.research.__main__ import main
from tests.research.variety import measure as measuring
from tests.research.variety.figure import variety_figure
from tests.research.variety.goals import fp_ratios, goals, table, worlds_of
from tests.research.variety.measure import METHODS, SLOW, Row, append, line_of, measure, measure_all, read
from tests.research.variety.worlds import draw, log_of


def row(number, method, rmse=1.0, fp=10, landmarks=100, status="ok", world="arena"):
    return Row(number, method, world, 50, 1000, 100, 95, rmse, fp, 3, landmarks, 0.5, status)


def pairs(n, **hindsight):
    return [r for i in range(n) for r in (row(i, "jcbb"), row(i, "jcbb-hindsight", **hindsight))]


def test_a_file_of_rows_is_read_as_written(tmp_path):
    rows = [row(1, "jcbb", math.inf), row(1, "jcbb-hindsight", 0.25, status=SLOW)]
    for r in rows:
        append(r, tmp_path / "v.csv")
    assert read(tmp_path / "v.csv") == rows
    assert read(tmp_path / "none.csv") == []


def test_all_goals_are_met_where_hindsight_is_better():
    found = goals(worlds_of(pairs(20, rmse=0.5, fp=1, landmarks=95)))
    assert [(g.value, g.met) for g in found] == [(1.0, True), (0.1, True), (1.0, True)]


def test_no_goal_is_met_where_it_is_worse():
    found = goals(worlds_of(pairs(20, rmse=1.3, fp=9, landmarks=120)))
    assert [(g.value, g.met) for g in found] == [(0.0, False), (0.9, False), (0.0, False)]


def test_one_world_in_twenty_may_be_worse():
    one = [row(99, "jcbb"), row(99, "jcbb-hindsight", 9.0)]
    assert goals(worlds_of(pairs(19) + one))[0].met
    assert not goals(worlds_of(pairs(18) + one))[0].met


def test_a_run_without_an_end_counts_as_worse_and_its_landmarks_as_wrong():
    (world,) = worlds_of([row(1, "jcbb"), row(1, "jcbb-hindsight", math.nan, 0, 100, SLOW)])
    assert world.rmse_ratio == math.inf
    assert [g.met for g in goals([world])] == [False, True, False]
    assert len(fp_ratios([world])) == 0
    (other,) = worlds_of([row(1, "jcbb", math.nan, 0, 0, SLOW), row(1, "jcbb-hindsight")])
    assert other.rmse_ratio == 0.0


def test_a_world_with_one_method_does_not_count():
    assert worlds_of([row(1, "jcbb"), row(2, "jcbb-hindsight")]) == []
    assert goals([]) == []
    assert table([]) == ["No world was run with both methods."]


def test_the_table_has_a_line_for_each_kind_of_world():
    rows = pairs(3) + [row(9, m, world="park") for m in METHODS]
    lines = table(rows)
    assert [line.split("|")[1].strip() for line in lines[2:5]] == ["arena", "park", "all"]
    assert lines[4].split("|")[2].strip() == "4"
    assert sum(line.startswith(("met", "MISSED")) for line in lines) == 3


def test_the_figure_is_drawn_with_runs_that_did_not_end(tmp_path):
    rows = [*pairs(3), row(7, "jcbb", world="corridor"), row(7, "jcbb-hindsight", math.nan, 0, 0, SLOW, "corridor")]
    assert [p.name for p in save(variety_figure(worlds_of(rows)), tmp_path, "variety", ("png",))] == ["variety.png"]


def test_a_run_that_takes_too_long_is_ended_and_said_to_be_slow():
    drawn = draw(23)
    found = measure(log_of(drawn), 23, "corridor", "jcbb", limit=0.0)
    assert found.status == SLOW
    assert math.isnan(found.rmse_m)
    assert SLOW in line_of(found)


def test_what_is_done_is_not_run_again(monkeypatch):
    ran = []
    monkeypatch.setattr(measuring, "log_of", lambda drawn: drawn)
    monkeypatch.setattr(measuring, "named_log", lambda name: name)
    monkeypatch.setattr(measuring, "measure", lambda log, i, world, method, limit=0.0: ran.append((i, method)))
    list(measure_all([1, 3], [row(1, m) for m in METHODS] + [row(3, "jcbb")]))
    assert [r for r in ran if r[0] >= 0] == [(3, "jcbb-hindsight"), (3, "known")]


@pytest.mark.slow
def test_the_command_writes_rows_goals_and_figure_and_goes_on(tmp_path, capsys):
    arguments = ["variety", str(tmp_path), "--half", "choose", "--worlds"]
    assert main([*arguments, "1"]) == 0
    first = read(tmp_path / "variety.csv")
    assert main([*arguments, "2"]) == 0
    rows = read(tmp_path / "variety.csv")
    assert rows[:3] == first
    assert [(r.number, r.method) for r in rows] == [(i, m) for i in (0, 2) for m in METHODS]
    assert all(r.fp == 0 and r.landmarks == r.visible for r in rows if r.method == "known")
    assert (tmp_path / "variety.png").exists()
    assert "landmarks within" in capsys.readouterr().out


def test_the_worlds_can_be_run_as_they_are_stated(monkeypatch):
    ran = {}
    monkeypatch.setattr(measuring, "log_of", lambda drawn: drawn)
    monkeypatch.setattr(measuring, "named_log", lambda name: name)
    monkeypatch.setattr(measuring, "measure", lambda log, i, world, method, limit=0.0: ran.setdefault(i, log))
    list(measure_all([201, 203], [], world=partial(measuring.world_of, exact=True)))
    assert [ran[i] for i in (201, 203)] == [draw(i, exact=True) for i in (201, 203)]


@pytest.mark.slow
def test_exact_worlds_have_files_of_their_own(monkeypatch, tmp_path):
    monkeypatch.setattr(measuring, "log_of", lambda drawn: drawn)
    monkeypatch.setattr(measuring, "named_log", lambda name: name)
    monkeypatch.setattr(measuring, "measure", lambda log, i, world, method, limit=0.0: row(i, method))
    for more in ([], ["--exact"]):
        assert main(["variety", str(tmp_path), "--half", "later", "--worlds", "1", *more]) == 0
    for name in ("variety", "variety-exact"):
        assert [r.number for r in read(tmp_path / f"{name}.csv")] == [200, 200, 200]
        assert (tmp_path / f"{name}.png").exists()

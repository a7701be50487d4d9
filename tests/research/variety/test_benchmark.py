"""The benchmark of the variety: its rows, that it goes on where it ended, and its goals."""

import pytest

from tests.research.__main__ import main
from tests.research.rows import read
from tests.research.variety.measure import METHODS, Row


@pytest.mark.slow
def test_the_command_writes_rows_and_goals_and_goes_on(tmp_path, capsys):
    arguments = ["variety", str(tmp_path), "--half", "choose", "--worlds"]
    assert main([*arguments, "1"]) == 0
    first = read(Row, tmp_path / "variety.csv")
    assert main([*arguments, "2"]) == 0
    rows = read(Row, tmp_path / "variety.csv")
    assert rows[:3] == first
    assert [(r.number, r.method) for r in rows] == [(i, m) for i in (0, 2) for m in METHODS]
    assert all(r.fp == 0 and r.landmarks == r.visible for r in rows if r.method == "known")
    assert "landmarks within" in capsys.readouterr().out

"""Progress where there is no terminal: how many runs at what rate, a line each minute, and what is kept."""

from __future__ import annotations

import time

from eval.plan import console as told
from eval.plan.console import first_line, next_line, progress, say_kept


def test_the_first_line_has_the_number_of_runs_the_rate_and_the_time_left():
    assert (
        first_line("estimating", 10, 1900, 5.0)
        == "estimating: 1900 runs, 10 done in 5 s (2 a second): about 16 min left"
    )
    assert (
        first_line("estimating", 1, 61, 30.0) == "estimating: 61 runs, 1 done in 30 s (2 a minute): about 30 min left"
    )
    assert next_line("estimating", 0, 1, 60.0) == "estimating: 0 of 1 run after 1 min"
    assert next_line("writing", 120, 480, 7200.0, "part") == "writing: 120 of 480 parts after 2.0 h, about 6.0 h left"


def lines_of(jobs, seconds, capsys, quiet=False):
    with progress("estimating", quiet, lambda: None) as update:
        update(0, jobs)
        for done in range(1, jobs + 1):
            time.sleep(seconds)
            update(done, jobs)
    return capsys.readouterr().err.splitlines()


def test_a_long_command_writes_the_first_line_and_then_one_each_minute(monkeypatch, capsys):
    monkeypatch.setattr(told, "FIRST", 0.15)
    monkeypatch.setattr(told, "EVERY", 0.2)
    lines = lines_of(10, 0.08, capsys)
    assert lines[0].startswith("estimating: 10 runs, ")
    assert 2 <= len(lines) <= 5
    assert all(" of 10 runs after " in line for line in lines[1:])
    assert lines_of(10, 0.03, capsys, quiet=True) == []


def test_it_speaks_each_minute_even_if_nothing_is_finished(monkeypatch, capsys):
    monkeypatch.setattr(told, "FIRST", 0.05)
    monkeypatch.setattr(told, "EVERY", 0.1)
    assert lines_of(1, 0.3, capsys)[0].startswith("estimating: 0 of 1 run after ")


def test_runs_that_are_kept_are_counted(capsys):
    say_kept(3, 5, quiet=False)
    say_kept(3, 5, quiet=True)
    say_kept(0, 5, quiet=False)
    assert capsys.readouterr().err == "3 of 5 runs are kept from before and are not repeated\n"

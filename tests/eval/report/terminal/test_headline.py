"""The main numbers on the terminal: few lines that fit, the runs that matter first, blank where nothing is known."""

from __future__ import annotations

import pytest

import slamref
from eval import run_all
from eval.report.headline import LINES, WIDTH, headlines, lines


def trials(*names: str, task: str = "slam", estimators=("dead-reckoning", "ekf", "isam2", "batch")):
    made = []
    for name in names:
        log = slamref.open_log(name)
        runs = slamref.compare(log.inputs(labels=True).without_map(), task, estimators)
        made.append(slamref.Trial(log, task, tuple(runs)))
    return made


def lines_of(*names: str) -> list[str]:
    made = trials(*names)
    return lines(headlines(slamref.score(made), made, (), ()))


def test_one_log_is_named_once_and_every_run_has_its_numbers():
    title, head, *rows, remark = lines_of("arena:0:frames=30")
    assert title == "arena:0:frames=30, slam"
    assert head.split() == ["estimator", "assoc.", "RMSE", "[m]", "NEES", "NIS", "verdict", "wrong"]
    assert [row.split()[0] for row in rows] == ["dead-reckoning", "ekf", "isam2", "batch"]
    scores = slamref.score(trials("arena:0:frames=30")).metrics.set_index(["estimator", "phase"])
    shown = rows[1].split()
    assert float(shown[2]) == pytest.approx(scores["rmse_position_m"]["ekf", "online"], rel=0.01)
    assert shown[5] in ("consistent", "overconfident", "conservative")
    assert rows[1].endswith(f"0 of {scores['accepted']['ekf', 'online']}")
    assert remark == "(expected: NEES 3, NIS 1; verdict on NIS, over runs on NEES; wrong: of pairings)"


def test_many_runs_are_cut_to_what_fits_and_each_log_keeps_its_filter_and_its_smoother():
    names = [f"arena:{seed}:frames=12+landmarks=12" for seed in range(4)]
    lines = lines_of(*names)
    assert len(lines) == LINES
    assert max(map(len, lines)) <= WIDTH
    assert sum(" ekf " in line for line in lines) == 4
    assert sum(" batch " in line for line in lines) == 4
    assert lines[-2] == "and 7 more rows, in metrics.csv and consistency.csv"


def test_nothing_estimated_is_no_table():
    assert lines(headlines(slamref.score([]), [], (), ())) == []


def test_the_command_prints_it_and_quiet_does_not(tmp_path, capsys):
    words = ["--log", "linear:0", "--estimator", "ekf", "--no-plots", "--jobs", "1", "--out", str(tmp_path / "out")]
    assert run_all.main(words) == 0
    said = capsys.readouterr().out
    assert "RMSE [m]" in said
    assert said.splitlines()[-1].startswith("report: ")
    assert run_all.main([*words, "-q"]) == 0
    assert capsys.readouterr() == ("", "")

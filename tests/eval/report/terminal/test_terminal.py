"""The main numbers on the terminal: few lines that fit, the runs that matter first, blank where nothing is known."""

from __future__ import annotations

from dataclasses import replace

import pytest

import slamref
from eval.judgement.judgement import judge
from eval.report.terminal import ROWS, WIDTH, groups_of, lines


def trials(*names: str, task: str = "slam", estimators=("dead-reckoning", "ekf", "isam2", "batch")):
    made = []
    for name in names:
        log = slamref.open_log(name)
        runs = slamref.compare(log.inputs(labels=True).without_map(), task, estimators)
        made.append(slamref.Trial(log, task, tuple(runs)))
    return made


def groups(*names: str):
    made = trials(*names)
    scores = slamref.score(made)
    return groups_of([(t, judge(t, scores)) for t in made], scores, (), ())


def lines_of(*names: str) -> list[str]:
    return lines(groups(*names))


def test_one_log_is_named_once_and_every_run_has_its_numbers():
    title, head, *rows, means, verdict, phases = lines_of("arena:0:frames=30")
    assert title == "arena:0:frames=30, SLAM"
    assert head.split() == ["estimator", "association", "RMSE", "[m]", "NEES", "NIS", "verdict", "wrong"]
    assert [row.split(",")[0].split()[0] for row in rows] == ["dead-reckoning", "ekf", "isam2", "batch"]
    assert "batch, final " in rows[3]
    assert phases.startswith("(online: ")
    scores = slamref.score(trials("arena:0:frames=30")).metrics.set_index(["estimator", "phase"])
    shown = rows[1].replace("ekf, online", "ekf").split()
    assert float(shown[2]) == pytest.approx(scores["rmse_position_m"]["ekf", "online"], rel=0.01)
    assert shown[5:7] == ["innovations", "fit"]
    assert rows[1].endswith(f"0 of {scores['accepted']['ekf', 'online']}")
    assert "expected 3" in means
    assert verdict.startswith("(verdict: ")


def test_of_several_logs_each_has_its_full_name_and_its_best_and_worst_row():
    names = [f"arena:{seed}:frames=12+landmarks=12" for seed in range(4)]
    found = groups(*names)
    assert [g.log for g in found] == names
    for g in found:
        best, worst = g.rows
        assert best.rmse <= worst.rmse
        assert "dead-reckoning" not in (best.estimator, worst.estimator)
        assert len(g.rows) + g.more == 4
    said = lines(found)
    assert max(map(len, said)) <= WIDTH
    assert all(any(line.startswith(f"{name}, SLAM") for line in said) for name in names)


def test_rows_that_do_not_fit_lose_columns_not_names():
    (group,) = groups("arena:0:frames=30")
    long = group._replace(rows=tuple(replace(r, estimator="x" * 18) for r in group.rows))
    said = lines([long])
    assert max(map(len, said)) <= WIDTH
    assert "NIS " not in said[1]
    assert "x" * 18 in said[2]
    assert len(group.rows) <= ROWS

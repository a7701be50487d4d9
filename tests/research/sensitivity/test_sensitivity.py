"""The study of sensitivity: its runs, that it goes on where it ended, and what its table says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.errors import UsageError
from eval.replay.hindsight import constants
from eval.replay.run import step_by_step
from eval.replay.settings import HINDSIGHT
from tests.research.__main__ import main
from tests.research.sensitivity import study
from tests.research.sensitivity.cases import (
    DOUBLED,
    HALVED,
    SLAM,
    Case,
    chosen,
    fewest,
    load,
    named,
    simulated,
    world_name,
    worlds,
)
from tests.research.sensitivity.study import (
    BASE,
    Job,
    Row,
    append,
    baseline,
    cost_lines,
    effect,
    jobs_of,
    line_of,
    measure_all,
    read,
    read_lines,
    run,
    summaries,
    table,
    variant,
)
from tests.research.variety.measure import SLOW
from tests.research.variety.worlds import draw

SMALL = Case(world_name(23), SLAM)
TWO = chosen(["CONFIRMED", "TIGHT.curvature"])


def row(log="a", constant="", direction=BASE, rmse=1.0, fp=10, landmarks=100, same=1, status="ok", reads="CONFIRMED=3"):
    return Row(log, SLAM, constant, direction, "2", 1000, rmse, fp, 3, landmarks, same, "ab", 0.5, status, reads)


def test_the_baseline_is_the_decider_on_the_log_and_says_what_it_reads():
    log = load(SMALL.log, None)
    found = baseline(SMALL, log)
    ours = step_by_step("ekf", log.inputs().without_map(), "slam", HINDSIGHT)
    assert found.digest == study.digest(ours)
    assert found.landmarks == len(ours.map)
    assert "CONFIRMED=" in found.reads
    assert "LOST_SHARE" not in found.reads
    assert found._replace(seconds=0.0) == baseline(SMALL, log)._replace(seconds=0.0)


@pytest.mark.slow
def test_a_changed_constant_changes_the_run_alone():
    case = Case(world_name(197), SLAM)
    log, before = load(case.log, None), constants.CONFIRMED
    base = baseline(case, log)
    found = variant(Job(case, "CONFIRMED", DOUBLED), log, base)
    assert found.value == "8"
    assert found.digest != base.digest
    assert found.same == 0
    assert before == constants.CONFIRMED
    assert run(log, SLAM).digest == base.digest


def test_the_gates_of_a_run_are_varied_too():
    log = load(SMALL.log, None)
    base = baseline(SMALL, log)
    assert variant(Job(SMALL, "gates.GATE", HALVED), log, base).value == "0.995"
    wide = variant(Job(SMALL, "gates.NEW_GATE", DOUBLED), log, base)
    assert (wide.value, wide.status) == ("0.99998", "ok")


def test_a_constant_is_put_back_when_a_run_ends_in_an_error(monkeypatch):
    def broken(*_):
        raise ZeroDivisionError

    before = constants.CONFIRMED
    monkeypatch.setattr(study, "run", broken)
    with pytest.raises(ZeroDivisionError):
        variant(Job(SMALL, "CONFIRMED", DOUBLED), None, row())
    assert before == constants.CONFIRMED


def test_a_run_that_takes_too_long_is_slow_and_nothing_is_varied_there():
    found = run(load(SMALL.log, None), SLAM, limit=0.0)
    assert found.status == SLOW
    assert jobs_of(row(status=SLOW), TWO) == []


def test_a_constant_that_is_not_read_is_not_run():
    assert [(j.constant, j.direction) for j in jobs_of(row(reads="AGREE=2"), TWO)] == [
        ("TIGHT.curvature", HALVED),
        ("TIGHT.curvature", DOUBLED),
    ]
    assert len(jobs_of(row(), TWO)) == 4


def test_what_is_done_is_not_run_again(monkeypatch):
    ran = []

    def done(job, base, data):
        ran.append((job.case.log, job.constant, job.direction))
        return row(job.case.log, job.constant, job.direction)

    monkeypatch.setattr(study, "do", done)
    cases = [Case("a", SLAM), Case("b", SLAM)]
    kept = [row(), row("a", "CONFIRMED", HALVED)]
    places = [place for place, _ in measure_all(cases, chosen(["CONFIRMED"]), kept)]
    assert ran == [
        ("b", "", BASE),
        ("a", "CONFIRMED", DOUBLED),
        ("b", "CONFIRMED", HALVED),
        ("b", "CONFIRMED", DOUBLED),
    ]
    assert places == ["1 of 1", "1 of 3", "2 of 3", "3 of 3"]
    ran.clear()
    assert [r.log for _, r in measure_all(cases, chosen(["CONFIRMED"]), kept[:1], only_base=True)] == ["b"]
    assert ran == [("b", "", BASE)]


def test_a_file_of_rows_is_read_as_written_without_a_line_that_was_cut_off(tmp_path):
    file = tmp_path / "s.csv"
    rows = [row(rmse=math.inf), row("b", "CONFIRMED", HALVED, 0.25, status=SLOW, reads="")]
    for r in rows:
        append(r, file)
    assert read(file) == rows
    assert read(tmp_path / "none.csv") == []
    with file.open("a", encoding="utf-8") as f:
        f.write("b,slam,CERT")
    assert read(file) == rows
    append(rows[0], file)  # over the line that was cut off
    assert read(file) == [*rows, rows[0]]


def test_worlds_are_those_with_the_fewest_readings_of_each_kind():
    assert [draw(i).name.partition(":")[0] for i in range(1, 13, 2)] == ["arena", "park", "corridor"] * 2
    assert fewest({1: 9, 7: 8, 3: 50, 9: 60, 5: 70, 11: 70}, 4) == [1, 3, 5, 7]
    assert fewest({1: 9, 7: 8}, 1) == [7]
    assert worlds("judge", 0) == []
    assert len(worlds("judge", None)) == 100


def test_recorded_logs_that_are_not_there_are_said_to_be_left_out(tmp_path):
    cases, missing = named(tmp_path, every_robot=True)
    assert [c.log for c in cases] == ["corridor:0:people", "victoria-park"]
    assert [line.partition("(")[0] for line in missing] == [f"left out: UTIAS Dataset {n} " for n in (1, 6, 9)]


def test_more_simulated_logs_may_be_named():
    assert simulated(["arena:0", "corridor:0:people", "arena:0"]) == [Case("arena:0", SLAM)]
    with pytest.raises(UsageError, match="no simulated log"):
        simulated(["victoria-park"])
    with pytest.raises(UsageError, match="whatever"):
        simulated(["arena:0:whatever"])


def test_a_change_is_put_beside_the_baseline():
    e = effect(row(rmse=1.2, fp=15, landmarks=90, same=0), row())
    assert (e.rmse, e.fp, e.landmarks, e.counts) == pytest.approx((1.2, 0.005, -10, 0.015))
    assert effect(row(rmse=math.nan), row(rmse=math.nan)).rmse == 1.0
    assert effect(row(rmse=math.nan, status=SLOW), row()).rmse == math.inf


@pytest.mark.parametrize(
    ("reads", "changes", "says"),
    [
        ("AGREE=1", None, "not read"),
        ("CONFIRMED=1", {}, "no result"),
        ("CONFIRMED=1", {"same": 0, "rmse": 1.09, "fp": 25, "landmarks": 104}, "little"),
        ("CONFIRMED=1", {"same": 0, "fp": 25, "landmarks": 106}, "matters"),
        ("CONFIRMED=1", {"same": 0, "rmse": 1.11}, "matters"),
        ("CONFIRMED=1", {"same": 0, "rmse": 0.9}, "matters"),
        ("CONFIRMED=1", {"same": 0, "status": SLOW, "rmse": math.nan}, "matters"),
    ],
)
def test_a_constant_is_of_a_class(reads, changes, says):
    rows = [row(reads=reads)]
    if changes is not None:
        rows += [row(constant="CONFIRMED", direction=HALVED), row(constant="CONFIRMED", direction=DOUBLED, **changes)]
    (found,) = summaries(rows, chosen(["CONFIRMED"]))
    assert found.says == says
    assert found.runs == found.needed
    assert table([found])[-1].count(f"{says}: 1") == 1


def test_the_table_says_what_is_not_done_yet():
    lines = table(summaries([row(), row(constant="CONFIRMED", direction=HALVED)], chosen(["CONFIRMED"])))
    assert "no result (1 of 2 runs)" in lines[2]
    assert len({line.count("|") for line in lines[:3]}) == 1


def test_the_table_has_medians_of_changed_decisions_and_extremes_of_all_runs():
    rows = [
        row(), row("b"),
        row(constant="CONFIRMED", direction=HALVED, rmse=0.8, fp=5, landmarks=97, same=0),
        row(constant="CONFIRMED", direction=DOUBLED, rmse=1.5, fp=30, landmarks=110, same=0),
        row("b", "CONFIRMED", DOUBLED, rmse=3.0),
    ]  # fmt: skip
    head, _, line, blank, counts = table(summaries(rows, chosen(["CONFIRMED"])))
    # FP are 10 of 1000 readings in the baseline: 5 are 0.5 % less, 30 are 2 % more
    assert [cell.strip() for cell in line.strip("|").split("|")] == [
        "`CONFIRMED`", "4", "2", "8", "2", "1", "1", "1.150", "0.80", "3.00", "-0.5", "+2.0", "-3", "+10",
        "matters (3 of 4 runs)",
    ]  # fmt: skip
    assert "FP, least [% of readings]" in head
    assert blank == ""
    assert counts == "matters: 1, little: 0, no result: 0, not read: 0"


def test_the_table_has_dashes_where_nothing_was_run_and_a_ratio_of_one_where_no_decision_changed():
    (never,) = table(summaries([row(reads="AGREE=1")], chosen(["CONFIRMED"])))[2:3]
    assert [cell.strip() for cell in never.strip("|").split("|")][4:] == ["0", "0", "0", *"–" * 7, "not read"]
    (same,) = table(summaries([row(), row(constant="CONFIRMED", direction=HALVED)], chosen(["CONFIRMED"])))[2:3]
    cells = [cell.strip() for cell in same.strip("|").split("|")]
    assert cells[7:14] == ["1.000", "1.00", "1.00", "+0.0", "+0.0", "+0", "+0"]


def test_costs_leave_out_what_is_not_read():
    base = [row(), row("b", reads="AGREE=1")]
    assert cost_lines(base, chosen(["CONFIRMED"]))[-1].startswith("2 runs instead of 4, ")
    assert read_lines(base, TWO)[2] == "| `CONFIRMED` | 4 | 1 of 2 | 3 |"
    assert read_lines(base, TWO)[3] == "| `TIGHT.curvature` | 0.002 | 2 of 2 | every run |"


def test_a_line_says_what_was_changed():
    assert "CONFIRMED halved (2)" in line_of(row(constant="CONFIRMED", direction=HALVED, same=0), "3 of 9")
    assert "other decisions" in line_of(row(same=0), "")


@pytest.mark.slow
def test_the_command_writes_rows_and_table_and_goes_on(tmp_path, capsys):
    arguments = ["sensitivity", str(tmp_path), "--worlds", "1", "--constant", "CONFIRMED"]
    assert main([*arguments, "--baseline"]) == 0
    assert "runs instead of" in capsys.readouterr().out
    file = tmp_path / "sensitivity.csv"
    first, text = read(file), file.read_text()
    assert main([*arguments, "--processes", "2"]) == 0
    rows = read(file)
    assert file.read_text().startswith(text)
    assert len(rows) == 3 * len(first)
    assert "| `CONFIRMED` | 4 | 2 | 8 |" in (tmp_path / "sensitivity.md").read_text()
    assert np.isfinite([r.rmse_m for r in rows if r.log.startswith("variety")]).all()

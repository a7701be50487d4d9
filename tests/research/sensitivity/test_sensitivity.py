"""The study of sensitivity: its runs, that it goes on where it ended, and what its table says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eval.replay.hindsight import constants
from tests.research.__main__ import main
from tests.research.rows import read
from tests.research.sensitivity.cases import (
    DOUBLED,
    HALVED,
    SLAM,
    Case,
    chosen,
    load,
    world_name,
)
from tests.research.sensitivity.study import (
    BASE,
    Job,
    Row,
    baseline,
    run,
    summaries,
    table,
    variant,
)
from tests.research.variety.measure import SLOW


def row(log="a", constant="", direction=BASE, rmse=1.0, fp=10, landmarks=100, same=1, status="ok", reads="CONFIRMED=3"):
    return Row(log, SLAM, constant, direction, "2", 1000, rmse, fp, 3, landmarks, same, "ab", 0.5, status, reads)


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


@pytest.mark.slow
def test_the_command_writes_rows_and_table_and_goes_on(tmp_path):
    arguments = ["sensitivity", str(tmp_path), "--worlds", "1", "--constant", "CONFIRMED"]
    assert main([*arguments, "--processes", "2"]) == 0
    file = tmp_path / "sensitivity.csv"
    rows, text = read(Row, file), file.read_text()
    file.write_text(text[:-9])  # interrupted while it was written
    assert main(arguments) == 0
    assert len(read(Row, file)) == len(rows) == 3 * len({(r.log, r.task) for r in rows})
    assert "| `CONFIRMED` | 4 | 2 | 8 |" in (tmp_path / "sensitivity.md").read_text()
    assert np.isfinite([r.rmse_m for r in rows if r.log.startswith("variety")]).all()

"""Tables of a study of the battery: shares of the logs that could be judged, right causes among what is detected."""

from __future__ import annotations

import pytest

from tests.research.diagnosis.study import Examined, Validation, World
from tests.research.diagnosis.tables import power_table, size_table

ARENA, CIRCLE = World("arena", "arena", "slam"), World("circle", "circle", "slam")
STUDY = Validation("trust", (ARENA, CIRCLE), 4, 39, "arena", 4)


def log(fault="", size=0.0, *, objected=False, cause="nothing", world="arena", **more):
    return Examined(world, 0, fault, size, 0.025 if objected else 0.5, objected, cause, **more)


def test_size_counts_each_world_and_all_and_leaves_out_what_failed():
    found = [log(), log(), log(objected=True, cause="noise"), log(cause="estimator", nis=True)]
    found += [log(failure="batch failed"), *[log(world="circle")] * 2, log("latency", 0.1, objected=True)]
    table = size_table(STUDY, found).set_index("world")
    shares = ["objected [%]", "noise [%]", "associations [%]", "estimator [%]", "NIS alone [%]"]
    assert table.loc["arena", ["logs", "failed"]].tolist() == [4, 1]
    assert table.loc["arena", shares].tolist() == [25.0, 25.0, 0.0, 25.0, 25.0]
    assert table.loc["all", ["logs", "failed"]].tolist() == [6, 1]
    assert table.loc["all", "objected [%]"] == pytest.approx(100.0 / 6.0)


def test_the_right_cause_is_counted_among_what_is_detected():
    found = [
        log(),
        *[log("latency", 0.2, objected=True, cause="noise")] * 2,
        log("latency", 0.2, objected=True, cause="estimator", nis=True),
        log("latency", 0.2, cause="nothing"),
    ]
    row = power_table(STUDY, found).iloc[1]
    assert (row["fault"], row["size"], row["logs"]) == ("latency", "0.2 s", 4)
    assert row["detected [%]"] == 75.0
    assert row["±"] == pytest.approx(100.0 * (0.75 * 0.25 / 4.0) ** 0.5)
    assert row["right cause [%]"] == pytest.approx(200.0 / 3.0)
    assert row["taken for"] == "estimator"
    assert row["NIS alone [%]"] == 25.0

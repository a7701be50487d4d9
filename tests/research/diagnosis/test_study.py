"""The study of the battery: logs are independent, faults reach them, and each is judged as any other log."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.research.diagnosis.study import (
    Case,
    Examined,
    Validation,
    World,
    examined,
    results,
)
from tests.research.diagnosis.tables import power_table, size_table

TINY = Validation(
    "tiny",
    (World("arena", "arena", "slam", (("frames", 40), ("landmarks", 10))),),
    2,
    19,
    "arena",
    1,
    ("wrong-labels",),
    ("reported",),
)


@pytest.mark.slow
def test_wrong_labels_are_put_down_to_the_associations():
    (found,) = examined(TINY, Case(TINY.worlds[0], 1, "wrong-labels", 0.05))
    assert found.objected
    assert found.cause == "associations"
    assert found.p == pytest.approx(1 / 20)
    assert found.found[0] == "pairings readings"
    assert found.nis
    assert not found.failure


def test_a_broken_filter_is_convicted_by_twins_and_a_sound_one_is_not():
    case = Case(TINY.worlds[0], 2, broken=(("reported", 1.0), ("reported", 0.25), ("reading-noise", 0.25)))
    sound, modest, credulous = examined(TINY, case)
    assert not sound.convicted
    assert modest.convicted
    assert modest.cause == "estimator"
    assert not modest.nis  # its innovations are those of the sound filter
    assert credulous.convicted
    assert credulous.nis


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["arena", "corridor", "circle"])
def test_the_battery_objects_to_one_log_in_twenty_that_is_right(kind):
    values = {"arena": (("frames", 100),), "circle": (("frames", 400),)}.get(kind, ())
    world = World(kind, kind, "slam", values)
    found = [examined(replace(TINY, worlds=(world,)), Case(world, seed))[0] for seed in range(40)]
    assert not [e.failure for e in found if e.failure]
    # of 40, 8 or more happen once in a thousand at 5 %
    assert sum(e.objected for e in found) < 8


def test_what_was_judged_before_an_interruption_is_not_judged_again(tmp_path, monkeypatch):
    small = replace(TINY, worlds=(World("arena", "arena", "slam", (("frames", 12), ("landmarks", 8))),), power_runs=0)
    first = results(replace(small, runs=1), tmp_path, 0, jobs=1)
    asked = []

    def simulated(case):
        asked.append(case.seed)
        return case.world.simulate(case.seed)

    monkeypatch.setattr("tests.research.diagnosis.study.log_of", simulated)
    both = results(small, tmp_path, 0, jobs=1)
    assert asked == [1]
    assert [e.seed for e in both] == [0, 1]
    assert both[0] == first[0]


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

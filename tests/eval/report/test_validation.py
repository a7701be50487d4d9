"""Tables of a study of the battery: shares of the logs that could be judged, right causes among what is detected."""

from __future__ import annotations

from dataclasses import replace

import pytest

from eval.referee.consistency import share_interval
from eval.report.page.blocks import Table
from eval.report.studies import Diverged, detected, power_table, size_table, validation_facts, validation_section
from eval.report.words import say
from eval.studies.validation import Examined, Validation, World

ARENA, CIRCLE = World("arena", "arena", "slam"), World("circle", "circle", "slam")
STUDY = Validation("trust", "trust", "About.", (ARENA, CIRCLE), 4, 39, "arena", 4)


def log(fault="", size=0.0, *, objected=False, cause="nothing", world="arena", **more):
    return Examined(world, 0, fault, size, 0.025 if objected else 0.5, objected, cause, **more)


def test_without_a_hit_the_exact_interval_is_the_rule_of_three():
    lower, upper = share_interval(0, 100)
    assert lower == 0.0
    assert (1.0 - upper) ** 100 == pytest.approx(0.025)
    assert share_interval(100, 100) == pytest.approx((1.0 - upper, 1.0))


def test_an_exact_interval_leaves_a_fortieth_on_each_side():
    lower, upper = share_interval(1, 2)
    assert 1.0 - (1.0 - lower) ** 2 == pytest.approx(0.025)  # one or more of two
    assert 1.0 - upper**2 == pytest.approx(0.025)  # one or fewer of two


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


def test_twins_that_convict_count_for_a_broken_filter_and_not_for_a_fault_of_the_log():
    assert detected(log("reported", 0.5, convicted=True, cause="estimator"))
    assert not detected(log("latency", 0.1, convicted=True, cause="estimator"))
    row = power_table(STUDY, [log("reported", 0.5, convicted=True, cause="estimator")]).iloc[1]
    assert (row["fault"], row["detected [%]"], row["right cause [%]"]) == ("filter: reported", 100.0, 100.0)


def test_the_section_says_how_many_right_logs_are_objected_to_and_how_many_faults_are_named():
    found = [log(objected=True, cause="noise"), *[log()] * 19]
    found += [log("curvature", 0.02, objected=True, cause="noise")] * 10
    found += [log("wrong-labels", 0.05, objected=True, cause="noise")] * 10
    stems = []
    section = validation_section(STUDY, found, lambda frame, stem, caption: stems.append(stem) or Table(frame, caption))
    facts = validation_facts(STUDY, found)
    assert facts.items() >= {"sound": 20, "objected": 1, "sure": 2, "met": 1}.items()
    text = "\n".join(b for b in section.blocks if isinstance(b, str))
    assert "Of 20 logs without a fault, 1 are rejected (5.0 %)" in text
    assert ("2 faults are detected in 90 % of the logs or more; 1 of them are attributed to the right cause") in text
    assert stems == ["trust_size", "trust_power"]


def test_what_diverged_is_listed_once_with_what_replays_it():
    run = Diverged("slam", "ekf", "nn", 3, "frame 7: lost", False, "python -m eval.run_all --seed 3")
    doubtful = replace(run, seed=4, implausible=True)
    assert say("studies#diverged", lost=()) == "Every run of every estimator reached its end."
    assert say("studies#diverged", lost=(run, run)) == (
        "2 runs diverged; they are in no average:\n\n"
        "* seed 3: `ekf` (slam, nn), frame 7: lost: `python -m eval.run_all --seed 3`"
    )
    both = say("studies#diverged", lost=(run, doubtful))
    assert both.startswith("2 runs diverged or are implausible; they are in no average:\n\n* seed 3:")
    assert "* seed 4: `ekf` (slam, nn), implausible, frame 7: lost:" in both
    many = say("studies#diverged", lost=tuple(replace(run, seed=n) for n in range(23)))
    assert many.endswith("* … and 3 more")
    assert many.count("\n* seed") == 20

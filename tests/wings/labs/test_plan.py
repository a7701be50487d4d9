"""`--lab` states what is run on what: four conditions of one corridor, each with the constants that matter in it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from data.errors import UsageError
from data.formats.open_log import write_folder
from data.logs import Reading, open_log
from eval.plan.flags.options import read_options
from eval.plan.provenance import command_of
from wings.labs.plan import METHODS, corridor_names, lab_experiments, switched_on

FOUR = [(False, True), (True, True), (False, False), (True, False)]


def said(*arguments: str):
    heard: list[str] = []
    options = read_options(list(arguments))
    asked = options.selection
    return lab_experiments(asked.lab, asked.estimator, options.setup, Reading(), heard.append), heard


@pytest.mark.parametrize(("lab", "names"), [
    ("corridor:3", ["corridor:3", "corridor:3:people", "corridor:3:no-odometry", "corridor:3:people+no-odometry"]),
    ("corridor:3+srho=0.05", [
        "corridor:3:srho=0.05", "corridor:3:people+srho=0.05", "corridor:3:no-odometry+srho=0.05",
        "corridor:3:people+no-odometry+srho=0.05",
    ]),
    ("corridor:3:crowd=4+sx-blind=.3+stheta_move=1", [
        "corridor:3:stheta_move=1", "corridor:3:people+crowd=4+stheta_move=1", "corridor:3:no-odometry+sx-blind=.3",
        "corridor:3:people+no-odometry+crowd=4+sx-blind=.3",
    ]),
])  # fmt: skip
def test_a_lab_is_four_logs_with_the_constants_that_have_an_effect(lab, names):
    assert corridor_names(lab) == names
    assert [switched_on(open_log(name)) for name in names] == FOUR


@pytest.mark.parametrize(("lab", "words"), [
    ("corridor:3+people", "people is a condition; the lab has all four"), ("corridor:x", "the seed is a whole number"),
    ("corridor:3+sigma=1", "'sigma=1' is not known"), ("nowhere", "no such folder; a folder, corridor:SEED"),
])  # fmt: skip
def test_what_is_no_lab_is_said_in_a_line(lab, words):
    with pytest.raises(UsageError, match=words):
        said("--lab", lab)


@pytest.mark.parametrize("other", [
    ("--log", "arena:0"), ("--scenario", "arena"), ("--task", "slam"), ("--association", "nn"), ("--data", "."),
    ("--full",), ("--twins", "3"),
])  # fmt: skip
def test_a_lab_states_logs_tasks_and_methods_itself(other):
    with pytest.raises(UsageError, match=f"{other[0]} and --lab exclude each other: a lab states what is run"):
        read_options(["--lab", "corridor:0", *other])


def test_every_method_is_run_in_every_condition_without_maintenance_and_with_it():
    experiments, _ = said("--lab", "corridor:3")
    plain, kept = ([e for e in experiments if (e.variant_of is None) == first] for first in (True, False))
    assert [switched_on(e.log) for e in plain] == [switched_on(e.log) for e in kept] == FOUR
    for e in plain:
        assert {*METHODS, "known"} < {w.association for w in e.work}
        assert not e.setup.maintain
    for e in kept:
        assert {w.association for w in e.work} == set(METHODS)
        assert e.setup.maintain
    with pytest.raises(UsageError, match="answered from ekf, or else isam2"):
        said("--lab", "corridor:3", "--estimator", "batch")


def test_the_lab_has_one_gate_unless_two_are_asked_for():
    assert read_options(["--lab", "corridor:0"]).setup.new_gate == 0.99
    assert read_options(["--lab", "corridor:0", "--gate", "0.95"]).setup.new_gate == 0.95
    two = read_options(["--lab", "corridor:0", "--new-gate", "0.99999"])
    assert two.setup.new_gate == 0.99999
    assert "--new-gate 0.99999" in command_of(two), "it is the default of other runs, and not of this one"
    assert read_options(["--log", "corridor:0"]).setup.new_gate == 0.99999


def test_a_folder_of_recorded_runs_must_hold_every_condition_and_others_are_skipped(tmp_path):
    logs = [replace(open_log(name), name=f"log{k}") for k, name in enumerate(corridor_names("corridor:5+frames=6"))]
    for log in logs[:3]:
        write_folder(log, tmp_path / log.name)
    with pytest.raises(UsageError, match="no log with people and without odometry; the lab needs all four"):
        said("--lab", str(tmp_path))
    write_folder(logs[3], tmp_path / logs[3].name)
    write_folder(replace(logs[0], name="zz"), tmp_path / "zz")
    experiments, heard = said("--lab", str(tmp_path))
    assert [e.log.name for e in experiments if e.variant_of is None] == [log.name for log in logs]
    assert heard == ["skipped zz: log0 has the same condition"]
    with pytest.raises(UsageError, match="one log; the lab's folder holds one for each condition"):
        said("--lab", str(tmp_path / "zz"))

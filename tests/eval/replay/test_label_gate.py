"""The gate of readings paired by label, where nobody asks for one: there where a sensor read the labels, else none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.formats.open_log import write_folder
from data.log import Log
from data.logs import open_log
from eval.inspect import main as inspect
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.replay.run import compare, step_by_step
from eval.replay.settings import SENSED_GATE, Setup
from eval.report.log_sections import gate_sentence
from eval.tune import main as tune

WRONG = 40
"""An observation whose label is of another landmark."""


@pytest.fixture(scope="module")
def sensed() -> Log:
    """A log whose labels a sensor read, one of them wrong."""
    log = open_log("arena:3")
    label = log.granted.copy()
    label[WRONG] = (label[WRONG] + 7) % len(log.truth.landmarks.id)
    return replace(log, label=label, labels_are_sensed=True)


def ekf(log, setup=Setup(), task="localization"):
    return compare(log.inputs(labels=True), task, ["ekf"], setup=setup)[0]


def same(a, b):
    return (
        np.array_equal(a.online.pose, b.online.pose) and np.array_equal(a.decisions, b.decisions) and a.gated == b.gated
    )


def test_a_misread_label_is_left_out_by_itself_by_filters_and_smoothers(sensed):
    for run in compare(sensed.inputs(labels=True), "localization", ["ekf", "isam2", "batch"]):
        assert run.final_decisions[WRONG] < 0
        assert (run.final_decisions >= 0).sum() >= 0.999 * len(run.final_decisions) - 1
    run = step_by_step("ekf", sensed.inputs(labels=True), "slam")
    assert run.decisions[WRONG] < 0


def test_without_a_gate_that_was_asked_for_every_label_counts(sensed):
    run = ekf(sensed, Setup(gate_known=None))
    assert run.decisions[WRONG] == sensed.label[WRONG]
    assert run.gated == (1.0, 2.0)
    assert (ekf(sensed, Setup(gate_known=0.5)).decisions < 0).sum() > 100


def test_labels_that_no_sensor_read_are_not_gated(sensed):
    claimed = replace(sensed, labels_are_sensed=False)
    assert same(ekf(claimed), ekf(claimed, Setup(gate_known=None)))
    arena = open_log("arena:3")
    assert same(ekf(arena), ekf(arena, Setup(gate_known=None)))
    assert not same(ekf(arena), ekf(arena, Setup(gate_known=0.99)))


@pytest.mark.parametrize(
    ("words", "gates"),
    [
        ([], [None, SENSED_GATE]),
        (["--gate-known", "auto"], [None, SENSED_GATE]),
        (["--gate-known", "none"], [None, None]),
        (["--gate-known", "0.99"], [0.99, 0.99]),
    ],
)
def test_a_plan_settles_it_log_by_log(sensed, tmp_path, words, gates):
    write_folder(replace(sensed, name="sensed"), tmp_path / "sensed")
    plan = make_plan(read_options(["--log", "arena:3", "--log", str(tmp_path / "sensed"), *words]), print)
    assert [e.setup.gate_known for e in plan.experiments] == gates


def test_what_is_said_of_it(sensed, tmp_path, capsys):
    assert "beyond the 0.9999 quantile" in gate_sentence(Setup(), sensed=True)
    assert "default for labels read by a sensor" in gate_sentence(Setup(), sensed=True)
    assert gate_sentence(Setup(), sensed=False).startswith("Pairings by label are not gated (default")
    assert gate_sentence(Setup(gate_known=None), sensed=True) == "Pairings by label are not gated."
    assert "smoothers keep them" in gate_sentence(Setup(gate_smoothers=False), sensed=True)
    write_folder(sensed, tmp_path / "log")
    assert inspect([str(tmp_path / "log")]) == 0
    assert "beyond the 0.9999 quantile" in capsys.readouterr().out


def test_a_fit_leaves_misread_labels_out_unless_told_otherwise(sensed, tmp_path, capsys):
    write_folder(sensed, tmp_path / "log")
    for words, factor in (([], "gated"), (["--gate", "none"], "all")):
        assert tune([str(tmp_path / "log"), str(tmp_path / factor), "--fit", "sensor", *words]) == 0
    out = capsys.readouterr().out.split("written:")
    assert out[0] != out[1].split("\n", 1)[1]
    sigma = [open_log(str(tmp_path / f)).recorded.observations.R[0, 0, 0] for f in ("gated", "all")]
    assert sigma[0] < 0.9 * sigma[1]

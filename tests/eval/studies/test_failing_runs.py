"""A run that fails, wherever and however, ends alone: the study ends, its results stand, the seed is counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ekf.localizer import EkfLocalizer
from eval.report.terminal import study_lines
from eval.studies.montecarlo import consistency_table, judge, one_run, study_of
from eval.studies.scenario import load_scenario
from graph.incremental import Isam2Smoother
from graph.optimum import NotConvergedError
from tests.quick import slow

SMALL = replace(load_scenario("arena"), values=(("frames", 12),), association=("jcbb",), task=("localization",))
SEEDS, BAD = (7, 8, 9), 8
OURS = ("ekf", "isam2", "batch")


def study_with(monkeypatch, owner, place, fault):
    """A study in one run of which a method of an estimator raises."""

    def raising(*_, **__):
        raise fault

    results = []
    for seed in SEEDS:
        with monkeypatch.context() as patch:
            if seed == BAD:
                patch.setattr(owner, place, raising)
            results.append(one_run(SMALL.only(OURS), seed))
    return study_of(SMALL.only(OURS), SEEDS, results)


@pytest.mark.parametrize("place", ["__init__", "expect", "finish", *map(slow, ["predict", "update", "estimate"])])
@pytest.mark.parametrize("fault", [
    RuntimeError("injected"), slow(NotConvergedError("injected")), slow(np.linalg.LinAlgError()),
])  # fmt: skip
def test_isam2_fails_in_one_run(place, fault, monkeypatch):
    """Seen: no final row of that run, and `zip() argument 2 is shorter than argument 1`."""
    study = study_with(monkeypatch, Isam2Smoother, place, fault)
    assert {(lost.key[1], lost.key[3], lost.seed) for lost in study.failures()} == {
        ("isam2", phase, BAD) for phase in ("online", "final")
    }
    table = consistency_table(judge(study)).set_index(["estimator", "phase", "quantity"])
    assert table.loc[("isam2", "final", "pose"), ["runs", "diverged"]].tolist() == [2, 1]
    assert table.loc[("batch", "final", "pose"), ["runs", "diverged"]].tolist() == [3, 0]  # over the filter's decisions
    assert np.isfinite(table.loc[("batch", "final", "pose"), "mean"])
    assert sum(f"seed {BAD}" in line for line in study_lines(study)) == 2


@pytest.mark.parametrize("place", [slow("__init__"), slow("predict"), "update"])
def test_the_filter_fails_in_one_run(place, monkeypatch):
    study = study_with(monkeypatch, EkfLocalizer, place, ZeroDivisionError("injected"))
    assert {(lost.key[1], lost.seed, lost.why.partition(": ")[2]) for lost in study.failures()} == {
        ("ekf", BAD, "ZeroDivisionError: injected")
    }


def test_a_smoother_that_failed_at_its_end_leaves_its_path_to_batch(monkeypatch):
    """Its decisions and online estimates are complete, so batch needs no other front end."""
    whole = one_run(SMALL.only(OURS), BAD)
    study = study_with(monkeypatch, Isam2Smoother, "finish", NotConvergedError("injected"))
    key = ("localization", "batch", "jcbb", "final")
    assert study.samples[key][SEEDS.index(BAD)].means["pose"] == pytest.approx(whole[key].means["pose"], rel=1e-9)

"""A run that fails, wherever and however, ends alone: the study ends, its results stand, the seed is counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from ekf.localizer import EkfLocalizer
from eval.report.terminal import study_lines
from eval.run_all import main
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


@pytest.mark.parametrize("place", ["__init__", "predict", "expect", "update", "estimate", "finish"])
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


@pytest.mark.parametrize("place", ["__init__", "predict", "update"])
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


def test_a_study_whose_every_run_of_an_estimator_fails_ends_too(monkeypatch):
    def raising(*_, **__):
        raise RuntimeError("injected")

    monkeypatch.setattr(Isam2Smoother, "__init__", raising)
    study = study_of(SMALL.only(OURS), SEEDS, [one_run(SMALL.only(OURS), seed) for seed in SEEDS])
    assert len([lost for lost in study.failures() if lost.key[1] == "isam2"]) == 2 * len(SEEDS)
    assert len(study.good(("localization", "ekf", "jcbb", "online"))) == len(SEEDS)


OWN = """
from ekf.localizer import EkfLocalizer

class Failing(EkfLocalizer):
    seen = None

    def __init__(self, *given):
        super().__init__(*given)
        self.frame = 0

    def update(self, observations, decisions, **more):
        self.frame += 1
        if PLACE == "update" and self.frame == 5 and observations.z[0, 0] > LIMIT:
            raise LookupError("injected")
        return super().update(observations, decisions, **more)

    def finish(self):
        if PLACE == "finish":
            raise LookupError("injected")
        return super().finish()
"""
STUDY = """
about = "a small one"
runs = 3
task = ["localization"]
association = ["known"]
[estimators."own=./own.py:Failing"]
[estimators.ekf]
[estimators.batch]
[world]
kind = "arena"
frames = 12
"""


@pytest.mark.slow
@pytest.mark.parametrize("place", ["update", "finish"])
@pytest.mark.parametrize("by", ["one process", "two processes", "Dask"])
def test_own_code_fails_however_the_runs_are_made(place, by, tmp_path, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(f"PLACE, LIMIT = {place!r}, 0.0\n{OWN}")
    (tmp_path / "small.toml").write_text(STUDY)
    asked = ["--scenario", "small.toml", "--out", "r", "--no-plots", "-q"]
    if by == "Dask":
        with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster:
            status = main([*asked, "--scheduler", cluster.scheduler_address])
    else:
        status = main([*asked, "--jobs", "1" if by == "one process" else "2"])
    assert status == 0  # nothing is declared of it
    table = pd.read_csv("r/consistency.csv").query("quantity == 'pose'").set_index("estimator")
    assert table.loc["own", "diverged"] == 3
    assert table.loc["ekf", ["runs", "diverged"]].tolist() == [3, 0]
    lines = (tmp_path / "r/run.log").read_text()
    assert all(f"own (known) diverged with seed {seed}" in lines for seed in range(3))

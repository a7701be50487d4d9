"""A study of the battery among the scenarios: who asks for it, what of it is kept, what the result folder holds."""

from __future__ import annotations

import pandas as pd
import pytest

from data.errors import UsageError
from eval.plan.execute import execute
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.run_all import main

TINY = """
study = "validation"
about = "a small arena"
runs = 2
twins = 19
worlds = [{ kind = "arena", frames = 12, landmarks = 8 }]
power = { runs = 0 }
"""


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return str(path)


def plan_of(*arguments):
    return make_plan(read_options(list(arguments)), lambda text: None)


def test_all_leaves_it_out_and_by_name_it_is_there():
    assert not plan_of("--scenario", "all").validations
    plan = plan_of("--scenario", "trust", "--scenario", "arena")
    assert [(v.name, v.runs, v.power_runs, v.twins) for v in plan.validations] == [("trust", 200, 20, 39)]
    assert [s.name for s, _ in plan.studies] == ["arena"]


def test_fewer_runs_are_fewer_logs_and_quick_takes_the_largest_faults_only():
    (few,) = plan_of("--scenario", "trust", "--runs", "7").validations
    assert (few.runs, few.power_runs, few.largest) == (7, 7, False)
    (quick,) = plan_of("--scenario", "trust", "--quick").validations
    assert (quick.runs, quick.power_runs, quick.twins, quick.largest) == (2, 1, 19, True)


def test_estimators_cannot_be_asked_for():
    with pytest.raises(UsageError, match="--estimator: scenario trust states its own"):
        plan_of("--scenario", "trust", "--estimator", "ekf")


@pytest.mark.slow
def test_the_folder_holds_the_size_and_an_interrupted_study_resumes(written, tmp_path, monkeypatch, capsys):
    out = tmp_path / "results" / "report"
    arguments = ["--scenario", written, "--out", str(out), "--jobs", "1", "--no-plots"]
    options = read_options([*arguments, "--runs", "1"])
    execute(make_plan(options, lambda text: None), options, lambda done, total: None)
    asked = []

    def simulated(case):
        asked.append(case.seed)
        return case.world.simulate(case.seed)

    monkeypatch.setattr("eval.studies.validation.log_of", simulated)
    assert main(arguments) == 0
    assert asked == [1]  # that of seed 0 was kept
    table = pd.read_csv(out / "tables" / "tiny_size.csv")
    assert table["logs"].tolist() == [2]
    assert not (out / "tables" / "tiny_power.csv").exists()
    assert "Scenario tiny" in (out / "report.md").read_text()

"""A run with twins: who gets them, what is kept, and that numbers do not depend on how the work was divided."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from data.formats.open_log import write_folder
from data.inputs import Prior
from data.log import shortened
from data.logs import open_log
from data.notice import Code
from data.truth import Truth
from eval.plan.execute import execute
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.referee.attribution import NOISE
from eval.studies.diagnosis import trust_table


def run(folder, out, *arguments, told=lambda done, total: None):
    options = read_options(["--log", str(folder), "--out", str(out / "report"), "--jobs", "1", *arguments])
    return execute(make_plan(options, lambda text: None), options, told)


@pytest.fixture(scope="module")
def unmeasured(tmp_path_factory):
    log = shortened(open_log("arena:3"), 60)
    mean = log.recorded.increments.mean.copy()
    mean[:, 2] += 0.05 * np.hypot(mean[:, 0], mean[:, 1])
    increments = replace(log.recorded.increments, mean=mean)
    folder = tmp_path_factory.mktemp("logs") / "mine"
    recorded = replace(log.recorded, increments=increments).without_map()
    write_folder(replace(log, recorded=recorded, truth=Truth(), label=log.granted), folder)
    return folder


@pytest.fixture(scope="module")
def outcome(unmeasured, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    return out, run(unmeasured, out, "--estimator", "ekf,isam2,batch", "--twins", "19")


def test_a_log_that_nobody_measured_names_its_fault(outcome):
    (trust,) = outcome[1].trust
    assert trust.blame.cause == NOISE
    first = trust.blame.findings[0]
    # at a constant speed a turn that grows with distance is one that grows with time
    assert {"odometry_theta_distance", "odometry_theta_time"} <= {first.name, *first.other}


@pytest.mark.slow
def test_what_is_kept_is_not_done_again_and_the_numbers_are_the_same(outcome, unmeasured, monkeypatch):
    out, done = outcome
    monkeypatch.setattr("eval.plan.execute.one_twin", None)
    again = run(unmeasured, out, "--estimator", "ekf,isam2,batch", "--twins", "19")
    assert trust_table(again.trust).to_csv() == trust_table(done.trust).to_csv()


def test_without_twins_the_statistics_are_there_and_p_is_blank(outcome, unmeasured, tmp_path):
    table = trust_table(run(unmeasured, tmp_path).trust)
    assert set(table.estimator) == {"ekf", "isam2", "batch"}
    assert table.p.isna().all()
    assert table.p_family.isna().all()
    assert (table.twins == 0).all()
    known = trust_table(outcome[1].trust)
    both = pd.merge(table, known, on=["estimator", "statistic"], suffixes=("", "_twins"))
    assert both.value.tolist() == both.value_twins.tolist()


def test_own_estimators_stand_beside_ours_with_an_nis_that_they_cannot_choose(tmp_path):
    write_folder(shortened(open_log("arena:3"), 30), tmp_path / "log")
    names = ",".join(f"{n}=tests.eval.replay.external.things:{n}Local" for n in ("Mine", "Flattering"))
    arguments = ("--task", "localization", "--estimator", f"ekf,batch,{names}", "--twins", "2")
    done = run(tmp_path / "log", tmp_path, *arguments)
    table = trust_table(done.trust).set_index(["estimator", "statistic"])
    for name in ("Mine", "Flattering"):
        assert set(table.loc[name].index) == set(table.loc["ekf"].index) >= {"nis", "innovation_lag1"}
        assert table.value[name, "nis"] == pytest.approx(table.value["ekf", "nis"])
        assert (table.twins[name] == 2).all()


def test_a_log_too_short_for_twins_is_a_sentence_and_no_p(tmp_path):
    write_folder(shortened(open_log("arena:3"), 6), tmp_path / "short")
    (trust,) = run(tmp_path / "short", tmp_path, "--task", "localization", "--twins", "19").trust
    assert not trust.twins
    assert [n.code for n in trust.notices] == [Code.NO_TWINS]
    assert all(np.isnan(r.p) for r in trust.rows)


def test_an_exact_prior_is_said(tmp_path):
    log = shortened(open_log("arena:3"), 30)
    exact = replace(log, recorded=replace(log.recorded, prior=Prior(log.truth.pose[0], np.zeros((3, 3)))))
    write_folder(exact, tmp_path / "exact")
    (trust,) = run(tmp_path / "exact", tmp_path, "--task", "localization").trust
    assert Code.EXACT_PRIOR in [n.code for n in trust.notices]

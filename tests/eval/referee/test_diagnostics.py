"""Notices of logs and runs: what stopped, where it began, two minima, names of landmarks, disputed pairings."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from pandas import DataFrame

from data.inputs import Inputs, Prior
from data.log import Log
from data.logs import open_log
from data.notice import Code, Severity, notice, stopped
from data.result import Failure, Innovations, Run
from data.words import sentence
from data.worlds.arena import Arena, simulate
from eval.figures.map import map_figure
from eval.referee import diagnostics
from eval.referee.lost import unused
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.report.publish import write_run
from eval.report.words import of_runs, together
from eval.report.writing import warnings_section
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error

LOG = circle_log()


def found(run):
    return diagnostics.notices([Trial(LOG, "slam", (run,))])


def test_runs_that_stopped_are_implausible_or_lost_say_why():
    run = run_with_error(np.zeros(3), failure=Failure("diverged", 3, stopped("not positive definite")))
    (why,) = [n for n in found(run) if n.severity is Severity.ERROR]
    assert (why.code, why.log, why.task, why.estimator) == (Code.STOPPED, LOG.name, "slam", "ekf")
    assert (why.frame, why.named) == (3, {"text": "not positive definite"})
    flaw = Failure("implausible", 2, notice(Code.NIS, per_dof=400.0, over_run=True))
    run = replace(run_with_error(np.zeros(3)), implausible=flaw)
    assert [n.code for n in found(run)][:2] == [Code.NIS, Code.ORIGIN]
    run = replace(run_with_error(4.0 * SIGMA), total_nis=(1010.0, 10))
    why = notice(Code.NIS, 0, per_dof=101.0, over_run=False).about(
        log=LOG.name, task="slam", estimator="ekf", association="known"
    )
    assert why in found(run)
    # not one that is where it claims to be
    assert why not in found(replace(run_with_error(np.zeros(3)), total_nis=(1010.0, 10)))


def test_the_table_has_values_as_json_and_the_sentence():
    (row,) = diagnostics.notices_table(
        [notice(Code.MATCHED, poses=7, matched=7, between=1, error=np.nan).about(log="home")]
    ).to_dict("records")
    assert json.loads(row["values"]) == {"between": 1, "error": None, "matched": 7, "poses": 7}
    assert (row["code"], row["severity"], row["log"]) == ("matched", "info", "home")
    assert row["text"].startswith("7 of 7 poses matched with the truth")
    assert diagnostics.notices_table([]).columns[0] == "code"


@pytest.mark.parametrize("frame", [2, 3])
def test_of_an_implausible_run_the_pairing_that_fits_worst_is_named(frame):
    nis, dof, white = np.full(FRAMES, np.nan), np.zeros(FRAMES, np.int64), np.zeros((4, 2))
    nis[1:4], dof[1:4] = 2.0, 2
    nis[frame], white[frame] = 900.0, [30.0, 0.0]  # there is one observation in each of the first four frames
    run = replace(
        run_with_error(np.zeros(3)),
        innovations=Innovations(nis, dof, np.full(FRAMES, np.nan), white),
        implausible=Failure("implausible", frame, stopped("why")),
    )
    said = diagnostics.origin(run, Trial(LOG, "slam", (run,)))
    assert (said.frame, said.named["observation"], said.named["began"]) == (frame, 0, False)
    # the map of the run is off by 0.1 m in x and y
    assert frame > 2 or (said.named["landmark"], said.named["off"]) == (0, pytest.approx(0.1414, abs=1e-3))
    assert sentence(said).startswith(f"in frame {frame} observation 0 fits worst: it was paired with landmark")
    assert diagnostics.origin(replace(run, implausible=None), Trial(LOG, "slam", (run,))) is None
    nothing = replace(run, implausible=Failure("implausible", 9, stopped("why")))
    assert diagnostics.origin(nothing, Trial(LOG, "slam", (nothing,))) is None


def ended(estimator, cost, error=0.0, dof=100):
    run = run_with_error(np.array([error, 0.0, 0.0]), estimator=estimator, phases=("final",))
    return replace(run, total_nis=(cost, dof))


def test_both_costs_the_better_one_and_the_distance_are_reported():
    found = diagnostics.two_minima(ended("batch", 1627.79, 0.64), ended("isam2", 1627.34))
    assert found.named == {
        "better": "isam2", "worse": "batch", "costs": (1627.34, 1627.79), "dof": 100, "apart": pytest.approx(0.64),
        "apart_most": pytest.approx(0.64),
    }  # fmt: skip
    assert "isam2 ends at a cost of 1627.340, batch at 1627.790 (100 degrees of freedom)" in sentence(found)


@pytest.mark.parametrize(("apart", "told"), [(0.0, False), (0.0105, False), (0.0125, True), (-0.0125, True)])
def test_a_difference_of_converged_optimizers_is_one_minimum(apart, told):
    assert (diagnostics.two_minima(ended("batch", 1000.0), ended("isam2", 1000.0 + apart)) is not None) == told


def test_other_decisions_are_another_problem_and_failures_solve_none():
    batch, other = ended("batch", 100.0), ended("isam2", 90.0)
    assert diagnostics.two_minima(batch, other)
    assert not diagnostics.two_minima(batch, replace(other, final_decisions=np.array([-1, 0, 0, -2])))
    assert not diagnostics.two_minima(batch, replace(other, total_nis=(90.0, 98)))
    assert not diagnostics.two_minima(batch, replace(other, total_nis=None))
    assert not diagnostics.two_minima(batch, replace(other, failure=Failure("diverged", 0, stopped(""))))


RUN = {"log": "circle", "task": "slam", "estimator": "ekf", "association": "known", "phase": "online"}


def said(fp, agree, plain=0.1, by_majority=0.1):
    metrics = RUN | {"rmse_landmark_m": plain, "rmse_landmark_majority_m": by_majority}
    decided = RUN | {"tp": 1000 - fp, "fp": fp, "majority_agreement": agree}
    scores = SimpleNamespace(metrics=pd.DataFrame([metrics]), association=pd.DataFrame([decided]))
    return diagnostics.naming(run_with_error(np.zeros(3)), scores, "circle")


def test_both_shares_and_both_landmark_errors_are_reported_where_they_differ():
    found = said(200, 0.999).named
    assert (found["false_share"], found["agree"], found["rmse"]) == (pytest.approx(0.2), 0.999, None)
    assert said(200, 0.98) is None
    assert said(50, 1.0) is None
    found = said(0, 1.0, 2.5, 0.12).named
    assert (found["false_share"], found["rmse"], found["rmse_majority"]) == (None, 2.5, 0.12)
    assert said(0, 1.0, 0.1, 0.102) is None
    assert said(0, 1.0, float("nan"), 0.1) is None


RNG = np.random.default_rng(0)
NOT_SCORED = score([])
PAIRED = RNG.integers(0, 20, 1000)


def test_numbers_of_landmarks_do_not_matter_pairings_do():
    assert diagnostics.differing(PAIRED, RNG.permutation(20)[PAIRED]) == 0.0
    other = PAIRED.copy()
    other[:100] = (other[:100] + 1) % 20
    assert diagnostics.differing(PAIRED, other) == pytest.approx(0.1)
    assert diagnostics.differing(PAIRED, PAIRED // 2) == pytest.approx(0.5, abs=0.05), "each is two in the other run"
    assert diagnostics.differing(PAIRED, PAIRED // 2) == diagnostics.differing(PAIRED // 2, PAIRED)
    assert diagnostics.differing(PAIRED, np.where(RNG.random(1000) < 0.5, -1, PAIRED)) == 0.0
    assert diagnostics.differing(PAIRED, np.full(1000, -1)) == 0.0


def made(association: str, paired: np.ndarray, estimator: str = "ekf") -> Run:
    run = run_with_error(np.zeros(3), association=association, estimator=estimator)
    return replace(run, decisions=paired, final_decisions=paired, created=np.full(len(paired), -1))


def test_a_pair_of_methods_is_told_once_and_labels_are_no_method():
    other = np.where(np.arange(1000) < 50, (PAIRED + 1) % 20, PAIRED)
    runs = [made(m, p, e) for e in ("ekf", "isam2") for m, p in (("known", other), ("jcbb", PAIRED), ("nn", other))]
    (found,) = diagnostics.disputed(Trial(circle_log(), "slam", tuple(runs)), NOT_SCORED)
    assert (found.code, found.estimator, found.named["methods"]) == (Code.DISPUTED, "ekf", ("jcbb", "nn"))
    assert found.named["share"] == pytest.approx(0.05)
    assert sentence(found).startswith("jcbb and nn pair 5.00 % of the observations with other landmarks")
    alike = [made("known", other), made("jcbb", PAIRED), made("nn", PAIRED)]
    assert diagnostics.disputed(Trial(circle_log(), "slam", tuple(alike)), NOT_SCORED) == []


def test_with_truth_the_one_with_more_wrong_pairings_is_named():
    runs = [made("jcbb", PAIRED), made("nn", np.where(np.arange(1000) < 50, (PAIRED + 1) % 20, PAIRED))]
    log = circle_log()
    row = {"log": log.name, "task": "slam", "estimator": "ekf", "phase": runs[0].phases[-1]}
    table = DataFrame([row | {"association": "jcbb", "fp": 3}, row | {"association": "nn", "fp": 53}])
    (found,) = diagnostics.disputed(Trial(log, "slam", tuple(runs)), replace(NOT_SCORED, association=table))
    assert found.named["fp"] == (3.0, 53.0)
    assert sentence(found).endswith("By the truth nn has more wrong pairings, 53 against 3")
    assert of_runs([found]) == [f"ekf: {sentence(found)}."]


@cache
def arena() -> Log:
    return simulate(Arena(frames=150, landmarks=24), 0)


def overconfident(inputs: Inputs) -> Inputs:
    o, steps = inputs.observations, inputs.increments
    return replace(
        inputs,
        map=None,
        observations=replace(o, R=o.R / 4.0),
        increments=replace(steps, covariance=steps.covariance / 4.0),
    )


def lost() -> Log:
    r = arena().recorded
    return replace(arena(), recorded=replace(r, prior=Prior(r.prior.mean + [300.0, 0.0, 0.0], r.prior.covariance)))


def test_a_map_with_several_landmarks_for_one_cone_is_asked_about():
    inputs = overconfident(arena().recorded)
    run = compare(inputs, "slam", ("ekf",), "jcbb")[0]
    question = diagnostics.crowded(run, inputs)
    cones = len(np.unique(arena().truth.landmark_of))
    assert len(run.map) > 2 * cones
    assert question.code is Code.LANDMARKS
    assert question.named["landmarks"] == len(run.map)
    (section,) = warnings_section([question])
    assert section.blocks[1].endswith("another --association.")


def test_a_run_that_used_nothing_says_so_in_the_headline():
    log = lost()
    runs = compare(log.recorded, "localization", ("dead-reckoning", "ekf", "batch"), "jcbb")
    trial = Trial(log, "localization", tuple(runs))
    seen = len(log.recorded.observations.z)
    assert unused(runs[0]) is None
    assert all(
        unused(run).named == {"used": 0, "readings": seen, "task": "localization", "moves": True} for run in runs[1:]
    )
    found = [n for n in together(diagnostics.notices([trial])) if n.severity is Severity.WARNING]
    assert [(n.code, n.estimator) for n in found if n.task] == [(Code.UNUSED, "ekf, batch")]
    assert Code.PRIOR in [n.code for n in found]
    (section,) = warnings_section(found)
    assert "**prior**" in section.blocks[1]
    assert "**unused**" in section.blocks[1]


PEOPLE = open_log("corridor:0:people")


@pytest.fixture(scope="module")
def trial():
    return Trial(PEOPLE, "slam", tuple(compare(PEOPLE.inputs(), "slam", ["ekf"], "jcbb")))


def legend(fig):
    return [text.get_text() for each in fig.legends for text in each.get_texts()]


def test_ambiguous_landmarks_are_reported_written_and_marked(trial, tmp_path):
    found = diagnostics.ambiguity_of(trial.runs[0], PEOPLE.recorded)
    assert (found.code, found.named) == (Code.AMBIGUOUS, {"ambiguous": 2, "landmarks": 109})
    assert "ambiguous landmarks" in legend(map_figure(PEOPLE, trial.runs))
    write_run(tmp_path, trial, trial.runs[0])
    (path,) = tmp_path.rglob("landmarks.csv")
    head, *rows = [line.split(",") for line in path.read_text().splitlines()]
    named = {row[0]: row[-2] for row in rows if row[-2]}
    assert head[-2:] == ["ambiguous", "until"]
    assert len(named) == 2
    assert all(named[other] == number for number, other in named.items())

"""Two methods without labels that pair otherwise are told, whatever numbers their landmarks have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pandas import DataFrame

from data.notice import Code
from data.result import Run
from data.words import sentence
from eval.referee.diagnostics import differing, disputed
from eval.referee.score import Trial, score
from eval.report.words import of_runs
from tests.eval.handmade import circle_log, run_with_error

RNG = np.random.default_rng(0)
NOT_SCORED = score([])
PAIRED = RNG.integers(0, 20, 1000)


def test_numbers_of_landmarks_do_not_matter_pairings_do():
    assert differing(PAIRED, RNG.permutation(20)[PAIRED]) == 0.0
    other = PAIRED.copy()
    other[:100] = (other[:100] + 1) % 20
    assert differing(PAIRED, other) == pytest.approx(0.1)
    assert differing(PAIRED, PAIRED // 2) == pytest.approx(0.5, abs=0.05), "each is two in the other run"
    assert differing(PAIRED, PAIRED // 2) == differing(PAIRED // 2, PAIRED)


def test_observations_that_one_run_left_out_are_no_difference():
    fewer = np.where(RNG.random(1000) < 0.5, -1, PAIRED)
    assert differing(PAIRED, fewer) == 0.0
    assert differing(PAIRED, np.full(1000, -1)) == 0.0


def made(association: str, paired: np.ndarray, estimator: str = "ekf") -> Run:
    run = run_with_error(np.zeros(3), association=association, estimator=estimator)
    return replace(run, decisions=paired, final_decisions=paired, created=np.full(len(paired), -1))


def test_a_pair_of_methods_is_told_once_and_labels_are_no_method():
    other = np.where(np.arange(1000) < 50, (PAIRED + 1) % 20, PAIRED)
    runs = [made(m, p, e) for e in ("ekf", "isam2") for m, p in (("known", other), ("jcbb", PAIRED), ("nn", other))]
    trial = Trial(circle_log(), "slam", tuple(runs))
    (found,) = disputed(trial, NOT_SCORED)
    assert (found.code, found.estimator, found.named["methods"]) == (Code.DISPUTED, "ekf", ("jcbb", "nn"))
    assert found.named["share"] == pytest.approx(0.05)
    assert sentence(found).startswith("jcbb and nn pair 5.00 % of the observations with other landmarks")
    alike = [made("known", other), made("jcbb", PAIRED), made("nn", PAIRED)]
    assert disputed(Trial(circle_log(), "slam", tuple(alike)), NOT_SCORED) == []


def test_with_truth_the_one_with_more_wrong_pairings_is_named():
    runs = [made("jcbb", PAIRED), made("nn", np.where(np.arange(1000) < 50, (PAIRED + 1) % 20, PAIRED))]
    log = circle_log()
    row = {"log": log.name, "task": "slam", "estimator": "ekf", "phase": runs[0].phases[-1]}
    table = DataFrame([row | {"association": "jcbb", "fp": 3}, row | {"association": "nn", "fp": 53}])
    (found,) = disputed(Trial(log, "slam", tuple(runs)), replace(NOT_SCORED, association=table))
    assert found.named["fp"] == (3.0, 53.0)
    assert sentence(found).endswith("By the truth nn has more wrong pairings, 53 against 3")
    assert of_runs([found]) == [f"ekf: {sentence(found)}."]

"""Two minima of one problem differ from rounding, and from different problems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.notice import stopped
from data.result import Failure
from data.words import sentence
from eval.referee.diagnostics import two_minima
from tests.eval.handmade import run_with_error


def ended(estimator, cost, error=0.0, dof=100):
    run = run_with_error(np.array([error, 0.0, 0.0]), estimator=estimator, phases=("final",))
    return replace(run, total_nis=(cost, dof))


def test_both_costs_the_better_one_and_the_distance_are_reported():
    found = two_minima(ended("batch", 1627.79, 0.64), ended("isam2", 1627.34))
    assert found.named == {
        "better": "isam2",
        "worse": "batch",
        "costs": (1627.34, 1627.79),
        "dof": 100,
        "apart": pytest.approx(0.64),
        "apart_most": pytest.approx(0.64),
    }
    assert "isam2 ends at a cost of 1627.340, batch at 1627.790 (100 degrees of freedom)" in sentence(found)


@pytest.mark.parametrize(("apart", "told"), [(0.0, False), (0.0105, False), (0.0125, True), (-0.0125, True)])
def test_a_difference_of_converged_optimizers_is_one_minimum(apart, told):
    assert (two_minima(ended("batch", 1000.0), ended("isam2", 1000.0 + apart)) is not None) == told


def test_other_decisions_are_another_problem_and_failures_solve_none():
    batch, other = ended("batch", 100.0), ended("isam2", 90.0)
    assert two_minima(batch, other)
    assert not two_minima(batch, replace(other, final_decisions=np.array([-1, 0, 0, -2])))
    assert not two_minima(batch, replace(other, total_nis=(90.0, 98)))
    assert not two_minima(batch, replace(other, total_nis=None))
    assert not two_minima(batch, replace(other, failure=Failure("diverged", 0, stopped(""))))

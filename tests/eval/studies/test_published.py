"""Published numbers: averages by the definition of their source, standard errors, and the rows that are written."""

import math
from dataclasses import replace

import numpy as np
import pytest

from eval.referee.result_files import PUBLISHED
from eval.studies.montecarlo import (
    Estimate,
    Sample,
    difference,
    lines,
    mean_of,
    ours_of,
    published_rows,
    rms_of,
    study_of,
)
from eval.studies.scenario import Published, Row, load_scenario


def test_the_average_of_a_nees_follows_the_definition_of_its_source():
    nees = np.array([np.nan, 50.0, 4.0, 6.0, 8.0])
    assert Published().average(nees[2:], 2, 0) == 6.0
    assert Published(per_dof=True).average(nees, 2, 2) == 3.0
    assert Published(per_dof=True, skipped_are_zero=True).average(nees, 2, 2) == pytest.approx(9.0 / 5.0)
    assert math.isnan(Published().average(nees, 2, 0))


def test_standard_errors_are_those_of_many_repetitions():
    squares = np.random.default_rng(0).gamma(2.0, 3.0, (4000, 60))
    means, roots = [mean_of(x) for x in squares], [rms_of(x, 2.0) for x in squares]
    assert np.mean([m.se for m in means]) == pytest.approx(np.std([m.value for m in means]), rel=0.03)
    assert np.mean([r.se for r in roots]) == pytest.approx(np.std([r.value for r in roots]), rel=0.03)
    assert roots[0].value == pytest.approx(2.0 * np.sqrt(squares[0].mean()))


def test_a_difference_counts_both_standard_errors():
    assert difference(Estimate(3.0, 0.3, 9), 2.0, 0.4) == pytest.approx(2.0)
    assert math.isnan(difference(Estimate(3.0, 0.0, 9), 2.0, 0.0))


@pytest.fixture
def study():
    rows = Row("ekf", "nees_pose", 2.0, 0.5), Row("ekf", "rmse_position_m", 0.5, 0.0), Row("ekf-fej", "nees_pose", 3, 1)
    scenario = replace(load_scenario("small-circle"), published=Published(rows=rows))

    def run(k):
        def made(scale):
            return Sample({}, {}, {"position": 0.25 * scale}, {"pose": scale * (3.0 + k)}, np.ones(3))

        return {
            ("slam", "ekf", "known", "online"): made(2.0),
            ("slam", "ekf-invariant", "known", "online"): made(1.0) if k else Sample(failure="frame 3: lost"),
        }

    return study_of(scenario, range(3), [run(k) for k in range(3)])


def test_rows_hold_ours_beside_theirs_for_estimators_that_ran(study):
    rows = published_rows(study)
    assert [(r["estimator"], r["quantity"]) for r in rows] == [("ekf", "nees_pose"), ("ekf", "rmse_position_m")]
    assert rows[0]["ours"] == pytest.approx(8.0)
    assert rows[0]["se_ours"] == pytest.approx(2.0 / math.sqrt(3))
    assert rows[0]["difference_in_se"] == pytest.approx(6.0 / math.hypot(2.0 / math.sqrt(3), 0.5))
    assert rows[1]["ours"] == pytest.approx(math.sqrt(0.5))
    assert list(PUBLISHED.table(rows).columns)[:4] == ["scenario", "estimator", "quantity", "ours"]
    assert lines(rows)[1].split() == ["small-circle", "ekf", "nees_pose", "8", "±", "1.2", "2", "±", "0.5", "+4.77"]
    assert lines([]) == []


def test_runs_that_diverged_are_in_no_average(study):
    assert ours_of(study, "ekf-invariant", "nees_pose").value == pytest.approx(4.5)

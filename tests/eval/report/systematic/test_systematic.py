"""Systematic errors in the report: what a table, a figure and the sentences say of handmade estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Systematic
from data.result import Systematics
from data.worlds.registry import named_log
from eval.figures.claims import systematic_figure
from eval.plan.calibrate import ALL, NAMED, Calibration, with_systematic
from eval.referee.attribution import NOISE
from eval.referee.score import Trial
from eval.replay.run import compare
from eval.report.diagnosis import best, determined, errors_table, estimated
from eval.report.words import plus_minus, say
from tests.eval.report.diagnosis.said_by_hand import TURN, blamed, said

ERRORS = Systematic(("scale", "curvature"), np.array([0.1, 0.05]))


def estimate(frames, mean, sigma):
    rise = np.linspace(0.0, 1.0, frames)[:, None]
    start = ERRORS.sigma
    return Systematics(ERRORS.names, rise * np.array(mean), start + rise * (np.array(sigma) - start))


@pytest.fixture(scope="module")
def trial():
    log = with_systematic(named_log("arena:1:frames=30+scale=-0.08"), ERRORS)
    plain = with_systematic(log, None).inputs(labels=True)
    ekf, batch = compare(plain, "localization", ("ekf", "batch"))
    last = Systematics(ERRORS.names, np.tile([-0.081, 0.002], (30, 1)), np.tile([0.004, 0.049], (30, 1)))
    runs = (replace(ekf, errors_online=estimate(30, [-0.079, 0.001], [0.005, 0.05])), replace(batch, errors_final=last))
    return Trial(log, "localization", runs)


def test_the_table_shows_prior_estimates_truth_and_what_the_log_cannot_tell(trial):
    table = errors_table(ERRORS, trial.runs, trial.log.truth)
    assert table.to_dict("list") == {
        "error": ["scale", "curvature"],
        "unit": ["", "rad/m"],
        "known before": ["0 ± 0.10", "0 ± 0.050"],
        "ekf (online)": ["−0.0790 ± 0.0050", "0.001 ± 0.050"],
        "batch (final)": ["−0.0810 ± 0.0040", "0.002 ± 0.049"],
        "true": ["−0.0800", "0"],
        "told": ["yes", "the log cannot tell it"],
    }


def test_batch_has_the_last_word(trial):
    assert best(trial.runs) is trial.runs[1].errors_final
    assert best(trial.runs[:1]) is trial.runs[0].errors_online
    assert best([replace(trial.runs[0], errors_online=None)]) is None


def test_an_error_is_told_if_a_tenth_of_its_sigma_is_gone():
    sigma = np.tile([0.091, 0.044], (5, 1))
    assert determined(ERRORS, Systematics(ERRORS.names, 0.0 * sigma, sigma)) == (False, True)


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [(-0.1053, 0.0045, "−0.1053 ± 0.0045"), (12.0, 3.4, "12.0 ± 3.4"), (0.5, 0.0, "0.500"), (3.0, 25.0, "3 ± 25")],
)
def test_estimates_have_the_decimals_of_their_sigma(value, sigma, text):
    assert plus_minus(value, sigma) == text


def test_facts_say_why_these_which_are_not_told_and_what_the_battery_says(trial):
    named = Calibration(
        trial.log.name, trial.task, "known", ERRORS, NAMED, before=blamed(TURN, cause=NOISE, objected=2)
    )
    facts = estimated(trial, named, trial.runs)
    assert [facts[of] for of in ("names", "why", "judged", "untold")] == [ERRORS.names, NAMED, True, ("curvature",)]
    assert facts["before"].judged["objected"] == 2
    assert facts["after"] is None
    text = say("systematic", **facts)
    assert text.startswith(
        "* Estimated by filter and smoother jointly with the poses: `scale`, `curvature`. A score test"
    )
    assert (
        "outside the range of 20 bootstrap replicates (family-wise p at most 0.05): odometry turns 5.00 % ± 0.10 % less"
    ) in text
    assert text.endswith("(with these errors estimated): not enough memory.")


def test_without_a_run_nothing_is_said_of_the_errors(trial):
    facts = estimated(trial, Calibration("", "", "known", ERRORS, ALL, after=said()), [])
    assert (facts["judged"], facts["untold"]) == (False, ())
    text = say("systematic", **facts)
    assert "No run reached its end" in text
    assert text.endswith("too few bootstrap replicates.")


def test_the_figure_has_a_panel_for_each_error_with_truth_prior_and_estimates(trial):
    fig = systematic_figure(trial.log, ERRORS, trial.runs)
    scale, curvature = (ax for ax in fig.axes if ax.get_visible())
    assert (scale.get_ylabel(), curvature.get_ylabel()) == ("scale", "curvature [rad/m]")
    ends = [line.get_ydata()[-1] for line in scale.lines]
    assert {-0.079, -0.081, -0.08} <= {round(float(y), 3) for y in ends}
    low, high = scale.get_ylim()
    assert low < -0.08 - 0.015 < 0.0 < high
    labels = [t.get_text() for t in fig.legends[0].get_texts()]
    assert labels == ["EKF (online)", "batch (final)", "true error", "known before (±3σ)"]

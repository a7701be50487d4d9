"""Statements say what the numbers allow and nothing more."""

from __future__ import annotations

import math

import pytest

from eval.report.answer import association_statement, inside_statement, nees_statement, nis_statement, verdict_statement
from eval.report.page.tables import number


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.09912, "0.0991"),
        (3.0, "3.00"),
        (12.345, "12.3"),
        (1234.5, "1234"),
        (2e7, "2.00e+07"),
        (0.0, "0"),
        (-0.5, "-0.500"),
    ],
)
def test_numbers_have_three_significant_digits(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("nis", "says", "never"),
    [
        (
            1.9,
            "larger than claimed (NIS per dof 1.90, expected 1, 95 % bounds 0.97–1.03): overconfident",
            "conservative",
        ),
        (
            0.1,
            "smaller than claimed (NIS per dof 0.100, expected 1, 95 % bounds 0.97–1.03): conservative",
            "overconfident",
        ),
        (1.0, "as large as claimed (NIS per dof 1.00, expected 1, 95 % bounds 0.97–1.03): nothing against", "proves"),
    ],
)
def test_nis_is_judged_by_its_bounds(nis, says, never):
    text = nis_statement(nis, 0.97, 1.03)
    assert says in text
    assert never not in text


def test_behind_a_gate_less_is_expected():
    text = nis_statement(0.95, 0.91, 0.99, expected=0.9535)
    assert "as large as claimed (NIS per dof 0.950, expected 0.954 behind the gates, 95 % bounds 0.91–0.99)" in text


def test_whatever_weakens_the_nis_test_is_said():
    text = nis_statement(1.0, 0.97, 1.03, rejected=28, known=False)
    assert "28 observations were left out" in text
    assert "conditional on the association decisions" in text
    assert nis_statement(math.nan, 0.97, 1.03) == ""


@pytest.mark.parametrize(
    ("nees", "says"),
    [(12.0, "about 2.0 times as large"), (0.75, "about 0.50 of what"), (3.3, "(dof 3, so 3 is expected); a")],
)
def test_nees_of_one_run_is_described_and_never_judged(nees, says):
    text = nees_statement(nees)
    assert says in text
    assert "without verdict" in text
    assert not any(word in text for word in ("consistent", "confident", "conservative"))


def test_a_monte_carlo_verdict_carries_interval_runs_and_power():
    text = verdict_statement(3.05, 2.93, 3.17, 3, 50, "consistent", 0.993)
    assert text.startswith("consistent: mean 3.05 where 3 is expected, 95 % interval 2.93–3.17, 50 runs")
    assert "noticed with probability 0.99" in text
    few = verdict_statement(3.05, 2.0, 4.0, 3, 8, "not enough runs", 0.1)
    assert "too few runs to tell" in few
    assert verdict_statement(math.nan, math.nan, math.nan, 3, 1, "not enough runs") == "not enough runs (1 run, dof 3)"


def test_the_three_sigma_share_is_compared_with_the_plane_not_the_line():
    assert inside_statement(0.9512) == "95.1 % of positions inside their 3σ ellipse (a Gaussian in the plane: 98.9 %)"


def test_association_counts_become_shares():
    text = association_statement(880, 10, 4, 6)
    assert text.startswith("of 900 observations 890 were decided rightly (98.9 %), 4 were paired with a wrong landmark")
    assert association_statement(0, 0, 0, 0) == "no observations to decide about"

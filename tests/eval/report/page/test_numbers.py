"""Numbers with three digits that matter."""

from __future__ import annotations

import pytest

from eval.report.page.tables import number


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (99.96, "100"),
        (99.94, "99.9"),
        (9.996, "10.0"),
        (-0.09996, "-0.100"),
        (0.0, "0"),
        (1234.5, "1234"),
        (2e6, "2.00e+06"),
    ],
)
def test_a_number_has_three_digits_also_where_rounding_makes_it_longer(value, text):
    assert number(value) == text

"""Lengths, sizes of type and columns for a paper: what is understood, and what is refused with what would be."""

from __future__ import annotations

import math

import pytest

from data.errors import UsageError
from eval.plan.flags.table import LARGEST, SMALLEST, TYPE, inches, points, width
from eval.replay.flag import names


@pytest.mark.parametrize(
    ("length", "value"),
    [("3.4in", 3.4), ("8.636 cm", 3.4), ("86.36mm", 3.4), ("252pt", 252 / 72.27), (" 2 in ", 2.0)],
)
def test_a_length_is_read_in_inches_centimetres_millimetres_or_points(length, value):
    assert inches(length) == pytest.approx(value, rel=1e-3)


@pytest.mark.parametrize("length", ["3.4", "in", "3.4 feet", "1.2.3in", "-3in", ""])
def test_what_is_no_length_is_refused_with_examples(length):
    assert math.isnan(inches(length))
    with pytest.raises(UsageError, match=r"3\.4in, 8\.6cm"):
        width("--figure-width", length)


def test_a_width_is_between_the_smallest_and_the_largest():
    assert width("--w", "3.4 in") == "3.4in"
    for edge in (SMALLEST, LARGEST):
        assert width("--w", f"{edge}in") == f"{edge}in"
    for beyond in (0.99 * SMALLEST, 1.01 * LARGEST):
        with pytest.raises(UsageError, match=f"between {SMALLEST:g}in and {LARGEST:g}in"):
            width("--w", f"{beyond}in")


def test_a_size_of_type_is_between_the_smallest_and_the_largest_that_can_be_read():
    assert [points("--f", t) for t in TYPE] == list(TYPE)
    for beyond in (0.99 * TYPE[0], 1.01 * TYPE[1], 0.0, -8.0):
        with pytest.raises(UsageError, match="--f"):
            points("--f", beyond)
    with pytest.raises(UsageError, match=f"between {TYPE[0]:g} and {TYPE[1]:g} points"):
        points("--f", 2.0 * TYPE[1])


def test_columns_are_named_once_each():
    columns = names()
    assert columns("--columns", "a, b,,c") == ("a", "b", "c")
    with pytest.raises(UsageError, match="named twice"):
        columns("--columns", "a,b,a")

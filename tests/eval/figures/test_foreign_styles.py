"""Names that are not ours look like themselves everywhere, and like nobody else."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from eval.figures.style import OTHERS, STYLES, style_of
from eval.replay.external.spec import introduce, place
from tests.eval.figures.looks import SEEN_BY, lab

NAMES = [f"filter-{i}" for i in range(12)]


@pytest.fixture(autouse=True)
def nobody():
    yield
    introduce(())


def test_introduced_names_all_look_different_in_colour_or_line_whatever_their_order():
    introduce(NAMES)
    styles = [style_of(name) for name in NAMES]
    assert len({(s.colour, s.line) for s in styles}) == len(NAMES)
    introduce(reversed(NAMES))
    assert [style_of(name) for name in NAMES] == styles


def test_two_names_of_one_place_move_apart():
    a, b = next((a, b) for a, b in combinations(NAMES, 2) if place(a, 5) == place(b, 5))
    introduce([a, b])
    assert place(a, 5) != place(b, 5)


@pytest.mark.parametrize("seen", SEEN_BY.values(), ids=SEEN_BY.keys())
def test_their_colours_stay_apart_from_each_other_and_from_the_default_report_for_colour_blind_readers(seen):
    theirs = [colour for colour, _ in OTHERS]
    ours = [STYLES[n].colour for n in ("dead-reckoning", "ekf", "isam2", "batch")]
    pairs = [*combinations(theirs, 2), *((a, b) for a in theirs for b in ours)]
    for a, b in pairs:
        assert np.linalg.norm(lab(a, seen) - lab(b, seen)) > 15.0, (a, b)

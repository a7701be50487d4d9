"""Every estimator and every way of association that can be asked for has a colour of its own, from one place."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_hex

from eval.figures.growth import state_figure
from eval.figures.style import STYLES, colour_of_method, style_of
from eval.referee.score import Trial
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS
from tests.eval.figures.looks import SEEN_BY, lab
from tests.eval.handmade import FRAMES, circle_log, run_with_error

UNPLANNED = "nobody-planned-for-this"


def test_every_estimator_has_a_style_of_its_own():
    assert set(ESTIMATORS) == set(STYLES)
    assert len({style_of(name).colour for name in ESTIMATORS}) == len(ESTIMATORS)


def test_every_way_of_association_has_a_colour_of_its_own():
    colours = [colour_of_method(name) for name in (*ASSOCIATIONS, UNPLANNED)]
    assert len(set(colours)) == len(ASSOCIATIONS) + 1


@pytest.mark.parametrize("seen", SEEN_BY.values(), ids=SEEN_BY.keys())
def test_ways_of_association_stay_apart_for_colour_blind_readers(seen):
    for a, b in combinations(ASSOCIATIONS, 2):
        assert np.linalg.norm(lab(colour_of_method(a), seen) - lab(colour_of_method(b), seen)) > 12.0, (a, b)


def test_the_figure_of_the_state_draws_every_method_in_its_colour():
    size = np.arange(3, 3 + FRAMES)
    runs = tuple(replace(run_with_error(np.zeros(3), association=a), state_size=size) for a in ASSOCIATIONS)
    lines = state_figure(Trial(circle_log(), "slam", runs)).axes[0].get_lines()
    assert [to_hex(line.get_color()).upper() for line in lines] == [colour_of_method(a) for a in ASSOCIATIONS]
    assert len({line.get_color() for line in lines}) == len(ASSOCIATIONS)

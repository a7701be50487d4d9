"""Pictures of a laser log: what is drawn where, every loop closure's fate, and the same bytes each time."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from eval.figures.style import style_of
from tests.eval.figures.looks import SEEN_BY, lab, within
from wings.laser.report import LOOP_STATES, loop_picture, loop_states, map_picture
from wings.laser.scans.constraints import Loops
from wings.laser.scans.occupancy import Grid

KEYS = np.array([[0.0, 0, 0], [4, 0, 0.5], [4, 3, 2], [0, 3, 3], [0, 0.5, -1]])
WEIGHT = np.array([1.0, 0.0, 0.9, 0.5])
FALSE = np.array([False, False, True, False])


@pytest.fixture
def loops():
    n = len(WEIGHT)
    believed = np.array([4, 4, 4, -1])
    return Loops(
        np.array([0, 0, 1, 1]), np.array([4, 3, 4, 3]), np.zeros((n, 3)), np.zeros((n, 3, 3)), np.ones(n), believed
    )


@pytest.fixture
def grid():
    log_odds = np.zeros((80, 120))
    log_odds[10:60, 10:100] = -2.0
    log_odds[10, 10:100] = 3.5
    return Grid(np.array([-1.0, -2.0]), 0.05, log_odds)


def test_every_loop_closure_has_its_fate(loops):
    with_truth = ["believed and kept", "believed, later switched off", "kept, though false", "not believed"]
    assert loop_states(loops, WEIGHT, FALSE).tolist() == with_truth
    assert loop_states(loops, WEIGHT).tolist() == [*with_truth[:2], "believed and kept", "not believed"]


def test_a_line_joins_the_two_keys_of_each_loop_and_the_legend_counts_them(loops):
    fig = loop_picture(KEYS, loops, WEIGHT, name="here", false=FALSE)
    drawn = [c for c in fig.axes[0].collections if isinstance(c, LineCollection)]
    assert [to_hex(c.get_colors()[0]).upper() for c in drawn] == [colour for colour, _, _ in LOOP_STATES.values()]
    ends = {tuple(map(tuple, s.tolist())) for c in drawn for s in c.get_segments()}
    assert ends == {(tuple(KEYS[i, :2]), tuple(KEYS[j, :2])) for i, j in ((0, 4), (0, 3), (1, 4), (1, 3))}
    assert [f"{what}: 1" for what in LOOP_STATES] == [t.get_text() for t in fig.legends[0].get_texts()][-4:]
    without = [t.get_text() for t in loop_picture(KEYS, loops, WEIGHT, name="here").legends[0].get_texts()]
    assert not any("false" in t for t in without)


@pytest.mark.parametrize("seen", SEEN_BY.values(), ids=SEEN_BY.keys())
def test_fates_stay_apart_for_colour_blind_readers(seen):
    for (a, *_), (b, *_) in combinations(LOOP_STATES.values(), 2):
        assert np.linalg.norm(lab(a, seen) - lab(b, seen)) > 12.0, (a, b)


def test_the_grid_lies_where_it_is_in_the_world_dark_where_occupied(grid):
    fig = map_picture(grid, KEYS, name="here")
    ax = fig.axes[0]
    image = ax.images[0]
    np.testing.assert_allclose(image.get_extent(), [-1.0, 5.0, -2.0, 2.0])
    assert image.origin == "lower"
    shade = image.get_array()
    assert shade[10, 50] < 0.1 < 0.8 < shade[0, 0] < 0.9 < 0.95 < shade[30, 50]
    assert ax.get_aspect() == 1.0
    path = ax.get_lines()[0]
    np.testing.assert_array_equal(path.get_xydata(), KEYS[:, :2])
    assert path.get_color() == style_of("isam2").colour
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "y [m]")
    assert within(fig.legends[0].get_window_extent(), fig.bbox)


def test_a_stray_beam_does_not_squash_the_map(grid):
    far = np.pad(grid.log_odds, ((0, 0), (0, 2000)))
    far[30, 2100:] = -0.41  # 1 m of it, 100 m away
    near, wide = (map_picture(Grid(grid.origin, 0.05, g), KEYS, name="x").axes[0] for g in (grid.log_odds, far))
    np.testing.assert_allclose(wide.get_xlim(), near.get_xlim(), atol=0.2)

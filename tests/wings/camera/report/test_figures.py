"""Figures of a log made from images: pictures on the plan, and sheets of frames with what was found."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from data.pictures import Detection
from tests.eval.handmade import circle_log, run_with_error
from tests.wings.camera.report.handmade import CORNERS, GREY, SQUARE
from wings.camera.figures import MOST_TILES, OUTLINE, Tile, contact_sheet, plan_figure


def found_at(picture: int, offset: tuple[float, float] = (0.0, 0.0)) -> Detection:
    return Detection(picture, SQUARE + offset, np.zeros((4, 3)), 40)


def test_the_plan_shows_each_picture_on_its_wall_with_its_number_behind_it():
    log = circle_log(known_map=True)
    fig = plan_figure(log, [run_with_error(np.zeros(3), task="localization", mapped=False)], CORNERS)
    fig.draw_without_rendering()
    ax = fig.axes[0]
    walls = [line.get_xydata() for line in ax.lines if line.get_linewidth() > 3]
    assert np.array(walls) == pytest.approx(CORNERS[:, :2])
    numbers = {t.get_text(): t for t in ax.texts}
    assert sorted(numbers) == ["0", "1", "2"]
    for i, middle in enumerate(CORNERS[:, :2].mean(axis=1)):
        box = numbers[str(i)].get_window_extent()
        at = ax.transData.inverted().transform(0.5 * (box.min + box.max))
        # all hang facing the middle of the room
        assert np.linalg.norm(at) > np.linalg.norm(middle) + 0.1
        assert np.linalg.norm(at - middle) < 0.6
    assert not any(line.get_marker() == "+" for line in ax.lines)
    labels = [t.get_text() for t in fig.legends[0].get_texts()]
    assert "pictures (number behind)" in labels
    assert ax.get_aspect() == 1.0


def test_a_sheet_outlines_what_was_found_and_numbers_it_at_the_upper_left_corner():
    fig = contact_sheet([Tile("frame 7", GREY, [found_at(3), found_at(5, (50.0, -18.0))], ["in view: 4"])], "Sheet")
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    ax = fig.axes[0]
    outlines = [line.get_xydata() for line in ax.lines if len(line.get_xydata()) == 5]
    assert np.array(outlines)[:, :4] == pytest.approx(np.array([SQUARE, SQUARE + (50.0, -18.0)]))
    picture = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
    u, v = ax.transData.transform([25.0, 20.0])
    assert v > ax.transData.transform([25.0, 50.0])[1]  # upright
    spot = picture[round(picture.shape[0] - v) - 2 : round(picture.shape[0] - v) + 3, round(u)]
    wanted = [int(OUTLINE[i : i + 2], 16) for i in (1, 3, 5)]
    assert np.abs(spot - wanted).sum(axis=1).min() < 60
    tags = {t.get_text(): t.get_window_extent() for t in ax.texts}
    assert sorted(tags) == ["3", "5"]
    for number, corner in (("3", SQUARE[0]), ("5", SQUARE[0] + (50.0, -18.0))):
        box, at = tags[number], ax.transData.transform(corner)
        assert np.hypot(*(at - np.clip(at, box.min, box.max))) < 8
        # also where the picture hangs at the image's upper edge
        assert box.y1 <= ax.bbox.y1 + 1


@pytest.mark.parametrize("count", [0, MOST_TILES + 1])
def test_a_sheet_of_too_few_or_too_many_frames_is_refused(count):
    with pytest.raises(ValueError, match=f"{count} frames"):
        contact_sheet([Tile("a", GREY, [], [])] * count, "Sheet")


def test_what_lies_on_a_frame_is_small_and_what_hangs_on_a_wall_is_thick_with_its_number_above_it():
    fig = contact_sheet([Tile("frame 7", GREY, [found_at(3)], [])], "Sheet")
    outline, corners = fig.axes[0].lines
    assert 0.8 <= outline.get_linewidth() <= 1.5
    assert 2.0 <= corners.get_markersize() <= 4.0
    assert corners.get_markeredgewidth() < outline.get_linewidth()
    assert all(6.0 <= t.get_fontsize() <= 8.0 for t in [*fig.texts, *fig.axes[0].texts])
    assert fig.axes[0].get_xlim() == (-0.5, 119.5)
    assert fig.axes[0].get_ylim() == (89.5, -0.5)
    plan = plan_figure(circle_log(known_map=True), [run_with_error(np.zeros(3), mapped=False)], CORNERS)
    ax = plan.axes[0]
    walls = [line for line in ax.lines if line.get_linewidth() > 3]
    assert all(w.get_linewidth() < 4.0 and w.get_color() == "black" for w in walls)
    paths = [line for line in ax.lines if line not in walls and line.get_label() != "start"]
    assert max(p.get_zorder() for p in paths) < walls[0].get_zorder() < ax.texts[0].get_zorder()
    assert all(6.0 <= t.get_fontsize() <= 7.0 for t in ax.texts)

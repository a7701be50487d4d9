"""A walk with windows open: every picture in its window, and not one warning from the layout."""

from __future__ import annotations

import pytest
from matplotlib import pyplot

from data.log import shortened
from data.logs import open_log
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from wings.labs.stepping.pictures import ImageWriter, picture_axes
from wings.labs.stepping.stepper import Walk


class Windows:
    """pyplot as `Album` uses it, where nobody sees the windows; `draw_idle` draws at once."""

    figure = staticmethod(pyplot.figure)

    @staticmethod
    def pause(_: float) -> None:
        """Nobody looks; `draw_idle` has drawn the window."""


def test_apicture_axes_that_is_saved_and_drawn_again_needs_no_layout(tmp_path):
    """Warnings are errors here; seen: layoutgrids, of a figure whose axes stand where they were put."""
    images = ImageWriter(tmp_path, Windows)
    try:
        for step in ("1", "2"):
            images.show("picture", lambda fig: picture_axes(fig).plot([0.0, 1.0]), step)
            pyplot.figure("picture").canvas.draw()
    finally:
        pyplot.close("all")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["1.png", "2.png"]


@pytest.mark.slow
def test_windows_are_drawn_again_and_again_without_a_warning(tmp_path):
    log = shortened(open_log("corridor:0:people"), 2)
    walk = Walk(log, "slam", "ekf", ImageWriter(tmp_path, Windows), pausing=False)
    try:
        step_by_step("ekf", log.inputs().without_map(), "slam", "jcbb", Setup(), observer=walk)
        assert len(pyplot.get_fignums()) > 2
    finally:
        pyplot.close("all")

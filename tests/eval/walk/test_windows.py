"""A walk with windows open: every picture in its window, and not one warning from the layout."""

from __future__ import annotations

from matplotlib import pyplot

from data.log import shortened
from data.logs import open_log
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from eval.walk.album import Album
from eval.walk.walk import Walk


class Windows:
    """pyplot as `Album` uses it, where nobody sees the windows; `draw_idle` draws at once."""

    figure = staticmethod(pyplot.figure)

    @staticmethod
    def pause(_: float) -> None:
        """Nobody looks; `draw_idle` has drawn the window."""


def test_windows_are_drawn_again_and_again_without_a_warning(tmp_path):
    """Warnings are errors here; seen: layoutgrids, of a figure whose axes stand where they were put."""
    log = shortened(open_log("corridor:0:people"), 2)
    walk = Walk(log, "slam", "ekf", Album(tmp_path, Windows), pausing=False)
    try:
        step_by_step("ekf", log.inputs().without_map(), "slam", "jcbb", Setup(), observer=walk)
        assert len(pyplot.get_fignums()) > 2
    finally:
        pyplot.close("all")

"""Every figure a report can use, in one place: functions that take data and return a `Figure`; none is shown."""

from __future__ import annotations

from eval.figures.association import confusion_figure
from eval.figures.claims import claims_figure, filter_smoother_figure, systematic_figure
from eval.figures.consistency import anees_figure, nees_figure
from eval.figures.error import difference_figure, error_figure
from eval.figures.growth import growth_figure, state_figure
from eval.figures.laser import loop_picture, map_picture
from eval.figures.log import loop_state_figure
from eval.figures.map import map_figure
from eval.figures.studies import Seen, coverage_figure, outlier_figure, power_figure, run_end_figure

__all__ = [
    "Seen",
    "anees_figure",
    "claims_figure",
    "confusion_figure",
    "coverage_figure",
    "difference_figure",
    "error_figure",
    "filter_smoother_figure",
    "growth_figure",
    "loop_picture",
    "loop_state_figure",
    "map_figure",
    "map_picture",
    "nees_figure",
    "outlier_figure",
    "power_figure",
    "run_end_figure",
    "state_figure",
    "systematic_figure",
]  # fmt: skip

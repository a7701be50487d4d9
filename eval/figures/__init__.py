"""Every figure a report can use, in one place: functions that take data and return a `Figure`; none is shown.

A module is loaded when a figure of it is asked for, so that a run without figures does not wait for matplotlib.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
]
_NAMES = {
    "association": ("confusion_figure",),
    "claims": ("claims_figure", "filter_smoother_figure", "systematic_figure"),
    "consistency": ("anees_figure", "nees_figure"),
    "error": ("difference_figure", "error_figure"),
    "growth": ("growth_figure", "state_figure"),
    "laser": ("loop_picture", "map_picture"),
    "log": ("loop_state_figure",),
    "map": ("map_figure",),
    "studies": ("Seen", "coverage_figure", "outlier_figure", "power_figure", "run_end_figure"),
}
HOMES = {name: f"eval.figures.{module}" for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A figure, loaded now. Raises AttributeError for what is none."""
    if name in HOMES:
        return getattr(import_module(HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

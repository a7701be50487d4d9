"""Drives estimators over a log; sees the inputs only, never the truth.

`compare` runs several of them on one log, `make_estimator` makes one to be stepped by hand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eval.replay.estimators import make_estimator
    from eval.replay.run import compare

__all__ = ["compare", "make_estimator"]


def __getattr__(name: str) -> Any:
    """Loaded when asked for: `eval.replay.settings` and `eval.replay.settings` must stay light, for `--help`."""
    if name == "compare":
        from eval.replay.run import compare

        return compare
    if name == "make_estimator":
        from eval.replay.estimators import make_estimator

        return make_estimator
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

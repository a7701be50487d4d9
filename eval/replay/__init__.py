"""Runs estimators over a log; sees the inputs only, never the truth.

`compare` runs several estimators on one log, `make_estimator` makes one to be stepped by hand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eval.replay.estimators import make_estimator
    from eval.replay.run import compare

__all__ = ["compare", "make_estimator"]


def __getattr__(name: str) -> Any:
    """Load lazily: `--help` needs `eval.replay.settings` without the estimators."""
    if name == "compare":
        from eval.replay.run import compare

        return compare
    if name == "make_estimator":
        from eval.replay.estimators import make_estimator

        return make_estimator
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

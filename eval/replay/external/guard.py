"""Calls foreign code: whatever it raises becomes one error with its traceback."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from association.expectation import SingularInnovationError
from ekf.filter import FilterDivergedError
from eval.replay.external.load import at_line, in_one_line
from graph.factors import UnderConstrained

PASSED = (FilterDivergedError, UnderConstrained, SingularInnovationError, MemoryError)
"""Errors of our own code, caught elsewhere."""


class ForeignError(Exception):
    """Foreign code crashed, or returned an unusable value."""

    def __init__(self, why: str, trace: str = "") -> None:
        super().__init__(why)
        self.trace = trace  # its traceback, empty where it did not crash


def call(who: str, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """The result of a foreign function; `who` names it in the error."""
    try:
        return function(*arguments, **named)
    except PASSED:
        raise
    except (Exception, SystemExit) as fault:
        below = fault.__traceback__.tb_next if fault.__traceback__ is not None else None
        trace = "".join(traceback.format_exception(type(fault), fault, below))
        raise ForeignError(f"{who} raised {in_one_line(fault)}{at_line(fault)}", trace) from fault


def array(who: str, value: Any, shape: tuple[int, ...], meant: str, *, finite: bool = True) -> Any:
    """A returned array as float64, copied. Raises ForeignError, which says what was returned and what is needed."""
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ForeignError(f"{who}: {meant} is {_brief(value)}; an array {shape} is needed") from None
    if found.shape != shape:
        raise ForeignError(f"{who}: {meant} has shape {found.shape}; {shape} is needed")
    if finite and not np.isfinite(found).all():
        raise ForeignError(f"{who}: {meant} is not finite: {_brief(value)}")
    return found


def whole(who: str, value: Any, length: int, meant: str) -> Any:
    """A returned array (length,) of whole numbers as int64, copied."""
    found = np.asarray(value)
    if found.shape == (0,) == (length,):
        return np.empty(0, np.int64)
    if found.dtype.kind not in "iu":
        raise ForeignError(f"{who}: {meant} is {_brief(value)} of {found.dtype}; whole numbers are needed")
    if found.shape != (length,):
        raise ForeignError(f"{who}: {meant} has shape {found.shape}; {(length,)} is needed")
    return found.astype(np.int64)


def _brief(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."

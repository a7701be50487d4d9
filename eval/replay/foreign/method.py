"""Somebody else's way of association, `f(expectation, gate) -> decisions`, called as our own are."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from association.expectation import Expectation
from data.inputs import IntArray
from data.result import DISCARD, NEW
from eval.replay.foreign.guard import ForeignError, call, whole
from eval.replay.foreign.load import Loaded

T = TypeVar("T", bound=np.generic)


class Method:
    """It pairs; what it leaves at `NEW` founds a landmark only where newness lets it, as with our plain methods.

    Attributes:
        name: in tables.
    """

    def __init__(self, loaded: Loaded) -> None:
        """Calls `loaded.thing`; a class is made once, without arguments, and then called."""
        self.name = loaded.name
        thing = loaded.thing
        self._function = call(f"{self.name}()", thing) if isinstance(thing, type) else thing

    def __call__(self, expectation: Expectation, gate: float | None) -> IntArray:
        """Decisions (m,): landmark number, `NEW` or `DISCARD`.

        Raises:
            ForeignError: it crashed, or returned what is none.
        """
        m = len(expectation.z)
        found: IntArray = whole(self.name, call(self.name, self._function, expectation, gate), m, "what it returned")
        known = np.isin(found, expectation.number) | (found == NEW) | (found == DISCARD)
        if not known.all():
            i = int(np.argmin(known))
            raise ForeignError(
                f"{self.name}: decision {found[i]} about observation {i} names no candidate; the number of one, "
                f"NEW ({NEW}) or DISCARD ({DISCARD}) is needed"
            )
        return found


def locked(e: Expectation) -> Expectation:
    """The same expectation with arrays that cannot be changed."""
    return replace(
        e, number=_locked(e.number), z_hat=_locked(e.z_hat), HPHt=_locked(e.HPHt), frame=_locked(e.frame),
        z=_locked(e.z), R=_locked(e.R), observed_frame=_locked(e.observed_frame),
    )  # fmt: skip


def _locked(values: NDArray[T]) -> NDArray[T]:
    view = values.view()
    view.setflags(write=False)
    return view

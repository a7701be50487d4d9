"""Anderson acceleration of a search that converges linearly, as by reweighting or with large residuals.

Anderson, "Iterative procedures for nonlinear integral equations", J. ACM 12, 1965: the next estimate is extrapolated by
the mixture of the last steps that is shortest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data.se2 import Array

DEPTH = 6  # steps of an extrapolation


def extended(past: Sequence[tuple[Array, Array]], at: Array, step: Array) -> list[tuple[Array, Array]]:
    """The last estimates with the step from each, and one more."""
    return [*past[max(len(past) - DEPTH + 1, 0) :], (at, step)]


def mixture(past: Sequence[tuple[Array, Array]]) -> Array | None:
    """The estimate extrapolated from the last ones and the step from each, of any shape; None: there is only one."""
    if len(past) < 2:
        return None
    steps = np.array([d.ravel() for _, d in past])
    ends = np.array([(p + d).ravel() for p, d in past])
    mix = np.linalg.lstsq(np.diff(steps, axis=0).T, steps[-1], rcond=1e-8)[0]
    found: Array = ends[-1] - mix @ np.diff(ends, axis=0)
    return found.reshape(past[-1][0].shape)

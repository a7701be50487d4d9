"""A run of which nothing is there but the reason."""

from __future__ import annotations

import numpy as np

from data.inputs import Inputs
from data.result import DISCARD, Failure, Run, Trajectory


def no_run(
    name: str,
    association: str,
    task: str,
    inputs: Inputs,
    failure: Failure,
    *,
    online: bool = True,
    final: bool = False,
) -> Run:
    """Blank trajectories of the phases it would have had; nothing was decided."""
    n = len(inputs)
    nowhere = Trajectory(np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan))
    nothing = np.full(len(inputs.observations.frame), DISCARD, np.int64)
    return Run(
        name, association, task, nowhere if online else None, nowhere if final else None, None, nothing, nothing,
        np.full(len(nothing), -1, np.int64), failure=failure,
    )  # fmt: skip

"""Estimates as they were made, in a CSV file that grows while the robot drives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from data.errors import UsageError
from data.terminal.ending import told
from eval.online.session import Taken

COLUMNS = "frame,t,estimator,x,y,theta,xx,xy,xt,yy,yt,tt"
"""Pose [m, m, rad] and its covariance; numbers are written so that reading them gives the same bits."""


class Estimates:
    """Writes a line for each estimator and frame, at once; `with` closes the file."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        """Begin a file.

        Raises:
            UsageError: it cannot be written, or there is one already.
        """
        self._names = names
        try:
            self._file = path.open("x", encoding="utf-8", buffering=1)
        except OSError as fault:
            raise UsageError(f"--estimates {path}: {told(fault)}") from None
        self._file.write(COLUMNS + "\n")

    def add(self, taken: Taken) -> None:
        """A frame; an estimator that has ended has no line."""
        for name, step in zip(self._names, taken.steps, strict=True):
            if step is not None:
                values = [*step.mean.tolist(), *step.covariance[np.triu_indices(3)].tolist()]
                cells = [str(taken.frame.number), repr(taken.frame.time), name, *map(repr, values)]
                self._file.write(",".join(cells) + "\n")

    def __enter__(self) -> Estimates:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

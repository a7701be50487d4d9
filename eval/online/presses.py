"""Ctrl-C and SIGTERM as a wish that is heeded when there is time for it: between two packets, not in one."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType


class Presses:
    """Counts both signals while the block runs; what they would do otherwise they do again afterwards.

    Attributes:
        count: so far.
    """

    def __init__(self) -> None:
        """None yet."""
        self.count, self._heeded = 0, False
        self._before: dict[int, object] = {}

    def _press(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        if self._heeded:
            raise KeyboardInterrupt

    def heed(self) -> None:
        """From now on both end at once whatever is done."""
        self._heeded = True

    def __enter__(self) -> Presses:
        if threading.current_thread() is threading.main_thread():  # only that one may
            self._before = {s: signal.signal(s, self._press) for s in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

"""Jobs for worker processes, which import this file: nothing that takes time to load is here."""

from __future__ import annotations

import os
import signal


def squared(x):
    """A job that ends well."""
    return x * x


def killed(x):
    """A job whose process is killed, as by a system without memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def too_large(x):
    """A job that asks for more memory than there is."""
    raise MemoryError("Unable to allocate 728. TiB")


def stays():
    """Whether this worker would be replaced if it grew, and seconds between its collections of all garbage."""
    from joblib.externals.loky import process_executor

    return process_executor._USE_PSUTIL, process_executor._MEMORY_LEAK_CHECK_DELAY

"""Jobs for worker processes, which import this file: nothing that takes time to load is here."""

import os
import signal
import time


def squared(x):
    return x * x


def killed(x):
    """A job whose process is killed, as by a system without memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def too_large(x):
    raise MemoryError("Unable to allocate 728. TiB")


def stays():
    """Whether this worker would be replaced if it grew, and seconds between its collections of all garbage."""
    from joblib.externals.loky import process_executor

    return process_executor._USE_PSUTIL, process_executor._MEMORY_LEAK_CHECK_DELAY


def computes_on(x):
    os.write(1, b"begun\n")  # one write: those of `print` mix with another worker's where Python is unbuffered
    end = time.monotonic() + 300.0
    while time.monotonic() < end:
        sum(range(10_000))


def two_compute_on():
    """In a process of its own: two workers that compute on."""
    from eval.plan.flags.table import Execution
    from eval.plan.work import Job, work

    list(work([Job(i, computes_on, (i,)) for i in range(2)], Execution(jobs=2)))

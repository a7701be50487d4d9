"""Independent jobs in parallel, or on a Dask cluster (extra `distributed`), with the same numbers.

A job that runs out of memory, by `MemoryError` or because its process is killed, ends alone; all others are finished.
"""

import gc
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from data.errors import SlamrefError, UsageError
from data.notice import Code, Notice, notice
from data.terminal import SELDOM
from data.words import sentence
from eval.figures.figure_style import FigureStyle, current, figure_style
from eval.plan.console import say_kept
from eval.plan.flags.table import Execution
from eval.replay.external.spec import introduce, introduced
from eval.replay.run import one_thread

CONNECT = 10  # [s] to reach the scheduler
NEVER = 10**6  # [s] that an idle worker lives, eleven days; much more overflows
START = 3.0  # [s] processor time to start a process; measured 2.7
Owner = TypeVar("Owner")
OwnerT = TypeVar("OwnerT", covariant=True)
Call = tuple[Callable[..., Any], tuple[Any, ...]]


@dataclass(frozen=True)
class Job(Generic[OwnerT]):
    """A call that any process can do, and the owner of its result; `seconds`: approximate processor time, if known."""

    owner: OwnerT
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    seconds: float = math.inf


KILLED = notice(Code.OUT_OF_MEMORY, killed=True)  # a notice in place of a result says why there is none


class OutOfMemoryError(SlamrefError):
    """A job ran out of memory, and its result is needed."""


def work(
    jobs: Sequence[Job[Owner]], execution: Execution, *, far: bool = False,
    lost: Callable[[Owner, Notice], None] | None = None,
) -> Iterator[tuple[Owner, Any]]:  # fmt: skip
    """Results with their owners, when they are done; short jobs in this process, `far`: on the cluster, if there is
    one. `lost` is called for each job that ran out of memory; None raises `OutOfMemoryError` instead.
    """
    names, style = introduced(), current()
    calls: dict[int, Call] = {i: (_done, (names, style, job.function, job.arguments)) for i, job in enumerate(jobs)}
    if far and execution.scheduler is not None:
        results = on_cluster(execution.scheduler, list(calls.values())) if calls else iter(())
    else:
        results = _together(calls, execution.jobs if sum(job.seconds for job in jobs) > 2.0 * START else 1)
    for i, result in results:
        owner = jobs[i].owner
        if not isinstance(result, Notice):
            yield owner, result
        elif lost is None:
            raise OutOfMemoryError(f"{sentence(result)}; fewer processes (--jobs 1) or a shorter log need less")
        else:
            lost(owner, result)


def cached(
    jobs: Sequence[tuple[Job[Owner], Path]], load: Callable[[Path], Any], save: Callable[[Path, Any], None],
    execution: Execution, lost: Callable[[Owner, Notice], None], progress: Callable[[int, int], None],
) -> dict[Owner, Any]:  # fmt: skip
    """Results by owner, each saved in its file when it is done; files of earlier runs are loaded instead."""
    found = {job.owner: kept for job, path in jobs if (kept := load(path)) is not None}
    missing = {job.owner: (job, path) for job, path in jobs if job.owner not in found}
    say_kept(len(found), len(jobs), execution.quiet)
    results = work([job for job, _ in missing.values()], execution, far=True, lost=lost)
    for done, (owner, result) in enumerate(results, start=1):
        save(missing[owner][1], result)
        found[owner] = result
        progress(done, len(missing))
    return found


def _done(names: tuple[str, ...], style: FigureStyle, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """In a worker, with foreign names and figure style of the caller: the result, or a notice of a lack of memory."""
    introduce(names)
    with one_thread(), figure_style(style):
        try:
            return function(*arguments)
        except MemoryError as fault:
            return notice(Code.OUT_OF_MEMORY, detail=str(fault).rstrip("."))


def _together(calls: Mapping[int, Call], processes: int) -> Iterator[tuple[int, Any]]:
    """On this machine; after a process is killed, over an unknown job, one by one with all the memory."""
    waiting = dict(calls)
    if min(processes, len(waiting)) < 2:
        yield from ((i, function(*arguments)) for i, (function, arguments) in calls.items())
        return
    from joblib import Parallel, delayed

    try:
        pool = Parallel(
            n_jobs=min(processes, len(waiting)), return_as="generator_unordered", idle_worker_timeout=NEVER,
            initializer=_in_worker, initargs=(os.getpid(),),
        )  # fmt: skip
        for i, result in pool(delayed(_numbered)(i, *call) for i, call in calls.items()):
            del waiting[i]
            yield i, result
    except BrokenProcessPool:
        yield from _one_at_a_time(waiting)


def _numbered(i: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    return i, function(*arguments)


def _one_at_a_time(calls: Mapping[int, Call]) -> Iterator[tuple[int, Any]]:
    """Calls one by one in a process, which is replaced after it is killed."""
    pool = None
    for i, (function, arguments) in calls.items():
        from joblib.externals.loky import ProcessPoolExecutor  # type: ignore[import-untyped]  # slow to load

        pool = pool or ProcessPoolExecutor(1, timeout=NEVER, initializer=_in_worker, initargs=(os.getpid(),))
        try:
            yield i, pool.submit(function, *arguments).result()
        except BrokenProcessPool:
            pool = None
            yield i, KILLED
    if pool is not None:
        pool.shutdown()


def _in_worker(parent: int) -> None:
    """Begin a worker that lives as long as the process that started it, whatever memory its jobs took: loky would take
    one that grew by 300 MB with the logs for a leak and replace it, or collect garbage every second. No public switch.
    """
    from joblib.externals.loky import process_executor

    gc.set_threshold(*SELDOM)
    process_executor._USE_PSUTIL = False
    process_executor._MEMORY_LEAK_CHECK_DELAY = math.inf
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process, whatever it does, when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def on_cluster(address: str, calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
    """Results of calls with their index, when they are done; a lost worker's are repeated, one that ends several gives
    `KILLED`. UsageError: no scheduler, no workers, or another version of slamref.
    """
    from eval.studies.store import code_digest  # slow to load

    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError:
        raise UsageError("--scheduler needs Dask: pip install 'slamref[distributed]'") from None
    try:
        client = Client(address, timeout=CONNECT)
    except (OSError, TimeoutError, ValueError) as fault:
        raise UsageError(f"--scheduler {address}: {fault or 'no answer'}") from None
    with client:
        versions = client.run(code_digest)
        if not versions:
            raise UsageError(f"--scheduler {address}: the cluster has no workers")
        for worker, digest in versions.items():
            if digest != code_digest():
                raise UsageError(f"--scheduler {address}: {worker} has other versions of slamref or its libraries")
        index = {client.submit(f, *arguments, pure=False): i for i, (f, arguments) in enumerate(calls)}
        for future in as_completed(index):
            try:
                result = future.result()
            except KilledWorker:  # several workers one after the other
                result = KILLED
            yield index[future], result

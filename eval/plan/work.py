"""Independent jobs done in parallel, or on a cluster; results come with their owners as they are done.

A job that runs out of memory ends alone, whether it is told so (`MemoryError`) or its process is killed: all others
are finished. On a Dask cluster it is the same function on other machines, and the same numbers (extra `distributed`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from threadpoolctl import threadpool_limits

from data.errors import SlamrefError, UsageError
from data.notice import Code, Notice, Severity, notice
from data.words import sentence
from eval.figures.figure_style import FigureStyle, current, figure_style
from eval.plan.flags.table import Execution
from eval.replay.external.spec import introduce, introduced

CONNECT = 10
"""s, to reach the scheduler."""
NEVER = 10**6
"""s (eleven days; much more overflows) that a worker waits for the next job, or it would have to be started again."""
Owner = TypeVar("Owner")
OwnerT = TypeVar("OwnerT", covariant=True)
Call = tuple[Callable[..., Any], tuple[Any, ...]]


START = 3.0
"""s of processor time until a process has loaded what it needs; measured 2.7."""


@dataclass(frozen=True)
class Job(Generic[OwnerT]):
    """A call that any process can do, and whom its result belongs to.

    `seconds`: processor time that it takes, about; unknown: as long as you like.
    """

    owner: OwnerT
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    seconds: float = math.inf


KILLED = notice(Code.OUT_OF_MEMORY, Severity.ERROR, killed=True)
"""In place of a result, as every notice is: why there is none."""


class OutOfMemoryError(SlamrefError):
    """A job had not enough memory, and nobody can do without its result."""


def work(
    jobs: Sequence[Job[Owner]],
    execution: Execution,
    *,
    far: bool = False,
    lost: Callable[[Owner, Notice], None] | None = None,
    apart: bool = False,
) -> Iterator[tuple[Owner, Any]]:
    """Results with their owners as they come; `far`: on the cluster, if there is one (`--scheduler`).

    `apart`: one after the other, in a process of their own, which has all the memory. `lost` hears of each job that had
    not enough memory, with the reason; without it, that raises `OutOfMemoryError`. Jobs that take less time than it
    takes to start processes for them are done here.
    """
    names, look = introduced(), current()
    calls: dict[int, Call] = {i: (_done, (names, look, job.function, job.arguments)) for i, job in enumerate(jobs)}
    if far and execution.scheduler is not None:
        results = on_cluster(execution.scheduler, list(calls.values())) if calls else iter(())
    else:
        processes = execution.jobs if sum(job.seconds for job in jobs) > 2.0 * START else 1
        results = (_one_at_a_time if apart else _together)(calls, processes)
    for i, result in results:
        owner = jobs[i].owner
        if not isinstance(result, Notice):
            yield owner, result
        elif lost is None:
            raise OutOfMemoryError(f"{sentence(result)}; fewer processes (--jobs 1) or a shorter log need less")
        else:
            lost(owner, result)


def _done(names: tuple[str, ...], look: FigureStyle, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """In a worker: what a call gives, or that it had not enough memory.

    Foreign names and the look of figures are as in the process that asked.
    """
    introduce(names)
    # sums over two threads round otherwise than over one: the same bytes for any number of processes and cores
    with threadpool_limits(1), figure_style(look):
        try:
            return function(*arguments)
        except MemoryError as fault:
            return notice(Code.OUT_OF_MEMORY, Severity.ERROR, detail=str(fault).rstrip("."))


def _together(calls: Mapping[int, Call], processes: int) -> Iterator[tuple[int, Any]]:
    """On this machine. After a process was killed, nobody knows over which job: the rest is done one by one.

    Then each has all the memory, and only the one that needs more is lost.
    """
    waiting = dict(calls)
    if min(processes, len(waiting)) < 2:
        yield from ((i, function(*arguments)) for i, (function, arguments) in calls.items())
        return
    from joblib import Parallel, delayed

    try:
        pool = Parallel(
            n_jobs=min(processes, len(waiting)),
            return_as="generator_unordered",
            idle_worker_timeout=NEVER,
            initializer=_keep_workers,
        )
        for i, result in pool(delayed(_numbered)(i, *call) for i, call in calls.items()):
            del waiting[i]
            yield i, result
    except BrokenProcessPool:
        yield from _one_at_a_time(waiting, processes)


def _numbered(i: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    return i, function(*arguments)


def _one_at_a_time(calls: Mapping[int, Call], processes: int) -> Iterator[tuple[int, Any]]:
    """Calls in a process that nothing else runs in; a new one for the next after it was killed."""
    from joblib.externals.loky import ProcessPoolExecutor  # type: ignore[import-untyped]

    pool = None
    for i, (function, arguments) in calls.items():
        pool = pool or ProcessPoolExecutor(max_workers=1, timeout=NEVER, initializer=_keep_workers)
        try:
            yield i, pool.submit(function, *arguments).result()
        except BrokenProcessPool:
            pool = None
            yield i, KILLED
    if pool is not None:
        pool.shutdown()


def _keep_workers() -> None:
    """In a worker: it stays until the end, however much memory its jobs took.

    A worker that has grown by 300 MB since its first job is taken by loky for one that leaks, stopped and replaced,
    which it warns of. Ours grow because one log is larger than another, and allocators keep what they got: a new
    process would grow as much, after compiling everything once more. There is no public switch.
    """
    from joblib.externals.loky import process_executor

    process_executor._USE_PSUTIL = False


def on_cluster(address: str, calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
    """Results of calls with their index, as they come; what a lost worker had in hand is done again by another.

    A call that takes one worker after the other down with it gives `KILLED`.

    Raises UsageError if the scheduler cannot be reached, has no workers, or runs another version of this program.
    """
    from eval.studies.store import code_digest  # all estimators with it, which a worker that starts has no need of

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

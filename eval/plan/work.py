"""Independent jobs done in parallel, or on a cluster; results come with their owners as they are done."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from eval.plan.cluster import Call, on_cluster
from eval.plan.options import Options

Owner = TypeVar("Owner")


def work(jobs: Sequence[tuple[Owner, Call]], options: Options, far: bool = False) -> Iterator[tuple[Owner, Any]]:
    """Results with their owners as they come; `far`: on the cluster, if there is one (`--scheduler`)."""
    if not jobs:
        return
    if far and options.scheduler:
        for i, result in on_cluster(options.scheduler, [call for _, call in jobs]):
            yield jobs[i][0], result
        return
    pool = Parallel(n_jobs=min(options.jobs, len(jobs)), return_as="generator_unordered")
    for i, result in pool(delayed(_numbered)(i, *call) for i, (_, call) in enumerate(jobs)):
        yield jobs[i][0], result


def _numbered(i: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    # sums over two threads round otherwise than over one: the same bytes for any number of processes and cores
    with threadpool_limits(1):
        return i, function(*arguments)

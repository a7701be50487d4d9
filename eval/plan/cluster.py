"""Runs of a study on a Dask cluster: the same function on other machines, the same numbers (extra `distributed`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from data.errors import UsageError

CONNECT = 10
"""s, to reach the scheduler."""
Call = tuple[Callable[..., Any], tuple[Any, ...]]


class Lost(NamedTuple):
    """In place of a result: why there is none."""

    why: str


KILLED = Lost("its process was killed, as happens where memory runs out")


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

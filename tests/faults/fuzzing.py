"""A reader is given broken files: one clear error or a right load, at once, in little memory; nothing else."""

from __future__ import annotations

import math
import shutil
import signal
import tempfile
import tracemalloc
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from data.errors import SlamrefError
from tests.faults.mutations import Files, mutated
from tests.faults.readers import Reader

LONGEST = 20
"""s that one read may take; the valid inputs take milliseconds."""
SPARE = 2 << 20
"""Bytes that a read may take however little it reads: messages, tables of names, a library's buffers."""


class LateError(BaseException):
    """Of a read that does not end; what a reader makes of the errors it knows, it makes nothing of this one."""


@contextmanager
def no_longer_than(seconds: int):
    """Raises LateError in a read that does not end."""

    def late(*_: object) -> None:
        raise LateError(f"reads for more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def save(files: Files, folder: Path) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def peak_of(reader: Reader, files: Files) -> tuple[int, str]:
    """Bytes at most in use while it was read, and what became of it."""
    folder = Path(tempfile.mkdtemp())
    try:
        save(files, folder)
        tracemalloc.start()
        with no_longer_than(LONGEST):
            try:
                found = reader.read(folder)
            except SlamrefError as error:
                said = str(error)
                assert "\n" not in said, said
                assert len(said) < 1000, f"{len(said)} characters: {said[:200]}"
                outcome = "refused"
            else:
                reader.check(found)
                outcome = "read"
        return tracemalloc.get_traced_memory()[1], outcome
    finally:
        tracemalloc.stop()
        shutil.rmtree(folder)


def size_of(files: Files) -> int:
    return sum(map(len, files.values()))


def try_faults(name: str, reader: Reader, count: int) -> Counter[str]:
    """How often broken inputs were refused and read; AssertionError at the first that ends otherwise."""
    inputs = reader.inputs()
    peak_of(reader, dict.fromkeys(inputs[0], b""))  # what a library loads when it first fails is not the input's
    valid = []
    for files in inputs:
        assert peak_of(reader, files)[1] == "read"
        valid.append(peak_of(reader, files)[0])
    outcomes: Counter[str] = Counter()
    for k in range(count):
        rng = np.random.default_rng([k, 7])
        which = int(rng.integers(len(inputs)))
        broken = mutated(inputs[which], reader.faults, rng)
        try:
            peak, outcome = peak_of(reader, broken)
        except BaseException as error:
            kept = Path(tempfile.gettempdir()) / f"fault-{name.replace(' ', '-')}-{k}"
            save(broken, kept)
            raise AssertionError(f"mutation {k} of {name}: {type(error).__name__}: {error}; kept in {kept}") from error
        outcomes[outcome] += 1
        allowed = 2 * math.ceil(valid[which] * max(size_of(broken) / size_of(inputs[which]), 1.0)) + SPARE
        if peak >= allowed:  # once in a while the interpreter rebuilds its table of interned strings, of 4 MB
            peak = peak_of(reader, broken)[0]
        assert peak < allowed, f"mutation {k} of {name}: {peak} bytes in use, {allowed} allowed"
    assert outcomes["refused"] > count / 20
    return outcomes

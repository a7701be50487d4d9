"""How a command ends: a user's error is one line on stderr and status 2; status 1: an estimator was rejected."""

import atexit
import errno
import gc
import os
import stat
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import ParamSpec

from data.errors import SlamrefError, nearest

FINE, WRONG, INTERRUPTED = 0, 2, 130
ROOT = Path(__file__).parents[1]
OURS = ("association", "data", "ekf", "eval", "graph", "wings", "slamref")
FULL = (errno.ENOSPC, errno.EDQUOT)
SELDOM = 50_000, 50, 1000
"""Thresholds of Python's garbage collector in a command: by its own a run of the arena spends 0.8 of 6.6 s in it."""
Words = ParamSpec("Words")


def ended(body: Callable[[], int | None], interrupted: Callable[[], str] | str = "interrupted") -> int:
    """Run the body of a command; returns its exit status. A closed pipe is no error, `interrupted`: said after Ctrl-C.
    Garbage is collected seldom; at the end of the process, where that takes 0.9 s, not at all.
    """
    gc.set_threshold(*SELDOM)
    atexit.register(gc.freeze)
    try:
        try:
            return body() or FINE
        finally:
            sys.stdout.flush()  # while an error can still be reported
    except SlamrefError as fault:
        return _wrong(str(fault))
    except ModuleNotFoundError as fault:
        if fault.name is None:
            raise
        return _wrong(missing(fault.name))
    except MemoryError as fault:
        return _wrong(f"out of memory ({fault}); a shorter log, or a machine with more memory would help")
    except BrokenPipeError as fault:
        return FINE if unread() else _wrong(message_of(fault))
    except OSError as fault:
        _silence()
        return _wrong(message_of(fault))
    except KeyboardInterrupt:
        return _wrong(interrupted if isinstance(interrupted, str) else interrupted(), INTERRUPTED, "")


def ending(interrupted: str = "interrupted") -> Callable[[Callable[Words, int | None]], Callable[Words, int]]:
    """Decorator of the function of a command: it returns the exit status of its body, as `ended`."""

    def decorated(body: Callable[Words, int | None]) -> Callable[Words, int]:
        @wraps(body)
        def command(*words: Words.args, **named: Words.kwargs) -> int:
            return ended(lambda: body(*words, **named), interrupted)

        return command

    return decorated


def meant(word: str, known: Iterable[str]) -> str:
    """A question that names the known word nearest to an unknown one; empty if none is near."""
    near = nearest(word.partition(":")[0], known)
    return f". Did you mean {near + ''.join(word.partition(':')[1:])}?" if near else ""


def unread() -> bool:
    """After a BrokenPipeError: whether standard output was the pipe; if so, the rest of it is discarded."""
    try:
        mode = os.fstat(sys.stdout.fileno()).st_mode
    except (AttributeError, OSError, ValueError):  # no file: a test or a notebook
        return False
    piped = stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)
    if piped:
        _silence()
    return piped


def message_of(fault: OSError) -> str:
    """The message of a failed file, disk or connection, with a remedy."""
    what, full = fault.strerror or str(fault) or type(fault).__name__, fault.errno in FULL
    where = f"{fault.filename}: " if fault.filename is not None else "output cannot be written: " * full
    return f"{where}{what}{'; free some space, or write to another place' * full}"


def missing(module: str) -> str:
    """The message of a missing module: a package that is not installed, or one that hides ours."""
    package = module.partition(".")[0]
    if package in OURS:
        return (
            f"no module {module!r}: another package {package!r} hides that of slamref in {ROOT}; start in another"
            " folder, or use the command `slamref`"
        )
    if (ROOT / "Makefile").exists():  # a checkout
        how = f"run `make venv` in {ROOT}, then .venv/bin/slamref, or `pip install {ROOT}`"
    else:
        how = "run `pip install slamref`, or `pip install .` in a checkout"
    return f"the package {package!r} is not installed for {sys.executable}; {how}"


def _silence() -> None:
    """Discard the rest of the output, which would fail again when the interpreter ends."""
    try:
        descriptor = sys.stdout.fileno()
    except (AttributeError, OSError, ValueError):  # no file: a test or a notebook
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _wrong(text: str, status: int = WRONG, mark: str = "slamref: ") -> int:
    """Report on stderr, if that is writable."""
    with suppress(OSError):
        sys.stderr.write(f"{mark}{text}\n")
        sys.stderr.flush()
    return status


def counted(n: int | float, thing: str, things: str = "") -> str:
    """`1 landmark`, `2 landmarks`; `things`: an irregular plural."""
    return f"{n:.0f} {thing if n == 1 else things or f'{thing}s'}"


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """A line for each row, with aligned columns."""
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]

"""How a command ends: what a person can mend is one line on stderr and exit status 2, never a traceback, never 1.

Status 1 says that an estimator was rejected, so nothing that merely went wrong may end with it.
"""

from __future__ import annotations

import errno
import os
import stat
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from data.errors import SlamrefError

FINE, WRONG, INTERRUPTED = 0, 2, 130
ROOT = Path(__file__).parents[1]
OURS = ("association", "data", "ekf", "eval", "graph", "slamref")
FULL = (errno.ENOSPC, errno.EDQUOT)


def ended(body: Callable[[], int | None], interrupted: Callable[[], str] | str = "interrupted") -> int:
    """Run the body of a command; its exit status.

    A reader that has seen enough (`... | head -1`) is no error. `interrupted` is what is said after Ctrl-C, known then.
    """
    try:
        try:
            return body() or FINE
        finally:
            sys.stdout.flush()  # here, where an error can still be said, and not when the interpreter ends
    except SlamrefError as fault:
        return _wrong(str(fault))
    except ModuleNotFoundError as fault:
        if fault.name is None:
            raise
        return _wrong(missing(fault.name))
    except MemoryError as fault:
        return _wrong(f"out of memory ({fault}); a shorter log, or a machine with more memory would help")
    except BrokenPipeError as fault:
        return FINE if unread() else _wrong(told(fault))
    except OSError as fault:
        _silence()
        return _wrong(told(fault))
    except KeyboardInterrupt:
        return _wrong(interrupted if isinstance(interrupted, str) else interrupted(), INTERRUPTED, "")


def unread() -> bool:
    """After a BrokenPipeError: whether it was standard output's; if so, what is left to print goes nowhere."""
    try:
        mode = os.fstat(sys.stdout.fileno()).st_mode
    except (AttributeError, OSError, ValueError):  # not a file: a test or a notebook looks on
        return False
    piped = stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)
    if piped:
        _silence()
    return piped


def told(fault: OSError) -> str:
    """What went wrong with a file, the disk or a connection, and what would help, in a sentence."""
    what = fault.strerror or str(fault) or type(fault).__name__
    where = f"{fault.filename}: " if fault.filename is not None else "output cannot be written: " * _is_full(fault)
    return f"{where}{what}{'; free some space, or write to another place' if _is_full(fault) else ''}"


def missing(module: str) -> str:
    """What to do about a module that is not there: a package that was not installed, or one that hides ours."""
    package = module.partition(".")[0]
    if package in OURS:
        return (
            f"no module {module!r}: another package {package!r} hides that of slamref in {ROOT}; start from another"
            " folder, or use the command `slamref`, which looks there first"
        )
    if package == "tomllib":
        return f"slamref needs Python 3.11 or newer, not {sys.version.split()[0]}"
    if (ROOT / "Makefile").exists():  # a checkout
        how = f"run `make venv` in {ROOT}, then .venv/bin/slamref, or `pip install {ROOT}`"
    else:
        how = "run `pip install slamref`, or `pip install .` in a checkout"
    return f"the package {package!r} is not installed for {sys.executable}; {how}"


def _is_full(fault: OSError) -> bool:
    return fault.errno in FULL


def _silence() -> None:
    """What is left to print goes nowhere, or it would fail once more, with a traceback, when the interpreter ends."""
    try:
        descriptor = sys.stdout.fileno()
    except (AttributeError, OSError, ValueError):  # not a file: a test or a notebook looks on
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _wrong(text: str, status: int = WRONG, mark: str = "slamref: ") -> int:
    """Say it on stderr, if that can be written to."""
    try:
        sys.stderr.write(f"{mark}{text}\n")
        sys.stderr.flush()
    except OSError:
        return status
    return status


def counted(n: int | float, thing: str, things: str = "") -> str:
    """`1 landmark`, `2 landmarks`; `things`: the plural, where it is not made with an s."""
    return f"{n:.0f} {thing if n == 1 else things or f'{thing}s'}"


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """A line for each row, its cells below those of the row before."""
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]

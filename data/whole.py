"""Files and folders that appear whole or not at all: written beside their place, then moved into it.

An error or an interruption leaves what was there before, and nothing beside it. A process that is killed outright
cannot clean up; the next one that writes the same folder does it.
"""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from os import PathLike
from pathlib import Path

PARTIAL, OLD = "partial", "old"


@contextmanager
def whole_file(path: str | PathLike[str]) -> Iterator[Path]:
    """A path to write to, with the same ending; it takes the place of `path` when the block ends well."""
    target = Path(os.path.abspath(path))
    partial = target.with_name(f".{target.stem}.{PARTIAL}-{_process()}{target.suffix}")
    try:
        yield partial
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: str | PathLike[str]) -> Iterator[Path]:
    """An empty folder to fill; it takes the place of the folder `path` when the block ends well.

    Parents are made. Whether a folder that is there may be replaced is for the caller to check.
    """
    target = Path(os.path.abspath(path))
    target.parent.mkdir(parents=True, exist_ok=True)
    _sweep(target)
    partial = _beside(target, PARTIAL)
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir()
        yield partial
        _replace(target, partial)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _replace(target: Path, partial: Path) -> None:
    """Put the finished folder in place; the old one comes back if that fails."""
    if not target.exists():
        partial.rename(target)
        return
    old = _beside(target, OLD)
    shutil.rmtree(old, ignore_errors=True)
    try:
        target.rename(old)
        partial.rename(target)
    finally:
        if old.exists() and not target.exists():
            old.rename(target)
        shutil.rmtree(old, ignore_errors=True)


def _sweep(target: Path) -> None:
    """Remove what killed processes left; where one died between its two renames, its old folder comes back."""
    host = f"{platform.node()}-"
    for kind in (OLD, PARTIAL):
        for left in target.parent.glob(f".{escape(target.name)}.{kind}-{escape(host)}*"):
            process = left.name.rpartition("-")[2]
            if not process.isdecimal() or _is_alive(int(process)):
                continue
            if kind == OLD and not target.exists():
                left.rename(target)
            else:
                shutil.rmtree(left, ignore_errors=True)


def _beside(target: Path, kind: str) -> Path:
    return target.with_name(f".{target.name}.{kind}-{_process()}")


def _process() -> str:
    """This process, among those of all machines that share a disk."""
    return f"{platform.node()}-{os.getpid()}"


def _is_alive(process: int) -> bool:
    """Whether a process of this machine runs; where that cannot be asked without harm, it may."""
    if os.name != "posix":
        return True
    with suppress(PermissionError):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
    return True

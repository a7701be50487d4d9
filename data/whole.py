"""Atomic writing: files and folders are written beside their place, then moved into it.

An error or an interruption leaves the former contents and nothing beside them. Leftovers of a killed process are
removed by the next one that writes the same folder.
"""

import os
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from os import PathLike
from pathlib import Path

PARTIAL, OLD, USED = "partial", "old", "used"


@contextmanager
def whole_file(path: str | PathLike[str]) -> Iterator[Path]:
    """A temporary path with the same suffix, which replaces `path` when the block ends without error."""
    target = Path(os.path.abspath(path))
    partial = target.with_name(f".{target.stem}.{PARTIAL}-{_process()}{target.suffix}")
    try:
        yield partial
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: str | PathLike[str]) -> Iterator[Path]:
    """An empty folder to fill that replaces `path` when the block ends without error; the caller checks if it may."""
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


def use(folder: Path) -> None:
    """Mark a folder as used by this process until that ends; remove what dead processes left in it."""
    for left in folder.glob(f".*{PARTIAL}-{escape(platform.node())}-*"):
        if not _is_alive(left.stem.rpartition("-")[2]):
            left.unlink(missing_ok=True)
    for mark in folder.glob(f".{USED}-*"):
        if _is_dead(mark):
            mark.unlink(missing_ok=True)
    (folder / f".{USED}-{_process()}").touch()


def in_use(folder: Path) -> bool:
    """Whether another process that may be alive has marked a folder; those of other machines may be."""
    own = f".{USED}-{_process()}"
    return any(mark.name != own and not _is_dead(mark) for mark in folder.glob(f".{USED}-*"))


def _is_dead(mark: Path) -> bool:
    host, _, process = mark.name.removeprefix(f".{USED}-").rpartition("-")
    return host == platform.node() and not _is_alive(process)


def _replace(target: Path, partial: Path) -> None:
    """Move the finished folder into place; the old one is restored if that fails."""
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
    """Remove what killed processes left; a folder that was moved away but not replaced is restored."""
    host = f"{platform.node()}-"
    for kind in (OLD, PARTIAL):
        for left in target.parent.glob(f".{escape(target.name)}.{kind}-{escape(host)}*"):
            if _is_alive(left.name.rpartition("-")[2]):
                continue
            if kind == OLD and not target.exists():
                left.rename(target)
            else:
                shutil.rmtree(left, ignore_errors=True)


def _beside(target: Path, kind: str) -> Path:
    return target.with_name(f".{target.name}.{kind}-{_process()}")


def _process() -> str:
    """This process, unique among machines that share a disk."""
    return f"{platform.node()}-{os.getpid()}"


def _is_alive(process: str) -> bool:
    """Whether a process of this machine runs; True where that cannot be checked, or for what is no number."""
    if os.name != "posix" or not process.isdecimal():
        return True
    with suppress(PermissionError):
        try:
            os.kill(int(process), 0)
        except ProcessLookupError:
            return False
    return True

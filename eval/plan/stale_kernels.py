"""Which compiled kernels no longer fit their source, or that of a module they use: these alone are compiled again.

numba looks at the file of a kernel only: a caller does not notice that a kernel or a constant of another file changed.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from data.terminal import ROOT

PACKAGES = ("association", "data", "ekf", "eval", "graph", "wings")
KEPT = ROOT / "ekf" / "__pycache__" / ".slamref-sources.json"
"""sha256 of what each module with kernels was compiled from."""


def forget_stale(kept: Path = KEPT) -> list[Path]:
    """Delete what was compiled from other sources; the modules (k) that it belonged to."""
    try:
        before: dict[str, str] = json.loads(kept.read_text())
    except (OSError, ValueError):
        before = {}
    changed = [m for m, digest in digests().items() if before.get(str(m.relative_to(ROOT))) != digest]
    for module in changed:
        for compiled in (module.parent / "__pycache__").glob(f"{module.stem}.*.nb[ic]"):
            with suppress(OSError):
                compiled.unlink()
    return changed


def forget_in_checkout(kept: Path = KEPT) -> None:
    """In a checkout whose files are newer than the note of them, as after a pull: `forget_stale`, and note them anew.

    A kernel that was compiled from an older file gives wrong numbers, and nothing says so. The look at all files takes
    milliseconds; an installed package changes as a whole.
    """
    if not (ROOT / ".git").exists():
        return
    newest = max(m.stat().st_mtime for package in PACKAGES for m in (ROOT / package).rglob("*.py"))
    if not kept.exists() or kept.stat().st_mtime < newest:
        forget_stale(kept)
        note_sources(kept)


def note_sources(kept: Path = KEPT) -> None:
    """Note what everything was compiled from; nothing where the folder cannot be written to."""
    found = {str(m.relative_to(ROOT)): digest for m, digest in digests().items()}
    with suppress(OSError):
        kept.write_text(json.dumps(found, indent=1, sort_keys=True))


def digests() -> dict[Path, str]:
    """sha256 of each module with kernels and of all modules of ours that it imports."""
    modules = [m for package in PACKAGES for m in sorted((ROOT / package).rglob("*.py")) if b"njit" in m.read_bytes()]
    return {m: hashlib.sha256(b"".join(p.read_bytes() for p in sorted(closure(m)))).hexdigest() for m in modules}


def closure(module: Path) -> set[Path]:
    """A module and all modules of ours that it imports, directly or not."""
    found: set[Path] = set()
    waiting = [module]
    while waiting:
        if (m := waiting.pop()) not in found:
            found.add(m)
            waiting += _imported(m)
    return found


@cache
def _imported(module: Path) -> tuple[Path, ...]:
    return tuple(_files(ast.parse(module.read_bytes())))


def _files(tree: ast.Module) -> Iterator[Path]:
    for node in tree.body:  # what is imported for types alone stands deeper
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
        elif isinstance(node, ast.Import):
            names = [a.name for a in node.names]
        for name in names:
            if name.partition(".")[0] in PACKAGES:
                place = ROOT.joinpath(*name.split("."))
                for file in (place.with_suffix(".py"), place / "__init__.py"):
                    if file.is_file():
                        yield file

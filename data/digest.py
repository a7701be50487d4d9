"""A digest of all code that a cached computation executes: packages of this program and libraries they use."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).parents[1]


def sources(*packages: str) -> list[Path]:
    """All .py files below `packages`: folders or files, relative to the root of the program."""
    found = (ROOT / package for package in packages)
    return sorted(f for path in found for f in (path.rglob("*.py") if path.is_dir() else [path]))


@cache
def program_digest(packages: tuple[str, ...], libraries: tuple[str, ...]) -> str:
    """SHA-256 of the names and contents of `sources(*packages)` and of the versions of `libraries`."""
    digest = hashlib.sha256()
    for f in sources(*packages):
        digest.update(f.relative_to(ROOT).as_posix().encode() + f.read_bytes())
    for library in libraries:
        digest.update(f"{library} {version(library)}".encode())
    return digest.hexdigest()

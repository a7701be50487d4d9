"""Digests: of a file as a log's source, and of all code that a cached computation executes."""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).parents[1]


def sources(*packages: str) -> list[Path]:
    """All .py files below `packages`: folders or files, relative to the root of the program."""
    found = (ROOT / package for package in packages)
    return sorted(f for path in found for f in (path.rglob("*.py") if path.is_dir() else [path]))


def file_sha256(path: Path) -> str:
    """SHA-256 of a file; of a folder, of the names and digests of all files in it."""
    if path.is_dir():
        digest = hashlib.sha256()
        for f in sorted(p for p in path.rglob("*") if p.is_file()):
            digest.update(f"{f.relative_to(path).as_posix()} {file_sha256(f)}\n".encode())
        return digest.hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def source_file(path: Path) -> dict[str, str]:
    """What a log states of the file it was made from: name and digest, not the place, which is nobody else's."""
    return {"file": path.absolute().name, "sha256": file_sha256(path)}


@cache
def program_digest(packages: tuple[str, ...], libraries: tuple[str, ...]) -> str:
    """SHA-256 of the names and contents of `sources(*packages)` and of the versions of `libraries`."""
    digest = hashlib.sha256()
    for f in sources(*packages):
        digest.update(f.relative_to(ROOT).as_posix().encode() + f.read_bytes())
    for library in libraries:
        digest.update(f"{library} {version(library)}".encode())
    return digest.hexdigest()

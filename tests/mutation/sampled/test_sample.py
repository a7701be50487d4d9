"""Faults drawn at random, one at a time in a copy of the tree: most of them are caught by the fast suite.

`pytest -m slow tests/mutation/sampled`, with FAULTS=100 SEED=7 in the environment for another sample. A fault is tried
on the test files nearest to it, then on all: minutes for one that is missed, seconds for the others.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.mutation.sampled.equivalent import EQUIVALENT
from tests.mutation.sampled.mutants import Fault, faults_of
from tests.mutation.sampled.nearest import PACKAGES, importers, nearest_tests, reached

ROOT = Path(__file__).parents[3]
CAUGHT = 0.6
"""The aim is 0.95. Measured were 0.81 (docs/reliability.md); 20 faults then show less once in a hundred times."""
NEAREST = 12
"""Test files tried before the whole suite."""
NUMBER, SEED = int(os.environ.get("FAULTS", "20")), int(os.environ.get("SEED", "1"))
NO_TESTS = 5
"""Exit status of pytest where every test of the files is a slow one."""
LONGEST = 1800.0
"""s; the whole fast suite takes less than half of it."""


def tree_at(folder: Path) -> Path:
    """A copy of the project, with its compiled kernels."""
    (folder / "tree").mkdir()
    for path in ROOT.iterdir():
        if path.is_dir() and path.name in (*PACKAGES, "tests", "docs"):
            shutil.copytree(path, folder / "tree" / path.name)
        elif path.is_file() and not path.name.startswith("."):
            shutil.copy2(path, folder / "tree")
    if (shared := ROOT.parent / "shared").is_dir():
        (folder / "shared").symlink_to(shared.resolve())
    return folder / "tree"


def drawn(root: Path, number: int, seed: int) -> list[Fault]:
    """Files by their lines, then a fault of the file."""
    rng = random.Random(seed)
    files = [p for top in PACKAGES for p in (root / top).rglob("*.py")]
    texts = {p.relative_to(root).as_posix(): p.read_text("utf-8") for p in files}
    paths, found = sorted(texts), dict[Fault, None]()
    lengths = [texts[path].count("\n") for path in paths]
    while len(found) < number:
        path = rng.choices(paths, lengths)[0]
        faults = faults_of(path, texts[path])
        if faults and (fault := rng.choice(faults)).is_one(texts[path]) and fault.key(texts[path]) not in EQUIVALENT:
            found[fault] = None
    return list(found)


def fails(root: Path, *what: str) -> bool:
    """The fast tests, or those of some files, fail, hang, or cannot be read."""
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *what]
    try:
        done = subprocess.run(command, cwd=root, env=environment, capture_output=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return True
    return done.returncode not in (0, NO_TESTS)


def is_caught(fault: Fault, root: Path, by: Mapping[str, set[str]]) -> bool:
    """Whether the fast suite fails with the fault; the copy is as before afterwards."""
    file = root / fault.path
    whole, near, stamp = file.read_text("utf-8"), nearest_tests(fault.path, by)[:NEAREST], file.stat()
    # callers of a compiled kernel do not notice a change in another file
    changed = [root / path for path in reached(fault.path, by)] if "njit" in whole else []
    compiled = {x: x.read_bytes() for p in changed for x in p.parent.glob(f"__pycache__/{p.stem}.*.nb[ic]")}
    try:
        for x in compiled:
            x.unlink()
        file.write_text(fault.put_into(whole), "utf-8")
        return (bool(near) and fails(root, *near)) or fails(root, "-n", "2", "--dist", "loadfile")
    finally:
        file.write_text(whole, "utf-8")
        os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
        for x, before in compiled.items():
            x.write_bytes(before)


@pytest.mark.slow
def test_most_faults_drawn_at_random_are_caught_by_the_fast_suite(tmp_path):
    root = tree_at(tmp_path)
    by = importers(root)
    faults = drawn(root, NUMBER, SEED)
    assert not fails(root, *nearest_tests(faults[0].path, by)[:NEAREST]), "the copy is not sound"
    missed = [fault for fault in faults if not is_caught(fault, root, by)]
    said = [f"{f.path}:{f.line} {' -> '.join(f.key((root / f.path).read_text('utf-8'))[1:])}" for f in missed]
    assert len(missed) <= (1.0 - CAUGHT) * NUMBER, "\n".join([f"{len(missed)} of {NUMBER} missed:", *said])

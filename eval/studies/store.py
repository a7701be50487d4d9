"""Finished runs of studies on disk, so that an interrupted study resumes.

Runs are kept beside the result folders, in `.studies/<scenario>-<code>-<content>/<seed>.npz`. The two digests cover
program, libraries and scenario. The folder may be deleted at any time.
"""

import hashlib
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from data.digest import program_digest
from data.log import folder_name
from data.terminal import counted
from data.whole import in_use, use, whole_file
from eval.replay.external.adapter import digests
from eval.studies.montecarlo import Key, Result, Sample
from eval.studies.scenario import Scenario

PACKAGES = (
    *("data", "association", "ekf", "graph", "wings"),
    *("eval/__init__.py", "eval/compare.py", "eval/replay", "eval/referee", "eval/studies"),
)  # code that a run may execute
LIBRARIES = ("gtsam", "numba", "numpy", "pandas", "scipy")
DIGITS = 10
TICK = 0.02  # s; file times are those of the last clock tick, which may be before the clock was read


def code_digest() -> str:
    """Digest of the program and its libraries."""
    return program_digest(PACKAGES, LIBRARIES)[:DIGITS]


def content_digest(s: Scenario) -> str:
    """Digest of what the runs of a scenario depend on (not declarations, citations or comparisons)."""
    p = s.published
    averages = None if p is None else (p.skipped_are_zero, p.per_dof)
    members = [(m.name, m.world) for m in s.members]
    theirs = digests((*(m.name for m in s.members), *s.association, s.setup.maintain_by, s.maker))
    stated = (s.kind, s.values, s.task, s.association, members, s.setup, s.from_frame, s.wrong, averages, theirs)
    return hashlib.sha256(repr(stated).encode()).hexdigest()[:DIGITS]


def folder_of(root: Path, scenario: Scenario) -> Path:
    """The folder of a scenario's runs; created if necessary."""
    return kept_folder(root, scenario.name, content_digest(scenario))


def kept_folder(root: Path, called: str, content: str) -> Path:
    """The folder of these runs, made if needed; those of other programs go unless a live process uses them."""
    name = folder_name(called)
    folder = root / ".studies" / f"{name}-{code_digest()}-{content[:DIGITS]}"
    folder.mkdir(parents=True, exist_ok=True)
    use(folder)
    for old in folder.parent.glob(f"{name}-{'?' * DIGITS}-{'?' * DIGITS}"):
        if old.name.split("-")[-2] != code_digest() and not in_use(old):
            shutil.rmtree(old, ignore_errors=True)
    return folder


def kept_since(root: Path, begin: float) -> str:
    """A message for an interrupted study, begun at `begin` [s since the epoch]: what is kept, and how to resume."""
    folder = root / ".studies"
    done = sum(f.stat().st_mtime >= begin - TICK for f in folder.glob("*/[!.]*.*"))
    if not done:
        return "nothing was changed"
    runs = f"{counted(done, 'run')} done since the start {'is' if done == 1 else 'are'} kept in {folder}"
    return f"the report is as it was; {runs}: the same command goes on from there"


def save(folder: Path, seed: int, result: Result) -> None:
    """Keep a run; the file is written atomically."""
    rows = [
        [list(key), dict(s.means), dict(s.ends), dict(s.squares), dict(s.published), s.failure, s.trace, s.implausible]
        for key, s in result.items()
    ]
    kept: dict[str, Any] = {f"nees_{i}": s.nees_pose for i, s in enumerate(result.values())}
    kept["samples"] = np.frombuffer(json.dumps(rows).encode(), np.uint8)
    with whole_file(folder / f"{seed}.npz") as partial:
        np.savez(partial, **kept)


def load(folder: Path, seed: int) -> Result | None:
    """A kept run; None if it is missing or damaged."""
    try:
        with (folder / f"{seed}.npz").open("rb") as file, np.load(file) as kept:
            rows = json.loads(kept["samples"].tobytes())
            result: Result = {}
            for i, (key, means, ends, squares, published, *rest) in enumerate(rows):
                named: Key = tuple(key)
                result[named] = Sample(means, ends, squares, published, kept[f"nees_{i}"], *rest)
            return result
    except (FileNotFoundError, zipfile.BadZipFile, KeyError, ValueError, EOFError):
        return None

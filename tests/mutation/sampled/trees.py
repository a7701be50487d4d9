"""Copies of the project in which one fault at a time is tried, and the tests that run there in a process of their own.

Libraries are loaded before the process is forked, the product and its tests after it: a fault is tried in seconds.
"""

import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tests.mutation.sampled.mutants import Fault
from tests.mutation.sampled.nearest import PACKAGES

ROOT = Path(__file__).parents[3]
LIBRARIES = ("scipy.stats", "scipy.optimize", "scipy.sparse.linalg", "pandas", "numba", "gtsam", "matplotlib.pyplot",
             "jinja2", "cv2")  # fmt: skip
HANGS = "it hangs"
BROKEN = "it cannot be loaded"


def prepared(folder: Path) -> Path:
    """A copy of the project in `folder`, its kernels compiled; what a copy there has already is kept."""
    tree, new = folder / "tree", set[Path]()
    files = [p for top in (*PACKAGES, "tests", "docs") for p in (ROOT / top).rglob("*") if "__pycache__" not in p.parts]
    for path in [*files, *(p for p in ROOT.iterdir() if not p.name.startswith("."))]:
        there = tree / path.relative_to(ROOT)
        if path.is_file():
            new.add(there)
            there.parent.mkdir(parents=True, exist_ok=True)
            if not there.exists() or there.read_bytes() != path.read_bytes():
                shutil.copy2(path, there)
    for old in tree.rglob("*"):
        if old.is_file() and old not in new and "__pycache__" not in old.parts and "results" not in old.parts:
            old.unlink()
    shared = folder / "shared"
    if (ROOT.parent / "shared").is_dir() and not shared.exists():
        shared.symlink_to((ROOT.parent / "shared").resolve())
    subprocess.run([sys.executable, "-m", "eval.warm"], cwd=tree, env=_environment(tree), check=True)
    return tree


def load_libraries() -> None:
    """What every test process needs and no fault is in."""
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    for name in LIBRARIES:
        import_module(name)


@contextmanager
def broken(tree: Path, fault: Fault) -> Iterator[None]:
    file = tree / fault.path
    whole, stamp = file.read_text("utf-8"), file.stat()
    try:
        file.write_text(fault.put_into(whole), "utf-8")
        yield
    finally:
        file.write_text(whole, "utf-8")
        os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


def failing(tree: Path, what: Sequence[str], longest: float) -> str:
    """The first of the tests (files or ids) that fails, in their order; "" if none does. `longest` in s."""
    if not what:
        return ""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=_run, args=(tree, what, theirs))
    process.start()
    theirs.close()
    process.join(longest)
    late = process.is_alive()
    if late:
        os.killpg(process.pid or 0, signal.SIGKILL)
        process.join()
    try:
        return str(ours.recv())
    except EOFError:  # no test failed before the end
        return HANGS if late else ""


class _First:
    """Sends the id of the first test that fails."""

    def __init__(self, to: Any) -> None:
        self.to = to

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and self.to:
            self.to.send(report.nodeid or BROKEN)
            self.to = None

    pytest_collectreport = pytest_runtest_logreport


def _environment(tree: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}


def _run(tree: Path, what: Sequence[str], to: Any) -> None:
    os.setsid()
    os.chdir(tree)
    os.environ |= _environment(tree)
    sys.dont_write_bytecode = True
    sys.path[:] = [str(tree), *(place for place in sys.path if Path(place or ".").resolve() != ROOT)]
    for name in [name for name in sys.modules if name.partition(".")[0] in (*PACKAGES, "tests", "slamref")]:
        del sys.modules[name]
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        first = _First(to)
        status = pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *what], plugins=[first])
        fine = {pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED}
        # a usage error: the test with this id is not there any more; of whole files: a conftest.py cannot be loaded
        fine |= {pytest.ExitCode.USAGE_ERROR} if "::" in what[0] else set()
        if status not in fine and first.to:
            to.send(BROKEN)
    os._exit(0)

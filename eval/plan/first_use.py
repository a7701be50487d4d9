"""First runs after an installation: a small log is replayed by interpreted kernels while a child process compiles.

`data.compiled` says where kernels are kept, and whether all are compiled. This module does not import numba, which
decides on import whether to compile (`NUMBA_DISABLE_JIT`).
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from data.compiled import base, mark
from data.terminal import ROOT
from eval.plan.flags.table import Options

INTERPRETED = "NUMBA_DISABLE_JIT"
SMALL = 16_000
"""Most observations, times estimators, methods and tasks, for interpreted kernels: 20 s at the measured 0.3 to 1.2 ms
each; compiling takes longer."""
WORLDS = {"arena": 2000, "linear": 1400, "corridor": 600}  # Most observations of simulated logs of default length
FEWER = re.compile(r"frames=(\d{1,2}|1\d\d|200)|people|no-odometry|no-people|odometry")  # Of no larger log
LINES = 200_000  # most bytes in observations.csv of a small log, with at least 50 bytes a line
NOTICE = "first run: interpreted; compiling in the background, later runs are faster"


def is_compiled() -> bool:
    """Whether a mark shows that all kernels are compiled."""
    return mark().exists() and any(base().rglob("*.nbi"))


def start(options: Options) -> str:
    """On a first run of a small log: interpreted kernels, compiled meanwhile; what is said of it, or empty."""
    if "numba" in sys.modules or INTERPRETED in os.environ or not is_small(options) or is_compiled():
        return ""
    compile_in_background()
    os.environ[INTERPRETED] = "1"
    return NOTICE


def kernels() -> str:
    """`interpreted` or `compiled`: the kernels of this process."""
    return "interpreted" if os.environ.get(INTERPRETED, "0") not in ("", "0") else "compiled"


def is_small(options: Options) -> bool:
    """Whether all logs are small, by their names and files, and nothing else is to be done."""
    chosen, study = options.selection, options.study
    more = chosen.data or chosen.scenario or chosen.lab or study.twins or study.runs or study.full
    if not chosen.log or more or options.setup.calibrate or options.results.result:
        return False
    each = len(chosen.estimator) * max(len(chosen.association), 1) * max(len(chosen.task), 1)
    return sum(observations(name) for name in chosen.log) * each <= SMALL


def observations(name: str) -> float:
    """Upper bound of the observations of a log; infinite if its name and files do not give one."""
    world, _, keys = name.partition(":")
    if world in WORLDS and not Path(name).exists():
        further = [k for k in re.split(r"[:+]", keys.partition(":")[2]) if k]
        return WORLDS[world] if all(FEWER.fullmatch(k) for k in further) else float("inf")
    table = Path(name) / "observations.csv"
    if not table.is_file() or table.stat().st_size > LINES or any(Path(name).glob("scans*")):
        return float("inf")
    return table.read_bytes().count(b"\n")


_children: list[subprocess.Popen[bytes]] = []


def compile_in_background() -> None:
    """Start a process of low priority that compiles all kernels, unless one does; it outlives this one."""
    environment = {k: v for k, v in os.environ.items() if k != INTERPRETED}
    command = [sys.executable, "-m", "eval.warm", "--background"]
    none = subprocess.DEVNULL
    try:
        child = subprocess.Popen(command, cwd=ROOT, env=environment, stdin=none, stdout=none, stderr=none)
    except OSError:  # no further process is possible: later runs are as slow as this one
        return
    _children.append(child)


@contextmanager
def stopping() -> Iterator[None]:
    """End the child, too, at Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt:
        for child in _children:
            child.terminate()
        raise


@contextmanager
def alone(folder: Path, wait: bool) -> Iterator[bool]:
    """Whether this process alone compiles into a folder, or `wait` until it does; True if the folder is read-only."""
    try:
        import fcntl

        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / ".slamref-compiling").open("wb")
    except (ImportError, OSError):
        yield True
        return
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            first = True
        except OSError:
            first = False
        yield first

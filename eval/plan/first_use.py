"""The first runs after an installation: a small log is replayed interpreted at once, while a child process compiles.

Kernels are compiled by numba and kept beside the modules, or in the user's cache where those cannot be written to. A
mark beside them names the versions for which all are there. Loads nothing of numba: whether it compiles is decided when
it is loaded (`NUMBA_DISABLE_JIT`).
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO

from eval.plan.flags.table import Options

ROOT = Path(__file__).parents[2]
INTERPRETED = "NUMBA_DISABLE_JIT"
SMALL = 16_000
"""Observations, times estimators, methods and tasks, that are replayed interpreted: 20 s at most, measured 0.3 to
1.2 ms each; compiling what one run needs takes longer."""
WORLDS = {"arena": 2000, "linear": 1400, "corridor": 600}
"""Observations of simulated logs, at most, as they are by default or with fewer frames."""
FEWER = re.compile(r"frames=(\d{1,2}|1\d\d|200)|people|no-odometry|no-people|odometry")
"""Keys of a simulated log that do not make it larger."""
LINES = 200_000
"""Bytes of a small log's observations.csv, of at least 50 bytes a line."""
NOTICE = "first run: interpreted; compiling in the background, later runs are faster"


def mark_name() -> str:
    """Name of the mark: versions of slamref, Python and numba, and the processor."""
    import llvmlite.binding  # type: ignore[import-untyped]

    try:
        ours = version("slamref")
    except PackageNotFoundError:  # a checkout that was never installed
        ours = "checkout"
    python = f"{sys.implementation.name}{sys.version_info.major}.{sys.version_info.minor}"
    machine = f"{platform.machine()}-{llvmlite.binding.get_host_cpu_name()}"
    return f".slamref-{ours}-{python}-numba-{version('numba')}-{machine}"


def _caches() -> Iterator[Path]:
    """Folders in which numba may keep what it compiled of `ekf`."""
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        yield from Path(own).glob("*")
        return
    yield ROOT / "ekf" / "__pycache__"
    user = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser()
    for place in (user, Path("~/Library/Caches").expanduser(), Path(os.environ.get("LOCALAPPDATA", "~")).expanduser()):
        yield from (place / "numba").glob("*")


def is_compiled() -> bool:
    """Whether a mark says that all kernels are there."""
    name = mark_name()
    return any((place / name).exists() and any(place.glob("*.nbi")) for place in _caches())


def start(options: Options) -> str:
    """Called before numba is loaded: on a first run of a small log, interpret it and compile in a child process.

    Returns:
        A line for the person; empty where nothing is said, and kernels are compiled as they are needed.
    """
    if "numba" in sys.modules or INTERPRETED in os.environ or is_compiled() or not is_small(options):
        return ""
    compile_in_background()
    os.environ[INTERPRETED] = "1"
    return NOTICE


def kernels() -> str:
    """How kernels run in this process."""
    return "interpreted" if os.environ.get(INTERPRETED, "0") not in ("", "0") else "compiled"


def is_small(options: Options) -> bool:
    """Whether all logs are known to be small, by their names and files, and nothing else is asked for."""
    chosen, study = options.selection, options.study
    more = chosen.data or chosen.scenario or chosen.lab or study.twins or study.runs or study.full
    if not chosen.log or more or options.variants or options.setup.calibrate or options.results.result:
        return False
    each = len(chosen.estimator) * max(len(chosen.association), 1) * max(len(chosen.task), 1)
    return sum(observations(name) for name in chosen.log) * each <= SMALL


def observations(name: str) -> float:
    """Observations of a log, at most; infinite where its name and size do not tell."""
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
    """Start a process of low priority that compiles all kernels, unless one is at it; it outlives this one."""
    environment = {k: v for k, v in os.environ.items() if k != INTERPRETED}
    command = [sys.executable, "-m", "eval.warm", "--background"]
    none = subprocess.DEVNULL
    try:
        child = subprocess.Popen(command, cwd=ROOT, env=environment, stdin=none, stdout=none, stderr=none)
    except OSError:  # no room for another process: later runs are as slow as this one
        return
    _children.append(child)


@contextmanager
def stopping() -> Iterator[None]:
    """Ctrl-C within ends the child, too."""
    try:
        yield
    except KeyboardInterrupt:
        for child in _children:
            child.terminate()
        raise


@contextmanager
def alone(folder: Path, wait: bool) -> Iterator[bool]:
    """Whether this process is the only one that compiles into a folder; `wait` until it is.

    Where the folder cannot be written to, nobody else can be asked.
    """
    file = _locked(folder, wait)
    try:
        yield file is not None
    finally:
        if file is not None:
            file.close()


def _locked(folder: Path, wait: bool) -> IO[bytes] | None:
    try:
        import fcntl

        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / ".slamref-compiling").open("wb")
    except (ImportError, OSError):
        return open(os.devnull, "rb")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        file.close()
        return None
    return file

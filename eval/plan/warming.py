"""Compile every kernel by using it once, with progress; `first_use` describes the cache."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from association.names import METHODS
from data.compiled import base, mark
from data.formats.open_log import load_folder, write_folder
from data.inputs import Systematic
from data.log import Log
from data.terminal import ROOT
from data.wing import used, wings
from data.worlds.arena import Arena, simulate
from data.worlds.registry import named_log
from eval.compare import compare
from eval.plan.first_use import alone, is_compiled, kernels
from eval.replay.estimators import make_estimator
from eval.replay.hindsight.placement import candidates
from eval.replay.hindsight.relocalize import Scan, relocalize
from eval.replay.run import step_by_step
from eval.replay.settings import ESTIMATORS, TASKS, Setup

SENSORS = ("range_bearing", "relative_point")
LONG = 60
"""Frames after which hindsight has done all that it does."""


def _small(sensor: str, frames: int = 12) -> Log:
    """A small arena, written and read, since the memory layout of its arrays selects kernels."""
    log = simulate(Arena(frames=frames, landmarks=6, sensor=sensor), 0, name="warm")
    with tempfile.TemporaryDirectory() as folder:
        write_folder(log, Path(folder) / "warm")
        return load_folder(Path(folder) / "warm")


def _estimators(sensor: str, task: str) -> None:
    inputs = _small(sensor).inputs(labels=True)
    for setup in (Setup(), Setup(gate_known=0.9999)):
        compare(inputs, task, ESTIMATORS, setup=setup)


def _methods(sensor: str, task: str) -> None:
    inputs = _small(sensor).inputs(labels=True)
    view = inputs if task == "localization" else inputs.without_map()
    for method in METHODS:
        compare(view, task, ("ekf",), method)
    step_by_step("ekf", view, task)
    for name in ("ekf", "isam2"):
        estimator = make_estimator(name, view)
        estimator.update(view.frame_observations(0), np.full(len(view.frame_observations(0).z), -2))
        expectation = estimator.expect(view.frame_observations(0))
        expectation.joint(np.arange(len(expectation.number)))
        candidates(expectation, view.sensor, np.eye(3))


def _hindsight() -> None:
    """What takes more frames than the others: noise learned on the way, landmarks that stay or go."""
    for log in (_small(SENSORS[0], LONG), named_log(f"arena:0:frames={LONG}")):
        compare(log.inputs(labels=False).without_map(), "slam", ("ekf", "isam2", "batch"), "jcbb-hindsight")


def _errors() -> None:
    """Systematic errors as part of the state, constants and a drift."""
    errors = Systematic(("scale", "curvature", "drift", "bearing"), np.array([0.02, 0.05, 1e-3, 0.1]))
    inputs = replace(_small(SENSORS[0]).inputs(labels=True), systematic=errors)
    for task in TASKS:
        compare(inputs, task, ("ekf", "isam2", "batch"))


def _place() -> None:
    place = _small(SENSORS[0]).recorded.map
    assert place is not None
    n = len(place.id)
    relocalize(Scan(place.xy, 1e-4 * np.eye(2 * n), tuple((i,) for i in range(n))), place)


def _of_wing(part: str) -> None:
    used(part)()


PARTS: dict[str, Callable[[], None]] = {
    **{
        f"{what}, {task}, {sensor.replace('_', ' ')}": partial(part, sensor, task)
        for sensor in SENSORS
        for task in TASKS
        for what, part in (("estimators", _estimators), ("association", _methods))
    },
    "hindsight": _hindsight,
    "systematic errors": _errors,
    "place recognition": _place,
    **{name: partial(_of_wing, part) for wing in wings() for name, part in wing.kernels.items()},
}
"""Parts to compile, in order."""
BESIDE = ("place recognition", *(name for wing in wings() for name in wing.kernels))
"""Those that a second process compiles at the same time: half of the work, and little of it in common."""


def compile_if_needed(quiet: bool = False) -> None:
    """On the first use, compile everything and report it on stderr."""
    if kernels() == "interpreted" or is_compiled():
        return
    if not quiet:
        sys.stderr.write("first use: compiling the numerical kernels, once; this takes a minute or two\n")
    compile_all(quiet)
    if not quiet:
        sys.stderr.write("compiled; later runs start at once\n")


def compile_all(quiet: bool = False, background: bool = False) -> None:
    """Compile every kernel and write the mark; progress is a bar on a terminal, else a line per part.

    If another process is compiling, wait for it; in the `background`, do nothing.
    """
    with alone(base(), wait=not background) as first:
        if first and kernels() == "compiled" and not is_compiled():
            _compile(quiet, os.cpu_count() if not background else 1)
            with suppress(OSError):  # without the mark, the next run checks again
                for old in base().glob(mark().with_suffix(".*").name):
                    old.unlink()
                mark().touch()


def _compile(quiet: bool, cores: int | None) -> None:
    from tqdm import tqdm

    second = beside() if (cores or 1) > 1 and set(BESIDE) <= set(PARTS) else None
    try:
        with tqdm(desc="compiling", total=len(PARTS), disable=quiet or not sys.stderr.isatty(), leave=False) as bar:
            for done, (what, part) in enumerate(PARTS.items()):
                if bar.disable and not quiet:
                    sys.stderr.write(f"compiling, part {done + 1} of {len(PARTS)}: {what}\n")
                bar.set_postfix_str(what)
                if second is None or what not in BESIDE or second.wait() != 0:
                    part()
                bar.update()
    finally:
        if second is not None:
            second.kill()


def beside() -> subprocess.Popen[bytes] | None:
    """A process that compiles the parts `BESIDE`; None if there can be no further one."""
    command = "from eval.plan.warming import BESIDE, PARTS\nfor what in BESIDE:\n    PARTS[what]()"
    none = subprocess.DEVNULL
    with suppress(OSError):
        return subprocess.Popen([sys.executable, "-c", command], cwd=ROOT, stdin=none, stdout=none, stderr=none)
    return None

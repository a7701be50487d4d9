"""Compile every kernel by using it once, with progress; `first_use` describes the cache."""

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
from data.inputs import ERRORS, Systematic
from data.log import Log
from data.wing import used, wings
from data.worlds.arena import Arena, simulate
from data.worlds.registry import named_log
from eval.compare import compare
from eval.plan.first_use import alone, is_compiled, kernels
from eval.replay.estimators import make_estimator
from eval.replay.hindsight.duplicates import Landmarks, recognize
from eval.replay.hindsight.placement import candidates
from eval.replay.hindsight.relocalize import Scan, relocalize
from eval.replay.run import step_by_step
from eval.replay.settings import ESTIMATORS, Setup

LONG = 60  # Frames after which hindsight has done all that it does


def _small(frames: int = 12) -> Log:
    """A small arena of skewed odometry, written and read, since the memory layout of its arrays selects kernels."""
    log = simulate(Arena(frames=frames, landmarks=6, scale=0.01), 0, name="warm")
    with tempfile.TemporaryDirectory() as folder:
        write_folder(log, Path(folder) / "warm")
        return load_folder(Path(folder) / "warm")


def _estimators() -> None:
    inputs = _small().inputs(labels=True)
    for setup in (Setup(), Setup(gate_known=0.9999)):
        compare(inputs, "localization", ESTIMATORS, setup=setup)
    errors = Systematic(tuple(ERRORS), np.full(len(ERRORS), 0.01))
    compare(replace(inputs, systematic=errors), "localization", ESTIMATORS)


def _methods() -> None:
    inputs = _small().inputs(labels=True)
    for method in METHODS:
        compare(inputs, "localization", ("ekf",), method)
    step_by_step("ekf", inputs, "localization")
    for name in ("ekf", "isam2"):
        estimator = make_estimator(name, inputs)
        estimator.update(inputs.frame_observations(0), np.full(len(inputs.frame_observations(0).z), -2))
        expectation = estimator.expect(inputs.frame_observations(0))
        expectation.joint(np.arange(len(expectation.number)))
        candidates(expectation, inputs.sensor, np.eye(3))


def _hindsight() -> None:
    """What takes more frames than the others: noise learned on the way, landmarks that stay or go."""
    for log in (_small(LONG), named_log(f"arena:0:frames={LONG}")):
        compare(log.inputs(labels=False).without_map(), "slam", ("ekf", "isam2", "batch"), "jcbb-hindsight")


def _place() -> None:
    place = _small().recorded.map
    assert place is not None
    n = len(place.id)
    relocalize(Scan(place.xy, 1e-4 * np.eye(2 * n), tuple((i,) for i in range(n))), place)
    same = Landmarks(place.xy, 1e-4 * np.eye(2 * n))
    recognize(same, same, np.zeros((2 * n, 2 * n)), np.ones((n, n), np.bool_), 0.01, 0.1, 1.0)


PARTS: dict[str, Callable[[], None]] = {
    "estimators": _estimators, "association": _methods, "hindsight": _hindsight, "place recognition": _place,
    **{name: partial(lambda part: used(part)(), part) for wing in wings() for name, part in wing.kernels.items()},
}  # fmt: skip
"""Parts to compile, in order."""


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
    """Compile every kernel, with progress, and write the mark; where another process does, wait (`background`: end)."""
    from tqdm import tqdm

    with alone(base(), wait=not background) as first:
        if first and kernels() == "compiled" and not is_compiled():
            silent = quiet or not sys.stderr.isatty()
            with tqdm(desc="compiling", total=len(PARTS), disable=silent, leave=False) as bar:
                for done, (what, part) in enumerate(PARTS.items()):
                    if bar.disable and not quiet:
                        sys.stderr.write(f"compiling, part {done + 1} of {len(PARTS)}: {what}\n")
                    bar.set_postfix_str(what)
                    part()
                    bar.update()
            with suppress(OSError):  # without the mark, the next run checks again
                for old in base().glob(mark().with_suffix(".*").name):
                    old.unlink()
                mark().touch()

"""Every public name has a docstring with an example, and every example runs."""

from __future__ import annotations

import doctest
import inspect

import numpy as np
import pytest

import slamref

CONSTANTS = ("NEW", "DISCARD", "__version__")
NAMES = [name for name in slamref.__all__ if name not in CONSTANTS]


@pytest.fixture(scope="module")
def shown():
    """What the examples take for granted: a log, its inputs, runs, a trial."""
    log = slamref.open_log("arena:0:frames=30")
    runs = slamref.compare(log.inputs(labels=True), "localization", ["ekf", "batch"])
    trial = slamref.Trial(log, "localization", tuple(runs))
    return {"slamref": slamref, "np": np, "log": log, "inputs": log.inputs(), "runs": runs, "trial": trial}


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_public_name_runs(name, shown, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("estimate.tum", "truth.tum"):
        (tmp_path / file).write_text("".join(f"{t} {t} {t * t} 0 0 0 0 1\n" for t in range(9)))
    text = inspect.getdoc(getattr(slamref, name)) or ""
    examples = doctest.DocTestParser().get_examples(text)
    assert examples, f"{name} has no example"
    space = dict(shown)
    for example in examples:
        exec(compile(example.source, f"<{name}>", "single"), space)

"""The first run after an installation costs little more than a later one; interpreted and compiled runs agree."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.research import first_minute

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow


def test_the_first_run_takes_less_than_four_times_the_processor_time_of_a_warm_one(record_property):
    rows = dict(first_minute.measure(here=True))
    for what, value in rows.items():
        record_property(what, value)
    assert float(rows["first run / warm run, to the end"]) < 4.0


def test_interpreted_kernels_give_the_numbers_of_compiled_ones(tmp_path):
    """Of the short half of the net; `last_step_sigma`, the rounding left at an optimum, may differ."""
    net = [sys.executable, "-m", "tests.net", "--short"]
    subprocess.run([*net, "--save", str(tmp_path / "compiled")], cwd=ROOT, check=False, capture_output=True)
    done = subprocess.run(
        [*net, "--against", str(tmp_path / "compiled"), "--tolerance", "1e-12"],
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        check=False,
        capture_output=True,
        text=True,
    )
    moved = [line for line in done.stdout.splitlines() if " off, " in line and "last_step_sigma" not in line]
    assert moved == []
    assert " cases, " in done.stdout

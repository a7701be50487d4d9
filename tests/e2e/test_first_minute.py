"""The first run after an installation costs little more than a later one; interpreted and compiled runs agree."""

from functools import partial

import pytest

from tests.builders.processes import python
from tests.research import first_minute

pytestmark = pytest.mark.slow


def test_the_first_run_takes_less_than_four_times_the_processor_time_of_a_warm_one(record_property):
    rows = dict(first_minute.measure(here=True))
    for what, value in rows.items():
        record_property(what, value)
    assert float(rows["first run / warm run, to the end"]) < 4.0


def test_interpreted_kernels_give_the_numbers_of_compiled_ones(tmp_path):
    """Of the short half of the net; `last_step_sigma`, the rounding left at an optimum, may differ."""
    net = partial(python, "-m", "tests.net", "--short")
    net("--save", tmp_path / "compiled")
    done = net("--against", tmp_path / "compiled", "--tolerance", "1e-12", NUMBA_DISABLE_JIT="1")
    moved = [line for line in done.stdout.splitlines() if " off, " in line and "last_step_sigma" not in line]
    assert moved == []
    assert " cases, " in done.stdout

"""Very many frames through every online estimator: memory and time of a frame stay, and so does what is estimated."""

import json
import subprocess
import sys

import pytest

from tests.faults.soak import CASES

FRAMES = {"filter": 100_000, "fixed-lag": 60_000}
"""By kind; up to a million of each are in `docs/reliability.md`."""
MOST = {"filter": 1.0, "fixed-lag": 12.0}
"""MB of growth: fixed-lag keeps slots of 2^17 factors, of 72 bytes each, before it uses them again."""
FAITHFUL = 0.5
"""m; the map and the path hold together, but where the origin is a filter forgets in the long run."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.constant])
def test_a_long_drive_costs_no_more_memory_nor_time_than_its_beginning(name):
    kind = "fixed-lag" if "fixed-lag" in name else "filter"
    words = [sys.executable, "-m", "tests.faults.soak", name, str(FRAMES[kind])]
    found = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    assert found["late_mb"] - found["early_mb"] < MOST[kind]
    assert found["late_ms"] < 2.0 * found["early_ms"] + 0.05
    assert found["asymmetry"] < 1e-12
    assert found["lowest"] > -1e-12
    assert found["error_m"] < FAITHFUL
    if name.startswith("localization"):
        assert 2.5 < found["nees"] < 3.5

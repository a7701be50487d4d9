"""Memory does not grow with the drive, but for a few bytes of a frame that the page may still ask for."""

from __future__ import annotations

import pytest

from tests.wings.robot.live.driven import FORK
from tests.wings.robot.live.soak import soak

FLAT = 5.0
"""MB that memory may differ from that after the first minute."""


def measured(name, seconds):
    """Rows of time [s] and memory [MB] of a process that does nothing else."""
    receiver, sender = FORK.Pipe(duplex=False)
    process = FORK.Process(target=lambda: sender.send(soak(name, seconds, 30.0)))
    process.start()
    sender.close()
    rows = receiver.recv()
    process.join()
    return rows


def check(name, seconds):
    rows = measured(name, seconds)
    after = [memory for t, memory in rows if t >= 60.0]
    assert rows[-1][0] >= seconds - 31.0
    assert max(after) - after[0] <= FLAT, rows
    assert after[0] - min(after) <= FLAT, rows


@pytest.mark.slow
def test_memory_is_flat_over_minutes():
    check("ekf", 120.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf", "fixed-lag"])
def test_memory_is_flat_over_two_hours(name):
    check(name, 7200.0)

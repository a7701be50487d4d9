"""Ctrl-C and SIGTERM are counted while the block runs, and are what they were before it afterwards."""

from __future__ import annotations

import signal

import pytest

from wings.robot.live.drive import Presses

BOTH = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture
def outside():
    """What arrives outside of any block; the signals' own ways to end a process are put back afterwards."""
    came: list[int] = []
    before = {s: signal.signal(s, lambda number, frame: came.append(number)) for s in BOTH}
    yield came
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", BOTH)
def test_a_press_in_the_block_is_counted_and_ends_nothing(outside, number):
    with Presses() as presses:
        assert presses.count == 0
        signal.raise_signal(number)
        assert presses.count == 1
        signal.raise_signal(number)
        assert presses.count == 2
    assert outside == []


@pytest.mark.parametrize("number", BOTH)
def test_once_presses_are_heeded_each_ends_the_work_and_is_counted(outside, number):
    with Presses() as presses:
        signal.raise_signal(number)
        presses.heed()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert presses.count == 2
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert presses.count == 3
    assert outside == []

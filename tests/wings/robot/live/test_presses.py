"""Ctrl-C and SIGTERM are counted while the block runs, and are what they were before it afterwards."""

from __future__ import annotations

import signal
import threading

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


def test_what_presses_did_before_they_do_again_after_an_error_in_the_block(outside):
    with pytest.raises(ZeroDivisionError), Presses():
        raise ZeroDivisionError
    for number in BOTH:
        signal.raise_signal(number)
    assert outside == list(BOTH)


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


def test_in_another_thread_than_the_main_one_signals_stay_as_they_are(outside):
    """Python lets no other thread set a handler."""
    counts, failures = [], []

    def work() -> None:
        try:
            with Presses() as presses:
                handlers.extend(signal.getsignal(s) for s in BOTH)
            counts.append(presses.count)
        except ValueError as error:
            failures.append(error)

    before = [signal.getsignal(s) for s in BOTH]
    handlers: list[object] = []
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert failures == []
    assert counts == [0]
    assert handlers == before

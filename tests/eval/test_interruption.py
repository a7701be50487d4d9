"""Ctrl-C ends a run, leaves what was there before, and says so by its status, whatever a library makes of it."""

from __future__ import annotations

import os
import signal
import time

from eval import run_all


def test_an_interruption_that_a_library_loses_is_heeded_all_the_same(tmp_path, monkeypatch):
    """Seen: an exception raised in a callback of compiled code was printed and forgotten, and the run went on."""

    def deaf(*_):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
        except KeyboardInterrupt:
            pass
        return 0

    monkeypatch.setattr(run_all, "_run", deaf)
    before = signal.getsignal(signal.SIGINT)
    assert run_all.main(["--log", "arena:0", "--out", str(tmp_path / "report")]) == 130
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is before

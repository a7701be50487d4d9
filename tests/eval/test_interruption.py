"""Ctrl-C ends a command as an interruption, whatever a library makes of the exception."""

from __future__ import annotations

import contextlib
import os
import signal
import time

import pytest

from data.terminal import INTERRUPTED
from eval import run_all
from eval.run_all import heeding_interruption


def press():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1)


def turned_into_another_exception():
    with heeding_interruption():
        try:
            press()
        except KeyboardInterrupt:
            raise SystemError("a compiled function returned a result with an exception set") from None


def lost():
    with heeding_interruption() as check:
        with contextlib.suppress(KeyboardInterrupt):
            press()
        check()


@pytest.mark.parametrize("work", [turned_into_another_exception, lost])
def test_a_library_cannot_hide_it(work):
    with pytest.raises(KeyboardInterrupt):
        work()


def test_pressed_while_the_command_line_is_read_it_is_not_lost(tmp_path, monkeypatch, capsys):
    read = run_all.read_options

    def pressed_while_modules_are_loaded(*arguments):
        with contextlib.suppress(KeyboardInterrupt):
            press()
        return read(*arguments)

    monkeypatch.setattr(run_all, "read_options", pressed_while_modules_are_loaded)
    words = ["--log", "linear:0", "--task", "slam", "--estimator", "ekf", "--out", str(tmp_path / "report")]
    assert run_all.main(words) == INTERRUPTED
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []

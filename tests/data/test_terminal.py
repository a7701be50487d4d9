"""What a person can mend ends a command with one line and status 2, whatever it is and wherever it happens."""

import errno
import os
import sys
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from data import terminal
from data.errors import DataError
from data.notice import Code, notice
from data.terminal import ended, missing
from data.words import NOTICES, environment, sentence

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def raising(fault):
    def body():
        raise fault

    return body


@pytest.mark.parametrize(("fault", "said"), [
    (DataError("log.csv:3: no number"), "slamref: log.csv:3: no number\n"),
    (FULL, "slamref: output cannot be written: No space left on device; free some space, or write to another place\n"),
    (PermissionError(errno.EACCES, "Permission denied", "out/a.csv"), "slamref: out/a.csv: Permission denied\n"),
    (OSError(errno.EROFS, "Read-only file system", "out"), "slamref: out: Read-only file system\n"),
    (ConnectionResetError("gone"), "slamref: gone\n"),
    (MemoryError("3 GiB"), "slamref: out of memory (3 GiB); a shorter log, or a machine with more memory would help\n"),
])  # fmt: skip
def test_it_is_one_line_and_status_2(fault, said, capsys):
    assert ended(raising(fault)) == 2
    assert capsys.readouterr() == ("", said)


def test_a_fault_of_the_program_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError):
        ended(raising(ZeroDivisionError()))


def test_an_interruption_has_its_own_status_and_words(capsys):
    assert ended(raising(KeyboardInterrupt()), lambda: "interrupted; 3 are kept") == 130
    assert capsys.readouterr().err == "interrupted; 3 are kept\n"


def test_what_was_printed_before_the_disk_was_full_is_said_once(monkeypatch, capsys):
    """Else the interpreter would try to flush it once more at its end, and fail with a traceback."""
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert ended(lambda: sys.stdout.write("many words\n") and None) == 2
        assert os.readlink(f"/proc/self/fd/{full.fileno()}") == os.devnull
    assert capsys.readouterr().err.count("\n") == 1


def test_a_reader_that_has_seen_enough_is_no_error(monkeypatch, capsys):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert ended(lambda: sys.stdout.write("many words\n") and None) == 0
    assert capsys.readouterr().err == ""


def test_a_broken_pipe_to_somebody_else_is_an_error(capsys):
    assert ended(raising(BrokenPipeError(errno.EPIPE, "Broken pipe"))) == 2
    assert capsys.readouterr().err == "slamref: Broken pipe\n"


def test_a_package_that_is_missing_is_named_with_the_way_to_install_it(monkeypatch, tmp_path, refused):
    said = refused(ended, raising(ModuleNotFoundError("No module named 'numba.core'", name="numba.core")))
    assert said.startswith(f"slamref: the package 'numba' is not installed for {sys.executable}; run `make venv` in ")
    monkeypatch.setattr(terminal, "ROOT", tmp_path)
    assert missing("gtsam").endswith("run `pip install slamref`, or `pip install .` in a checkout")
    assert "hides that of slamref" in missing("data.errors")


def test_every_code_has_its_words_and_nothing_else_has():
    macros = {name for name in vars(environment("data").get_template(NOTICES).module) if not name.startswith("_")}
    assert macros == {code.replace("-", "_") for code in Code}


def test_a_notice_is_said_with_its_values():
    assert sentence(notice(Code.REMOVED, landmarks=1)) == "1 landmark was removed from the map"


def test_a_value_that_a_template_does_not_know_is_an_error():
    with pytest.raises((TypeError, UndefinedError)):
        sentence(notice(Code.OUT_OF_MEMORY, size=3))


def test_a_notice_is_told_whom_it_is_about():
    found = notice(Code.OUT_OF_MEMORY).about(log="arena-0", estimator="ekf", frame=3)
    assert (found.log, found.estimator, found.frame) == ("arena-0", "ekf", 3)

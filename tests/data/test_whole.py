"""Files and folders appear whole or not at all, whatever ends the writing."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from data.whole import whole_file, whole_folder


class Interrupted(BaseException):
    pass


def names(folder):
    return sorted(p.name for p in folder.iterdir())


def filled(folder, text):
    with whole_folder(folder) as partial:
        (partial / "said").write_text(text)


def interrupted(writing, fault, half):
    with writing as partial:
        half(partial).write_text("half")
        raise fault


def test_a_file_takes_the_place_of_the_old_one_at_the_end(tmp_path):
    target = tmp_path / "seed.npz"
    target.write_text("old")
    with whole_file(target) as partial:
        np.savez(partial, a=1)  # which would add an ending of its own
        assert target.read_text() == "old"
    assert names(tmp_path) == ["seed.npz"]
    with np.load(target) as kept:
        assert kept["a"] == 1


@pytest.mark.parametrize("fault", [OSError, KeyboardInterrupt, Interrupted])
def test_what_ends_the_writing_leaves_the_old_file_and_nothing_beside_it(fault, tmp_path):
    target = tmp_path / "seed.npz"
    target.write_text("old")
    with pytest.raises(fault):
        interrupted(whole_file(target), fault, lambda partial: partial)
    assert names(tmp_path) == ["seed.npz"]
    assert target.read_text() == "old"


def test_a_folder_takes_the_place_of_the_old_one_with_all_that_is_in_it(tmp_path):
    filled(tmp_path / "a" / "b", "old")
    (tmp_path / "a" / "b" / "more").write_text("gone with it")
    filled(tmp_path / "a" / "b", "new")
    assert names(tmp_path / "a") == ["b"]
    assert names(tmp_path / "a" / "b") == ["said"]
    assert (tmp_path / "a" / "b" / "said").read_text() == "new"


@pytest.mark.parametrize("fault", [OSError, KeyboardInterrupt, Interrupted])
def test_what_ends_the_writing_leaves_the_old_folder_and_nothing_beside_it(fault, tmp_path):
    filled(tmp_path / "out", "old")
    with pytest.raises(fault):
        interrupted(whole_folder(tmp_path / "out"), fault, lambda partial: partial / "said")
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out" / "said").read_text() == "old"


@pytest.mark.parametrize(("step", "at", "said"), [("mkdir", 2, "old"), ("rename", 1, "old"), ("rename", 2, "new")])
def test_an_interruption_right_after_a_step_leaves_one_whole_folder(step, at, said, tmp_path, monkeypatch):
    filled(tmp_path / "out", "old")
    real, calls = getattr(Path, step), []

    def interrupting(self, *args, **options):
        calls.append(self)
        done = real(self, *args, **options)
        if len(calls) == at:
            raise KeyboardInterrupt
        return done

    with monkeypatch.context() as patched:
        patched.setattr(Path, step, interrupting)
        with pytest.raises(KeyboardInterrupt):
            filled(tmp_path / "out", "new")
    assert len(calls) >= at
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out" / "said").read_text() == said


def killed(folder, when):
    """A process that writes `folder` and kills itself: while writing, or between its two renames."""
    code = f"""
import os, signal
from pathlib import Path
from data.whole import whole_folder
real = Path.rename
def rename(self, to):
    if ".partial-" in self.name:
        os.kill(os.getpid(), signal.SIGKILL)
    return real(self, to)
Path.rename = rename
with whole_folder({str(folder)!r}) as partial:
    (partial / "said").write_text("half")
    if {when!r} == "writing":
        os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2]).returncode == -9


@pytest.mark.skipif(sys.platform == "win32", reason="kills itself the POSIX way")
@pytest.mark.parametrize("when", ["writing", "renaming"])
def test_the_next_writer_cleans_up_after_one_that_was_killed(when, tmp_path):
    filled(tmp_path / "out", "old")
    killed(tmp_path / "out", when)
    assert len(names(tmp_path)) > 1, "a killed process cannot clean up"
    with pytest.raises(Interrupted):
        interrupted(whole_folder(tmp_path / "out"), Interrupted, lambda partial: partial / "said")
    assert names(tmp_path) == ["out"]
    assert (tmp_path / "out" / "said").read_text() == "old"


def test_what_a_running_process_writes_is_left_alone(tmp_path):
    with whole_folder(tmp_path / "out") as partial:
        code = f"from data.whole import whole_folder\nwith whole_folder({str(tmp_path / 'out')!r}): pass"
        subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2], check=True)
        assert partial.is_dir()

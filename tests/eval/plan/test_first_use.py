"""The first run: a small log is interpreted at once, while one child process compiles; Ctrl-C ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import slamref
from data.formats.open_log import write_folder
from eval.plan import first_use
from eval.plan.flags.options import read_options

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(("words", "small"), [
    (["arena:0"], True),
    (["arena:0", "--task", "localization,slam"], True),
    (["arena:0:frames=60", "corridor:1:people+no-odometry", "linear:0"], True),
    (["corridor:0:people", "--association", "known,nn,jcbb,jcbb-hindsight"], True),
    (["arena:0:frames=5000"], False),
    (["arena:0:landmarks=500"], False),
    (["circle:0"], False),
    (["victoria-park"], False),
    (["arena:0", "--twins", "20"], False),
    (["arena:0", "--calibrate"], False),
    (["--lab", "corridor:0"], False),
    (["--scenario", "arena"], False),
    ([], False),
])  # fmt: skip
def test_what_is_small_is_known_before_the_log_is_opened(words, small):
    assert first_use.is_small(read_options(words)) == small


def test_the_observations_of_a_folder_are_counted(tmp_path):
    log = slamref.open_log("arena:0:frames=20")
    write_folder(log, tmp_path / "log")
    assert first_use.observations(str(tmp_path / "log")) == len(log.recorded.observations.frame) + 1
    (tmp_path / "log" / "scans.csv").write_text("")
    assert first_use.observations(str(tmp_path / "log")) == float("inf")
    assert first_use.observations(str(tmp_path / "none")) == float("inf")


def test_only_one_process_compiles_at_a_time(tmp_path):
    with first_use.alone(tmp_path, wait=False) as first:
        assert first
        with first_use.alone(tmp_path, wait=False) as second:
            assert not second
    with first_use.alone(tmp_path, wait=False) as again:
        assert again


def test_where_nothing_can_be_written_everybody_may_compile(tmp_path):
    (tmp_path / "file").write_text("")
    with first_use.alone(tmp_path / "file" / "cache", wait=False) as first:
        assert first


FIRST_RUN = """
import sys, subprocess
from pathlib import Path
from eval.plan import first_use
from eval import run_all

def child():
    started = subprocess.Popen(["sleep", "60"], stdout=subprocess.DEVNULL)
    first_use._children.append(started)
    Path(sys.argv[-1]).with_name("child").write_text(str(started.pid))

first_use.is_compiled = lambda: False
first_use.compile_in_background = child
status = run_all.main(sys.argv[1:])
print("kernels", first_use.kernels())
sys.exit(status)
"""


def first_run(tmp_path: Path) -> subprocess.Popen[str]:
    words = ["arena:0:frames=30", "--estimator", "ekf", "--no-plots", "--out", str(tmp_path / "out")]
    environment = {k: v for k, v in os.environ.items() if k != first_use.INTERPRETED}
    return subprocess.Popen(
        [sys.executable, "-c", FIRST_RUN, *words], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    )


def is_running(pid: int) -> bool:
    """Whether a process is there and has not ended."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0]
    except FileNotFoundError:
        return False
    return state != "Z"


@pytest.mark.slow
def test_a_first_run_says_so_and_is_interpreted_and_its_child_goes_on(tmp_path):
    run = first_run(tmp_path)
    said, _ = run.communicate()
    assert run.returncode == 0
    lines = said.splitlines()
    assert lines[0] == first_use.NOTICE
    assert lines[-1] == "kernels interpreted"
    assert '"kernels": "interpreted"' in (tmp_path / "out" / "provenance.json").read_text()
    child = int((tmp_path / "child").read_text())
    assert is_running(child)
    os.kill(child, signal.SIGTERM)

"""Killed at any instant, out of disk anywhere, two at once: what was whole stays so, and nothing half-made is left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
LOG = ["--log", "arena:0:frames=40", "--estimator", "ekf,batch", "--association", "known,jcbb"]
QUIET = ["--no-plots", "--runs", "0", "--jobs", "1", "-q"]
SCENARIO = """
about = "a small arena"
task = ["localization"]
[world]
kind = "arena"
frames = 30
landmarks = 10
[estimators]
ekf = {}
batch = {}
"""
INSTANTS = 40
PATIENCE = 300.0

pytestmark = pytest.mark.slow


def started(*words):
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    command = [sys.executable, "-m", "eval.run_all", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, start_new_session=True, **streams)


def done(*words):
    process = started(*words)
    _, said = process.communicate(timeout=PATIENCE)
    return process.returncode, said


def contents(folder):
    """Files by name, without what tells the time."""
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name not in ("timing.csv", "provenance.json", "run.log", "report.html", "report.md")
    }


def killed(words, instant):
    """The command, killed with all its children after so long [s], unless it ended before."""
    process = started(*words)
    try:
        process.wait(instant)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=PATIENCE)


def beside(folder):
    return sorted(p.name for p in folder.parent.iterdir() if p != folder)


def duration(words):
    begin = time.monotonic()
    assert done(*words)[0] == 0
    return time.monotonic() - begin


def test_a_report_that_is_killed_at_any_instant_leaves_the_old_one_or_the_new_one(tmp_path):
    out, other = tmp_path / "a" / "report", tmp_path / "b" / "report"
    old_words = ["--log", "arena:1:frames=40", "--estimator", "ekf", *QUIET, "--out", out]
    new_words = [*LOG, *QUIET, "--out", out]
    assert done(*old_words)[0] == 0
    old = contents(out)
    lasts = duration([*LOG, *QUIET, "--out", other])
    new = contents(other)
    rng, seen = np.random.default_rng(0), set()
    for instant in (*rng.uniform(0.0, 1.1 * lasts, INSTANTS), PATIENCE):  # the last ends by itself, however busy it is
        killed(new_words, instant)
        if out.exists():
            found = contents(out)
            assert found in (old, new), instant
            seen.add(found == new)
        else:  # died between the two renames: the old one waits beside and comes back with the next run
            assert any(".old-" in name for name in beside(out)), instant
        if seen and found == new:
            assert done(*old_words)[0] == 0
    assert seen == {True, False}
    assert done(*old_words)[0] == 0
    assert contents(out) == old
    assert beside(out) == []


def test_a_study_that_is_killed_at_any_instant_goes_on_and_ends_as_if_it_had_not_been(tmp_path):
    scenario = tmp_path / "small.toml"
    scenario.write_text(SCENARIO)
    out, other = tmp_path / "a" / "study", tmp_path / "b" / "study"
    words = ["--scenario", scenario, "--runs", "300", "--no-plots", "--jobs", "1", "-q", "--out"]
    lasts = duration([*words, other])
    for instant in np.random.default_rng(1).uniform(0.0, lasts / 10.0, INSTANTS):
        killed([*words, out], instant)
    assert done(*words, out)[0] == 0
    assert contents(out) == contents(other)
    assert beside(out) == [".studies"]
    assert not [p for p in (out.parent / ".studies").rglob("*") if "partial" in p.name]


@pytest.fixture
def small_disk(tmp_path):
    """`small_disk(kilobytes)`: a folder on a disk of that size; one at a time."""
    mounted = []

    def make(kilobytes):
        if mounted:
            subprocess.run(["umount", mounted.pop()], check=True)
        folder = tmp_path / "disk"
        folder.mkdir(exist_ok=True)
        command = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("a disk of a size of one's own needs the right to mount one")
        mounted.append(str(folder))
        return folder

    yield make
    for folder in mounted:
        subprocess.run(["umount", folder], check=True)


def test_a_disk_that_is_full_at_any_write_is_one_line_and_leaves_nothing(small_disk, tmp_path):
    words = [*LOG, *QUIET, "--out"]
    assert done(*words, tmp_path / "report")[0] == 0
    whole = sum(-(-p.stat().st_size // 4096) * 4 for p in (tmp_path / "report").rglob("*") if p.is_file())
    ends = set()
    for kilobytes in np.unique(np.linspace(4, whole + 60, 20).astype(int) // 4 * 4).tolist():
        disk = small_disk(kilobytes)
        status, said = done(*words, disk / "report")
        ends.add(status)
        if status == 2:
            assert "No space left on device" in said, kilobytes
            assert said.count("\n") == 1, said
            assert list(disk.iterdir()) == [], kilobytes
        else:
            assert status == 0, said
            assert contents(disk / "report") == contents(tmp_path / "report")
    assert ends == {0, 2}


def test_two_processes_into_one_folder_leave_one_whole_report(tmp_path):
    out, one, two = tmp_path / "r" / "report", tmp_path / "one", tmp_path / "two"
    first = [*LOG, *QUIET, "--out"]
    second = ["--log", "arena:1:frames=40", "--estimator", "ekf", *QUIET, "--out"]
    assert done(*first, one)[0] == done(*second, two)[0] == 0
    whole = [contents(one), contents(two)]
    for _ in range(5):
        both = [started(*first, out), started(*second, out)]
        ends = [(p.communicate(timeout=PATIENCE)[1], p.returncode) for p in both]
        assert {status for _, status in ends} <= {0, 2}, ends
        assert any(status == 0 for _, status in ends)
        assert all(said.count("\n") == 1 for said, status in ends if status == 2), ends
        assert contents(out) in whole
        assert beside(out) == []

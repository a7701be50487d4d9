"""Jobs go where they should and come back; the first run interprets while a child compiles, after `warm` none does."""

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import slamref
from data.formats.open_log import write_folder
from data.logs import open_log
from data.notice import Code
from data.result import Failure
from eval.plan import console as told, first_use, warming, work as works
from eval.plan.console import progress, say_kept
from eval.plan.experiment import estimate
from eval.plan.flags.options import read_options
from eval.plan.work import KILLED, Job, OutOfMemoryError, work
from eval.replay.recorder import missing_run
from eval.run_all import main
from tests.eval.plan.jobs import killed, squared, stays, too_large

ADDRESS = "tcp://10.0.0.7:8786"


def options(*arguments):
    return read_options([*arguments]).execution


@pytest.fixture
def cluster(monkeypatch):
    """A cluster that does the jobs given to it, the last one first; its list says by which address it was reached."""
    reached = []

    def on_cluster(address, calls):
        reached.append(address)
        for i in reversed(range(len(calls))):
            function, arguments = calls[i]
            yield i, function(*arguments)

    monkeypatch.setattr(works, "on_cluster", on_cluster)
    return reached


def test_jobs_go_to_the_cluster_or_stay_here_and_each_result_goes_to_its_owner(cluster):
    jobs = [Job(f"job {x}", squared, (x,)) for x in (3, 4, 5)]
    done = list(work(jobs, options("--scheduler", ADDRESS), far=True))
    assert done == [("job 5", 25), ("job 4", 16), ("job 3", 9)]
    assert cluster == [ADDRESS]


def test_a_far_job_without_enough_memory_is_lost_alone(cluster):
    jobs, lost = [Job(0, squared, (3,)), Job(1, too_large, (0,))], {}
    assert list(work(jobs, options("--scheduler", ADDRESS), far=True, lost=lost.__setitem__)) == [(0, 9)]
    assert {k: (why.code, why.named) for k, why in lost.items()} == {
        1: (Code.OUT_OF_MEMORY, {"detail": "Unable to allocate 728. TiB"})
    }
    with pytest.raises(OutOfMemoryError, match=r"728\. TiB\); fewer processes \(--jobs 1\) or a shorter log"):
        list(work(jobs, options("--scheduler", ADDRESS), far=True))


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_started_them_however_it_ends(how):
    """Seen: two held their memory for 50 minutes, two computed on. They hold the pipe, so its end is theirs."""
    code = "from tests.eval.plan.jobs import two_compute_on; two_compute_on()"
    root = Path(__file__).parents[3]
    with subprocess.Popen([sys.executable, "-c", code], cwd=root, stdout=subprocess.PIPE, text=True) as parent:
        begun = [parent.stdout.readline() for _ in range(2)]
        parent.send_signal(how)
        assert begun == ["begun\n"] * 2
        assert parent.communicate(timeout=120.0) == ("", None)


@pytest.mark.slow
def test_a_killed_process_and_an_array_too_large_take_nothing_else_with_them():
    jobs = [Job(i, squared, (i,)) for i in range(3)]
    jobs += [Job("killed", killed, (0,)), Job("large", too_large, (0,)), Job("stays", stays, ())]
    lost = {}
    done = dict(work(jobs, options("--jobs", "2"), lost=lost.__setitem__))
    # workers are not replaced when they have grown, which loky would warn of
    assert done == {0: 0, 1: 1, 2: 4, "stays": (False, math.inf)}
    assert lost["killed"] == KILLED
    assert lost["large"].named["detail"].startswith("Unable to allocate 728. TiB")


def test_where_nobody_can_do_without_it_is_an_error_of_one_line():
    with pytest.raises(OutOfMemoryError, match="ran out of memory"):
        list(work([Job(0, too_large, (0,))], options("--jobs", "1")))


@pytest.fixture
def isam2_needs_more(monkeypatch):
    def hungry(experiment, part, watched=False):
        if "isam2" in part.estimators:
            raise MemoryError("Unable to allocate 9.2 GiB")
        return estimate(experiment, part, watched)

    monkeypatch.setattr("eval.plan.execute.estimate", hungry)


@pytest.mark.slow
def test_what_has_not_enough_memory_is_incomplete_and_all_the_rest_is_kept(isam2_needs_more, tmp_path, capsys):
    out = tmp_path / "out"
    asked = ["--log", "arena:0", "--task", "slam", "--estimator", "ekf,isam2,batch", "--association", "known,jcbb"]
    assert main([*asked, "--jobs", "1", "--no-plots", "--out", str(out), "-q"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("slamref: arena:0, slam, known: isam2: no run: it ran out of memory")
    assert lines[0].endswith("(Unable to allocate 9.2 GiB); use a shorter log, or a machine with more memory")
    rows = [r.split(",") for r in (out / "metrics.csv").read_text().splitlines()]
    # with jcbb, batch takes its decisions from isam2
    assert [(r[3], r[2], r[4], r[5]) for r in rows[1:]] == [
        ("known", "ekf", "online", "ok"), ("known", "isam2", "online", "incomplete"),
        ("known", "isam2", "final", "incomplete"), ("known", "batch", "final", "ok"),
        ("jcbb", "ekf", "online", "ok"), ("jcbb", "isam2", "online", "incomplete"),
        ("jcbb", "isam2", "final", "incomplete"), ("jcbb", "batch", "final", "incomplete"),
    ]  # fmt: skip
    report = (out / "report.md").read_text()
    assert "isam2 with association known is incomplete, stopped at frame 0: it ran out of memory" in report
    assert "Missing, because memory was not sufficient:" in report


def test_what_is_kept_is_said(capsys):
    say_kept(3, 5, quiet=False)
    say_kept(3, 5, quiet=True)
    say_kept(0, 5, quiet=False)
    assert capsys.readouterr().err == "3 of 5 runs are kept from before and are not repeated\n"


def lines_of(jobs, seconds, capsys, quiet=False):
    with progress("estimating", quiet, lambda: None) as update:
        update(0, jobs)
        for done in range(1, jobs + 1):
            time.sleep(seconds)
            update(done, jobs)
    return capsys.readouterr().err.splitlines()


def test_a_long_command_writes_a_line_each_minute(monkeypatch, capsys):
    monkeypatch.setattr(told, "EVERY", 0.2)
    assert 2 <= sum(" of 10 runs after 00:0" in line for line in lines_of(10, 0.08, capsys)) <= 5
    assert lines_of(2, 0.01, capsys) == lines_of(10, 0.03, capsys, quiet=True) == []


@pytest.mark.parametrize(("name", "association", "phases"), [
    ("dead-reckoning", "none", ("online",)), ("ekf", "jcbb", ("online",)), ("isam2", "jcbb", ("online", "final")),
    ("batch", "jcbb", ("final",)),
])  # fmt: skip
def test_it_has_the_name_the_association_and_the_phases_it_would_have_had(name, association, phases):
    run = missing_run(name, "jcbb", "slam", open_log("arena:0").inputs(), Failure("incomplete", 0, KILLED))
    assert (run.estimator, run.association, run.task, run.phases) == (name, association, "slam", phases)
    assert run.status == "incomplete"
    assert (run.flaw.frame, run.flaw.notice) == (0, KILLED)


def test_place_recognition_is_run_on_a_small_log_that_was_read_from_a_folder(monkeypatch):
    asked = []
    monkeypatch.setattr(warming, "relocalize", lambda scan, place: asked.append((scan, place)))
    warming.PARTS["place recognition"]()
    ((scan, place),) = asked
    np.testing.assert_array_equal(scan.xy, place.xy)
    assert len(place.id) == 6
    assert scan.covariance.shape == (12, 12)
    assert scan.rows == tuple((i,) for i in range(6))


ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(("words", "small"), [
    (["arena:0"], True), (["arena:0", "--task", "localization,slam"], True),
    (["arena:0:frames=60", "corridor:1:people+no-odometry", "linear:0"], True),
    (["corridor:0:people", "--association", "known,nn,jcbb,jcbb-hindsight"], True), (["arena:0:frames=5000"], False),
    (["arena:0:landmarks=500"], False), (["circle:0"], False), (["victoria-park"], False),
    (["arena:0", "--twins", "20"], False), (["arena:0", "--calibrate"], False), (["--lab", "corridor:0"], False),
    (["--scenario", "arena"], False), ([], False),
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


RUNS = [["arena:0"], ["arena:0:frames=100", "--task", "slam", "--calibrate", "auto"]]


@pytest.mark.slow
def test_every_kernel_that_a_run_uses_is_compiled_by_warm(tmp_path):
    env = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")} | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def kernels(*words):
        done = subprocess.run([sys.executable, "-m", *words], cwd=ROOT, env=env, capture_output=True, text=True)
        assert done.returncode in (0, 1), done.stderr
        return {f.name for f in tmp_path.rglob("*.nbc")}

    warmed = kernels("eval.warm")
    assert len(warmed) > 80
    for words in RUNS:
        assert kernels("eval.run_all", *words, "--out", str(tmp_path / "out")) == warmed, words

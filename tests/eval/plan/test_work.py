"""Jobs go where they should, and each result comes back to its owner."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from data.notice import Code
from eval.plan import work as works
from eval.plan.flags.options import read_options
from eval.plan.work import Job, OutOfMemoryError, work
from tests.eval.plan.jobs import squared, too_large

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


def test_a_cluster_gets_the_far_jobs_and_each_result_goes_to_its_owner(cluster):
    jobs = [Job(f"job {x}", squared, (x,)) for x in (3, 4, 5)]
    done = list(work(jobs, options("--scheduler", ADDRESS), far=True))
    assert done == [("job 5", 25), ("job 4", 16), ("job 3", 9)]
    assert cluster == [ADDRESS]


def test_what_is_not_far_is_done_here_and_without_jobs_nobody_is_asked(cluster):
    asked = options("--scheduler", ADDRESS, "--jobs", "1")
    assert list(work([Job("near", squared, (3,))], asked)) == [("near", 9)]
    assert list(work([Job("far", squared, (4,))], options("--jobs", "1"), far=True)) == [("far", 16)]
    assert list(work([], asked, far=True)) == []
    assert cluster == []


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
        assert [parent.stdout.readline() for _ in range(2)] == ["begun\n"] * 2
        parent.send_signal(how)
        assert parent.communicate(timeout=120.0) == ("", None)

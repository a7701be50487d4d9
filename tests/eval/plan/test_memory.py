"""Too little memory: only what needs more is missing, it is said in a line, and the exit status is 2."""

from __future__ import annotations

import math

import pytest

from eval.plan import work as works
from eval.plan.experiment import estimate
from eval.plan.flags.options import read_options
from eval.plan.work import KILLED, Job, OutOfMemoryError, work
from eval.run_all import main
from tests.eval.plan.jobs import killed, squared, stays, too_large


def options(*arguments):
    return read_options([*arguments]).execution


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
    """Every job with iSAM2 has not enough memory; processes of their own are this one."""

    def hungry(experiment, part, watched=False):
        if "isam2" in part.estimators:
            raise MemoryError("Unable to allocate 9.2 GiB")
        return estimate(experiment, part, watched)

    monkeypatch.setattr("eval.plan.execute.estimate", hungry)
    monkeypatch.setattr("eval.plan.experiment.estimate", hungry)
    monkeypatch.setattr(works, "_one_at_a_time", lambda calls, processes: works._together(calls, 1))


@pytest.mark.slow
def test_estimators_are_tried_one_by_one_and_all_the_rest_is_kept(isam2_needs_more, tmp_path, capsys):
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

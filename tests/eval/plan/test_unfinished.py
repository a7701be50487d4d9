"""A run of which nothing is left but the reason."""

from __future__ import annotations

import pytest

from data.logs import open_log
from eval.plan.experiment import incomplete
from eval.plan.work import KILLED


@pytest.mark.parametrize(
    ("name", "association", "phases"),
    [
        ("dead-reckoning", "none", ("online",)),
        ("ekf", "jcbb", ("online",)),
        ("isam2", "jcbb", ("online", "final")),
        ("batch", "jcbb", ("final",)),
    ],
)
def test_it_has_the_name_the_association_and_the_phases_it_would_have_had(name, association, phases):
    run = incomplete(name, "jcbb", "slam", open_log("arena:0").inputs(), KILLED)
    assert (run.estimator, run.association, run.task, run.phases) == (name, association, "slam", phases)
    assert run.status == "incomplete"
    assert (run.flaw.frame, run.flaw.notice) == (0, KILLED)

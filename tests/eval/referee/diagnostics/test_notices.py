"""Notices of logs and of failed, implausible and lost runs, as a list and as a table."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from data.notice import Code, Severity, notice, stopped
from data.result import Failure
from eval.referee.diagnostics import notices, notices_table
from eval.referee.score import Trial
from tests.eval.handmade import SIGMA, circle_log, run_with_error

LOG = circle_log()


def found(run):
    return notices([Trial(LOG, "slam", (run,))])


def test_a_run_that_stopped_says_why_and_where():
    run = run_with_error(np.zeros(3), failure=Failure("diverged", 3, stopped("not positive definite")))
    (why,) = [n for n in found(run) if n.severity is Severity.ERROR]
    assert (why.code, why.log, why.task, why.estimator) == (Code.STOPPED, LOG.name, "slam", "ekf")
    assert (why.frame, why.named) == (3, {"text": "not positive definite"})


def test_an_implausible_run_says_why_and_where_it_probably_began():
    flaw = Failure("implausible", 2, notice(Code.NIS, per_dof=400.0, over_run=True))
    run = replace(run_with_error(np.zeros(3)), implausible=flaw)
    assert [n.code for n in found(run)][:2] == [Code.NIS, Code.ORIGIN]


def test_a_lost_run_says_why():
    run = replace(run_with_error(4.0 * SIGMA), total_nis=(1010.0, 10))
    why = notice(Code.NIS, 0, per_dof=101.0, over_run=False).about(
        log=LOG.name, task="slam", estimator="ekf", association="known"
    )
    assert why in found(run)
    # not one that is where it claims to be
    assert why not in found(replace(run_with_error(np.zeros(3)), total_nis=(1010.0, 10)))


def test_the_table_has_values_as_json_and_the_sentence():
    (row,) = notices_table(
        [notice(Code.MATCHED, poses=7, matched=7, between=1, error=np.nan).about(log="home")]
    ).to_dict("records")
    assert json.loads(row["values"]) == {"between": 1, "error": None, "matched": 7, "poses": 7}
    assert (row["code"], row["severity"], row["log"]) == ("matched", "info", "home")
    assert row["text"].startswith("7 of 7 poses matched with the truth")
    assert notices_table([]).columns[0] == "code"

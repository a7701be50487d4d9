"""The report of a small corridor lab, from the command: its sections, tables and answers stand in order."""

from __future__ import annotations

import pytest

from eval.run_all import main


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    out = tmp_path_factory.mktemp("lab") / "report"
    logs = [a for name in ("arena:0", "corridor:0", "corridor:0:people") for a in ("--log", name)]
    methods = ["--estimator", "ekf", "--association", "known,nn,jcbb", "--task", "slam"]
    assert main([*logs, *methods, "--runs", "0", "--no-plots", "--jobs", "1", "--quick", "--out", str(out), "-q"]) == 0
    return out


def test_decisions_and_questions_follow_the_logs(report):
    text = (report / "report.md").read_text()
    heads = [line for line in text.splitlines() if line.startswith("#")]
    assert heads == [
        "# Filter or smoother: which estimate can be trusted?", "## Warnings",
        "## arena:0, slam", "## arena:0, slam: details", "### Decisions: arena:0, slam",
        "## corridor:0, slam", "## corridor:0, slam: details", "### Decisions: corridor:0, slam",
        "## corridor:0:people, slam", "## corridor:0:people, slam: details", "### Decisions: corridor:0:people, slam",
        "## The lab's questions", "### Why does NN fail?", "### Why do people break NN and SINGLES?",
        "### Why does JCBB cope better?", "### What happens without odometry?", "### What does map maintenance change?",
        "## Logs and settings", "## How to read this", "## Overview with every column",
    ]  # fmt: skip


def test_the_answers_have_the_referees_counts(report):
    rows = [line.split(",") for line in (report / "association.csv").read_text().splitlines()]
    nn = next(r for r in rows if r[0] == "corridor:0" and r[3:5] == ["nn", "online"])
    text = (report / "report.md").read_text()
    tp, fp = (int(nn[rows[0].index(c)]) for c in ("tp", "fp"))
    assert f"NN (ekf) makes {fp} wrong pairings out of {tp + fp}" in text
    assert "Not answered: this needs a log of the corridor without people, without odometry" in text


def test_each_log_has_its_own_table_of_decisions(report):
    table = (report / "tables" / "corridor_0-slam-association.csv").read_text().splitlines()
    assert table[0].startswith("association,estimator,TP,TN,FP,FN,precision [%],recall [%]")
    assert [line.split(",")[0] for line in table[1:]] == ["known", "nn", "jcbb"]

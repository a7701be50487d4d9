"""Questions about a run: unused observations and too many landmarks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from data.inputs import Inputs, Prior
from data.log import Log
from data.notice import Code, Severity
from data.worlds.arena import Arena, simulate
from eval.inspect import main as inspect
from eval.referee.diagnostics import crowded, notices
from eval.referee.lost import unused
from eval.referee.score import Trial
from eval.replay.run import compare
from eval.report.words import together
from eval.report.writing import warnings_section
from eval.run_all import main
from tests.quick import slow


@cache
def arena() -> Log:
    return simulate(Arena(frames=150, landmarks=24), 0)


def overconfident(inputs: Inputs) -> Inputs:
    """Sigmas stated as half of what they are."""
    o, steps = inputs.observations, inputs.increments
    return replace(
        inputs,
        map=None,
        observations=replace(o, R=o.R / 4.0),
        increments=replace(steps, covariance=steps.covariance / 4.0),
    )


def lost() -> Log:
    r = arena().recorded
    return replace(arena(), recorded=replace(r, prior=Prior(r.prior.mean + [300.0, 0.0, 0.0], r.prior.covariance)))


def test_a_map_with_several_landmarks_for_one_cone_is_asked_about():
    inputs = overconfident(arena().recorded)
    run = compare(inputs, "slam", ("ekf",), "jcbb")[0]
    question = crowded(run, inputs)
    cones = len(np.unique(arena().truth.landmark_of))
    assert len(run.map) > 2 * cones
    assert question.code is Code.LANDMARKS
    assert question.named["landmarks"] == len(run.map)
    (section,) = warnings_section([question])
    assert section.blocks[1].endswith("another --association.")


@pytest.mark.parametrize("association", ["known", "jcbb", slow("jcbb-hindsight")])
def test_a_right_map_is_not_asked_about(association):
    inputs = arena().inputs(labels=association == "known").without_map()
    run = compare(inputs, "slam", ("ekf",), association)[0]
    assert crowded(run, inputs) is unused(run, inputs) is None


def test_a_run_that_used_nothing_says_so_in_the_headline():
    log = lost()
    runs = compare(log.recorded, "localization", ("dead-reckoning", "ekf", "batch"), "jcbb")
    trial = Trial(log, "localization", tuple(runs))
    seen = len(log.recorded.observations.z)
    assert unused(runs[0]) is None
    assert all(
        unused(run).named == {"used": 0, "readings": seen, "task": "localization", "moves": True} for run in runs[1:]
    )
    found = [n for n in together(notices([trial])) if n.severity is Severity.WARNING]
    assert [(n.code, n.estimator) for n in found if n.task] == [(Code.UNUSED, "ekf, batch")]
    assert Code.PRIOR in [n.code for n in found]
    (section,) = warnings_section(found)
    assert "**prior**" in section.blocks[1]
    assert "**unused**" in section.blocks[1]


def test_questions_stand_in_inspect_on_the_terminal_in_the_log_and_in_the_report(tmp_path, capsys):
    from data.formats.open_log.writer import write_folder

    write_folder(lost(), tmp_path / "lost")
    assert inspect([str(tmp_path / "lost")]) == 0
    assert "question" in capsys.readouterr().out
    out = tmp_path / "report"
    words = [
        "--log",
        str(tmp_path / "lost"),
        "--estimator",
        "ekf",
        "--association",
        "nn",
        "--no-plots",
        "--out",
        str(out),
    ]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "warning: from the prior" in said
    assert "observations are used" in said
    assert "(lost, prior)" in (out / "run.log").read_text()
    report = (out / "report.md").read_text()
    row = next(line for line in report.splitlines() if line.startswith("| [lost, localization]"))
    assert "✗ **neither** (ekf lost from frame 0)" in row
    section = report.partition("## lost, localization")[2]
    assert "ekf (nn): 0 of" in section[: section.index("<details>")]
    assert "## Warnings" in report

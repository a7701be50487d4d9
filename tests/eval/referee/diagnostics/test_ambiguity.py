"""The report counts ambiguous landmarks."""

from __future__ import annotations

import pytest

from data.notice import Code
from data.worlds.corridor import Corridor, simulate
from eval.figures.map import map_figure
from eval.referee.diagnostics import ambiguity_of
from eval.referee.score import Trial
from eval.replay.run import compare
from eval.report.publish import write_run

LOG = simulate(Corridor(people=True), 0)


@pytest.fixture(scope="module")
def trial():
    return Trial(LOG, "slam", tuple(compare(LOG.inputs(), "slam", ["ekf"], "jcbb")))


def legend(fig):
    return [text.get_text() for each in fig.legends for text in each.get_texts()]


def test_ambiguous_landmarks_are_reported_written_and_marked(trial, tmp_path):
    (found,) = ambiguity_of(trial.runs[0], LOG.recorded)
    assert (found.code, found.named) == (Code.AMBIGUOUS, {"ambiguous": 2, "landmarks": 109})
    assert "ambiguous landmarks" in legend(map_figure(LOG, trial.runs))
    write_run(tmp_path, trial, trial.runs[0])
    (path,) = tmp_path.rglob("landmarks.csv")
    head, *rows = [line.split(",") for line in path.read_text().splitlines()]
    named = {row[0]: row[-2] for row in rows if row[-2]}
    assert head[-2:] == ["ambiguous", "until"]
    assert len(named) == 2
    assert all(named[other] == number for number, other in named.items())

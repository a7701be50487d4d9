"""What was revised is counted, and one example of it is shown."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from data.result import DISCARD, NEW, Event
from data.worlds.registry import named_log
from eval.figures.revision import revision_figure
from eval.figures.style import save
from eval.referee.score import Trial
from eval.replay.hindsight.ledger import MERGED
from eval.replay.run import compare
from eval.report.revisions import example, revising, tally
from tests.eval.handmade import run_with_error


def revising_run(*events):
    """A run over six observations; who was taken for new had initialized landmark 7."""
    rows = [e.observation for e in events]
    decisions, created = np.full(6, DISCARD), np.full(6, -1)
    decisions[rows] = [e.old for e in events]
    created[rows] = np.where([e.old == NEW for e in events], 7, -1)
    return replace(run_with_error(np.zeros(3)), decisions=decisions, created=created, events=tuple(events))


@pytest.fixture(scope="module")
def people():
    log = named_log("corridor:4:people")
    return log, compare(log.inputs(), "slam", ["ekf", "isam2"], "jcbb-hindsight")


def test_counts_are_those_of_the_events(people):
    _, runs = people
    row = tally(runs[0])
    undone = [e for e in runs[0].events if e.old >= 0]
    assert row["pairings undone"] == str(len(undone))
    assert row["made instead"] == "0"
    assert row["retracted"].startswith(str(sum(e.old == NEW for e in runs[0].events)) + " (")
    assert row["landmarks merged"] == "0"


def test_estimators_with_the_same_revisions_share_a_row(people):
    log, runs = people
    assert [names for _, names in revising(Trial(log, "slam", tuple(runs)))] == ["ekf, isam2"]
    assert revising(Trial(log, "slam", tuple(compare(log.inputs(), "slam", ["ekf"], "jcbb")))) == []


def test_the_example_is_not_what_the_end_of_the_log_took_back(people):
    one = example(people[1][0])
    assert one.why in {"missed", "moved"}
    assert len(set(one.old.tolist())) == 1
    assert (one.new == DISCARD).all()


def test_merged_landmarks_are_shown_before_others():
    run = revising_run(
        Event(3, 0, 5, 4, "another hypothesis leads"), Event(3, 1, 5, 4, "another hypothesis leads"),
        Event(3, 2, 5, 4, "another hypothesis leads"),
        Event(5, 3, NEW, 2, MERGED), Event(5, 4, 7, 2, MERGED), Event(9, 5, 1, DISCARD, "uncertain"),
    )  # fmt: skip
    one = example(run)
    assert (one.frame, one.why) == (5, MERGED)
    assert one.old.tolist() == [7, 7]
    assert one.new.tolist() == [2, 2]
    row = tally(run)
    assert [row[k] for k in ("pairings undone", "made instead", "landmarks merged")] == ["5", "4", "1"]
    assert example(revising_run(Event(9, 5, 1, DISCARD, "uncertain"))) is None


def test_the_figure_shows_both_maps_with_one_scale(people, tmp_path):
    log, runs = people
    figure = revision_figure(log, runs[1], example(runs[1]))
    left, right = figure.axes
    assert left.get_xlim() == right.get_xlim()
    assert left.get_ylim() == right.get_ylim()
    assert left.get_aspect() == 1.0
    assert left.get_ylabel() == "y [m]"
    crosses = [line for line in right.lines if line.get_marker() == "x"]
    assert sum(len(line.get_xdata()) for line in crosses) == len(example(runs[1]).rows)
    paths = save(figure, tmp_path, "revision", ("png",))
    with Image.open(paths[0]) as picture:
        assert picture.size[0] == 1400

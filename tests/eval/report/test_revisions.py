"""What was revised is counted, and one example of it is shown."""

from dataclasses import replace

import numpy as np
import pytest

from data.result import DISCARD, NEW, Event
from eval.figures.association import AFTER, BEFORE, Example, revision_figure
from eval.replay.hindsight.ledger import MERGED, REASSOCIATED
from eval.report.log_sections import example, tally
from tests.eval.handmade import LANDMARKS, circle_log, run_with_error, true_path


def revising_run(*events):
    """A run over six observations; who was taken for new had initialized landmark 7."""
    rows = [e.observation for e in events]
    decisions, created = np.full(6, DISCARD), np.full(6, -1)
    decisions[rows] = [e.old for e in events]
    created[rows] = np.where([e.old == NEW for e in events], 7, -1)
    return replace(run_with_error(np.zeros(3)), decisions=decisions, created=created, events=tuple(events))


def test_revisions_are_counted_and_the_example_is_not_what_the_end_of_the_log_took_back():
    run = revising_run(
        Event(4, 0, 5, DISCARD, "missed"), Event(4, 1, 5, DISCARD, "missed"), Event(4, 2, 6, DISCARD, "missed"),
        Event(6, 3, NEW, DISCARD, "moved"), Event(9, 4, 1, DISCARD, "uncertain"), Event(9, 5, 3, 2, REASSOCIATED),
    )  # fmt: skip
    assert list(tally(run).values()) == ["4", "0", "0", "0", "1 (1 moved)", "1"]
    one = example(run)
    assert (one.frame, one.why, one.old.tolist()) == (4, "missed", [5, 5])
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
    assert [row[k] for k in ("undone", "replaced", "landmarks merged")] == ["5", "4", "1"]
    assert example(revising_run(Event(9, 5, 1, DISCARD, "uncertain"))) is None


def merged_example():
    """Landmark 7 was made twice and is 2 in the end; row 0 had seen 2 all the time."""
    run = replace(
        run_with_error(np.zeros(3)), decisions=np.array([2, 7, 7, DISCARD]), created=np.full(4, -1),
    )  # fmt: skip
    return run, Example(3, MERGED, np.array([1, 2]), np.array([7, 7]), np.array([2, 2]))


def marks(ax, marker):
    return [line for line in ax.lines if line.get_marker() == marker]


def test_sightings_of_merged_landmarks_lead_to_their_middle_at_first_and_to_the_one_that_stays_in_the_end():
    run, one = merged_example()
    log = circle_log()
    left, right = revision_figure(log, run, one).axes
    seen = LANDMARKS.xy[0]  # paths and readings are without error
    for ax, colour, number in ((left, BEFORE, "7"), (right, AFTER, "2")):
        (dots,) = marks(ax, ".")
        assert dots.get_xydata() == pytest.approx(np.tile(seen, (2, 1)))
        assert (dots.get_color(), dots.get_markersize()) == (colour, 4)
        lines = [x for x in ax.lines if x.get_color() == colour and len(x.get_xdata()) == 2 and x is not dots]
        assert len(lines) == 2
        assert all(0.3 < x.get_linewidth() < 0.7 and x.get_zorder() < dots.get_zorder() for x in lines)
        assert [t.get_text() for t in ax.texts] == [number]
        assert 6.0 <= ax.texts[0].get_fontsize() <= 7.0
    assert [ax.get_title() for ax in (left, right)] == ["as decided before frame 3", "in the end"]
    # all that is of interest is one point: 2.5 m to each side of it are shown
    assert left.get_xlim() == pytest.approx((seen[0] - 2.5, seen[0] + 2.5))
    assert left.get_ylim() == right.get_ylim() == pytest.approx((seen[1] - 2.5, seen[1] + 2.5))
    assert (left.get_aspect(), left.get_ylabel()) == (1.0, "y [m]")


def test_sightings_that_are_used_no_more_are_joined_with_where_they_were_made():
    run, one = merged_example()
    gone = replace(one, new=np.full(2, DISCARD))
    left, right = revision_figure(circle_log(), run, gone).axes
    for ax in (left, right):
        (places,) = marks(ax, "^")
        assert places.get_xydata() == pytest.approx(true_path()[[1, 2, 3], :2])
        assert {t.get_text() for t in ax.texts if "frame" in t.get_text()} == {"frame 1", "frame 2", "frame 3"}
        beams = [x for x in ax.lines if len(x.get_xdata()) == 2 and 0.3 < x.get_linewidth() < 0.5]
        assert len(beams) == 2
    (crosses,) = marks(right, "x")
    assert len(crosses.get_xdata()) == 2
    assert not marks(right, ".")
    assert not marks(left, "x")

"""What was revised is counted."""

from dataclasses import replace

import numpy as np

from data.result import DISCARD, NEW, Event
from eval.replay.hindsight.ledger import MERGED, REASSOCIATED
from eval.report.log_sections import tally
from tests.eval.handmade import run_with_error


def revising_run(*events):
    """A run over six observations; who was taken for new had initialized landmark 7."""
    rows = [e.observation for e in events]
    decisions, created = np.full(6, DISCARD), np.full(6, -1)
    decisions[rows] = [e.old for e in events]
    created[rows] = np.where([e.old == NEW for e in events], 7, -1)
    return replace(run_with_error(np.zeros(3)), decisions=decisions, created=created, events=tuple(events))


def test_revisions_are_counted_apart_from_what_the_end_of_the_log_took_back():
    run = revising_run(
        Event(4, 0, 5, DISCARD, "missed"), Event(4, 1, 5, DISCARD, "missed"), Event(4, 2, 6, DISCARD, "missed"),
        Event(6, 3, NEW, DISCARD, "moved"), Event(9, 4, 1, DISCARD, "uncertain"), Event(9, 5, 3, 2, REASSOCIATED),
    )  # fmt: skip
    assert list(tally(run).values()) == ["4", "0", "0", "0", "1 (1 moved)", "1"]


def test_merged_landmarks_are_counted():
    run = revising_run(
        Event(3, 0, 5, 4, "another hypothesis leads"), Event(3, 1, 5, 4, "another hypothesis leads"),
        Event(3, 2, 5, 4, "another hypothesis leads"),
        Event(5, 3, NEW, 2, MERGED), Event(5, 4, 7, 2, MERGED), Event(9, 5, 1, DISCARD, "uncertain"),
    )  # fmt: skip
    row = tally(run)
    assert [row[k] for k in ("undone", "replaced", "landmarks merged")] == ["5", "4", "1"]

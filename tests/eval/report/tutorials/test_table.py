"""One table from labels and map to nothing: tutorials in their order, ours beside those that know as much."""

from __future__ import annotations

from dataclasses import replace

import pytest

from data.worlds.arena import Arena, simulate
from eval.plan.tutorials import ABOUT
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.report.tutorials import given, logs_with_tutorials, rows_of, table_of

STEPS = (("localization", "known"), ("localization", "ml"), ("slam", "known"), ("slam", "ml-ratio"))


@pytest.fixture(scope="module")
def trials():
    log = simulate(Arena(frames=30, landmarks=10), 0)
    inputs = log.inputs(labels=True)
    ours = [
        Trial(log, task, tuple(
            r for a in ("known", "jcbb") for r in compare(inputs, task, ["dead-reckoning", "ekf", "batch"], a)
        ))
        for task in ("localization", "slam")
    ]  # fmt: skip
    tutorials = [
        Trial(
            replace(log, name=f"{log.name}:tutorial-step{i}"), task,
            tuple(compare(inputs, task, ["ekf"], association)), log.name, ABOUT,
        )
        for i, (task, association) in enumerate(STEPS, start=1)
    ]  # fmt: skip
    return [*ours, *tutorials]


def test_what_is_given_is_named():
    assert [given(*step) for step in STEPS] == ["map and labels", "map", "labels", "nothing"]


def test_map_and_labels_are_taken_away_row_by_row_and_ours_stands_beside(trials):
    table = table_of(rows_of("arena:0", trials, score(trials)))
    assert table["given"].tolist() == [g for g in ("map and labels", "map", "labels", "nothing") for _ in range(3)]
    ours = ["ours: ekf (online)", "ours: batch (final)"]
    assert table["run"].tolist() == [name for i in range(1, 5) for name in (f"tutorial-step{i}", *ours)]
    assert table["association"].tolist()[9:] == ["ml-ratio", "jcbb", "jcbb"]
    total = table[["TP", "TN", "FP", "FN"]].sum(axis=1)
    assert (total == len(trials[0].log.recorded.observations.frame)).all()
    assert table["landmarks"].notna().tolist() == [False] * 6 + [True] * 6


def test_one_tutorial_alone_makes_no_table_of_its_own(trials):
    assert logs_with_tutorials(trials) == ["arena:0"]
    assert logs_with_tutorials(trials[:3]) == []

"""The report's sections on studies: runs that are in no average are listed with what replays them."""

from __future__ import annotations

from dataclasses import replace

from eval.report.studies import Diverged
from eval.report.words import say


def test_what_diverged_is_listed_once_with_what_replays_it():
    run = Diverged("slam", "ekf", "nn", 3, "frame 7: lost", False, "python -m eval.run_all --seed 3")
    doubtful = replace(run, seed=4, implausible=True)
    assert say("studies#diverged", lost=()) == "Every run of every estimator reached its end."
    assert say("studies#diverged", lost=(run, run)) == (
        "2 runs diverged; they are in no average:\n\n"
        "* seed 3: `ekf` (slam, nn), frame 7: lost: `python -m eval.run_all --seed 3`"
    )
    both = say("studies#diverged", lost=(run, doubtful))
    assert both.startswith("2 runs diverged or are implausible; they are in no average:\n\n* seed 3:")
    assert "* seed 4: `ekf` (slam, nn), implausible, frame 7: lost:" in both
    many = say("studies#diverged", lost=tuple(replace(run, seed=n) for n in range(23)))
    assert many.endswith("* … and 3 more")
    assert many.count("\n* seed") == 20

"""Kilometres without labels: decisions in hindsight against those of the moment."""

import pytest

from data.worlds.park import Park, simulate
from eval.referee.score import confusion_of
from eval.replay.run import step_by_step


@pytest.mark.slow
def test_half_of_the_wrong_pairings_of_a_drive_of_kilometres_are_not_made_in_hindsight():
    """The first quarter of a park of 600 trees: loops of 250 m and more, closed with two metres of doubt."""
    log = simulate(Park(frames=2000, revisits=0.75, spacing=3.9, sigma_omega=0.002), 1)
    wrong = {}
    for method in ("jcbb", "jcbb-hindsight"):
        run = step_by_step("ekf", log.inputs().without_map(), "slam", method)
        found = confusion_of(run, log, "final")
        assert run.failure is None
        assert found is not None
        wrong[method] = found.fp
    assert 2 * wrong["jcbb-hindsight"] <= wrong["jcbb"]

"""Which landmarks leave the map: what is a filter's business only, a smoother is spared under every method."""

from __future__ import annotations

import numpy as np
import pytest

from data.notice import Code
from data.worlds.arena import Arena, simulate
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from tests.quick import slow


@pytest.mark.parametrize(("association", "maintain"), [
    ("jcbb", True), slow("jcbb", False), slow("jcbb-hindsight", False), slow("jcbb-hindsight", True)
])  # fmt: skip
def test_a_graph_forgets_and_parks_nothing(association, maintain):
    inputs = simulate(Arena(frames=60, landmarks=20), 3).inputs().without_map()
    setup = Setup(maintain=maintain, forget_after=3.0, deactivate_after=2.0)
    asked = step_by_step("isam2", inputs, "slam", association, setup)
    plain = step_by_step("isam2", inputs, "slam", association, Setup(maintain=maintain))
    forgetful = step_by_step("ekf", inputs, "slam", association, setup)
    assert np.array_equal(asked.final_decisions, plain.final_decisions)
    assert asked.map.number.tolist() == plain.map.number.tolist()
    assert len(forgetful.map.number) < len(asked.map.number)
    assert Code.FILTER_ONLY in [note.code for note in asked.notes]

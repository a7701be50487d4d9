"""NEES of the smoothers in a simulated room: five minutes of laps, walls seen every second, wheels that slip."""

from __future__ import annotations

import numpy as np
import pytest

from association.decide import known_decisions
from eval.referee.consistency import CONSISTENT, nees, verdict
from graph.batch import smooth
from graph.problem import Start
from tests.graph.driving import drive, lagged
from tests.graph.walls.worlds import drive_in_a_room


@pytest.mark.slow
def test_claimed_covariances_are_those_of_the_errors():
    means = {"isam2": [], "batch": [], "fixed lag": []}
    for seed in range(50):
        inputs, truth = drive_in_a_room(seed)
        inputs = inputs.without_map()
        decisions, created = known_decisions(inputs)
        s, pose, P, _ = drive(inputs, decisions)
        means["isam2"].append(nees(pose, P, truth, "pose").mean())
        result = smooth(inputs, decisions, created, Start(pose, s.landmarks().xy))
        path = result.trajectory
        means["batch"].append(nees(path.pose, path.covariance, truth, "pose").mean())
        _, pose, P, _ = drive(inputs, decisions, smoother=lagged(inputs, 20.0))
        means["fixed lag"].append(nees(pose, P, truth, "pose").mean())
    found = {name: verdict(np.array(values), 3) for name, values in means.items()}
    assert {name: v.word for name, v in found.items()} == dict.fromkeys(means, CONSISTENT), found
    assert all(v.power > 0.5 for v in found.values()), found

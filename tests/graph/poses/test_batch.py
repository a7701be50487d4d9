"""The optimum of a pose graph: an exact first pose, and loop closures that are false."""

from __future__ import annotations

import numpy as np
import pytest

from data.se2 import dead_reckoned
from tests.graph.poses.worlds import corridors, random_false, structured_false


def start(world):
    return dead_reckoned(world.truth[0], world.motion)


def test_a_first_pose_that_is_known_exactly_stays_and_has_no_covariance():
    world = corridors(0, 60, loops=20, blocks=1)
    found = world.optimum(start(world)).trajectory
    np.testing.assert_allclose(found.pose[0], world.truth[0], atol=1e-12)
    assert np.abs(found.covariance[0]).max() == 0.0
    assert np.linalg.eigvalsh(found.covariance[1:]).min() > 0.0


@pytest.mark.parametrize("false", [random_false, structured_false])
def test_as_many_false_loop_closures_as_half_the_true_ones_change_the_robust_paths_by_less_than_5_percent(false):
    before = {"gaussian": [], "cauchy": [], "gnc": []}
    after = {"gaussian": [], "cauchy": [], "gnc": []}
    for seed in range(2):
        world = corridors(seed, 110, loops=50, drift=3.0, blocks=2)
        wrong = world.with_loops(*false(world, np.random.default_rng(seed), 25))
        for w, errors in ((world, before), (wrong, after)):
            for loss in ("gaussian", "cauchy"):
                errors[loss].append(world.rmse(w.optimum(start(w), loss=loss).trajectory.pose))
            found, believed = w.graduated(start(w))
            errors["gnc"].append(world.rmse(found.trajectory.pose))
            assert not believed[50:].any()
            assert believed[:50].mean() > 0.9
    for loss in ("cauchy", "gnc"):
        np.testing.assert_allclose(after[loss], before[loss], rtol=0.05)
    assert min(after["gaussian"]) > 5.0 * max(before["gaussian"])

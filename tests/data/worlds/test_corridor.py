"""The corridor lab: world, path and view are the recorded ones."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from data import se2
from data.formats.open_log.reader import load_folder
from data.log import Log
from data.worlds.corridor import Corridor, simulate
from tests.data.worlds.corridor_readings import exact_polar, points_seen

ABREAST = 1e-9


@pytest.fixture(scope="module")
def recorded(shared_data: Path) -> dict[tuple[bool, bool], Log]:
    """The recorded logs by people and odometry."""
    place = shared_data / "lab_corridor"
    if not place.is_dir():
        pytest.skip("no recorded corridor logs")
    return {
        (p, o): load_folder(place / f"corridor_s0_people{p:d}_odo{o:d}") for p in (False, True) for o in (False, True)
    }


class TestAgainstTheRecordedRuns:
    def test_the_world_is_the_recorded_one(self, recorded):
        for log in recorded.values():
            ours = simulate(Corridor(), 0).truth.landmarks
            assert np.array_equal(ours.id, log.truth.landmarks.id)
            assert np.array_equal(ours.id, np.arange(1, 89))
            assert np.allclose(ours.xy, log.truth.landmarks.xy, rtol=0, atol=1e-12)

    def test_the_true_path_is_the_recorded_one(self, recorded):
        for log in recorded.values():
            error = se2.pose_error(simulate(Corridor(), 0).truth.pose, log.truth.pose)
            assert error.shape == (44, 3)
            assert np.abs(error).max() < 1e-12

    def test_the_visible_sets_are_the_recorded_ones_but_for_points_abreast(self, recorded):
        """Points at exactly 90 degrees are all seen here; in the record rounding shows 43 of them and hides 23."""
        ours = simulate(Corridor(), 0)
        edge = np.abs(np.abs(exact_polar(ours)[:, 1]) - 0.5 * math.pi) < ABREAST
        abreast = {pair for pair, on in zip(sorted(points_seen(ours)), edge) if on}
        for log in recorded.values():
            theirs = points_seen(log)
            assert points_seen(ours) - abreast == theirs - abreast
            hidden = points_seen(ours) - theirs
            assert hidden < abreast
            assert len(hidden) == 23
            assert min(k for k, _ in hidden - {(31, 66)}) == 33

    def test_the_inputs_are_stated_as_in_the_record(self, recorded):
        for (people, odometry), theirs in recorded.items():
            ours = simulate(Corridor(people=people, odometry=odometry), 0)
            assert np.array_equal(ours.recorded.increments.covariance, theirs.recorded.increments.covariance)
            assert ours.recorded.floored == 0
            assert np.array_equal(ours.recorded.time, theirs.recorded.time)
            assert ours.recorded.sensor == theirs.recorded.sensor
            assert np.array_equal(ours.recorded.prior.mean, np.zeros(3))
            assert np.array_equal(ours.recorded.prior.covariance, np.zeros((3, 3)))
            assert ours.recorded.time_is_index


class TestView:
    def test_a_point_as_far_as_the_range_is_not_seen(self):
        """With 0.6 m only the inner rows can be seen, when the robot is abreast of them; the corners have no others."""
        log = simulate(Corridor(range=0.6), 0)
        rows = (np.unique(log.truth.landmark_of) - 1) % 22
        assert set(rows.tolist()) == set(range(6, 17))

    def test_angles_limit_the_view(self):
        narrow = Corridor(min_angle=math.radians(-60), max_angle=math.radians(30))
        wide = simulate(Corridor(), 0)
        bearing = np.degrees(exact_polar(wide)[:, 1])
        kept = (bearing > -60) & (bearing < 30)
        assert points_seen(simulate(narrow, 0)) == {p for p, k in zip(sorted(points_seen(wide)), kept) if k}

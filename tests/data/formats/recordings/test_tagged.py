"""The circle log of DLR and the log of SLAM courses: order of covariances, identities, lines that are none."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import DataError
from data.formats.recordings.tagged import is_course, load_course, load_dlr

STEP = "STEP a.png 0.1 -0.2 0.05 1e-4 2e-5 3e-4 4e-5 5e-5 6e-4\r\n"
SEEN = "LANDMARK_C 1 -1 0.7 0.01 0 0.02 -1\r\n"
TEXT = f"# comment\r\n\r\n{STEP}LANDMARK_C 0.5 -2 0.9 0.01 0.001 0.02 17\r\n{SEEN}{STEP}"


def test_steps_and_circles_are_read(tmp_path):
    (tmp_path / "map.circles").write_text(TEXT)
    log = load_dlr(tmp_path / "map.circles", "dlr")
    r = log.recorded
    assert r.increments.mean[1].tolist() == [0.1, -0.2, 0.05]
    assert r.increments.covariance[1] == pytest.approx(
        np.array([[1e-4, 2e-5, 4e-5], [2e-5, 3e-4, 5e-5], [4e-5, 5e-5, 6e-4]])
    )
    assert (r.observations.frame.tolist(), log.truth.landmark_of.tolist()) == ([1, 1], [17, -2])
    assert r.observations.R[0].tolist() == [[0.01, 0.001], [0.001, 0.02]]
    (tmp_path / "bad").write_text(TEXT + "LANDMARK_C 1 2\n")
    with pytest.raises(DataError, match="bad:7"):
        load_dlr(tmp_path / "bad", "dlr")


STEPS = (
    "ODOMETRY 0.1 1 0.2\nSENSOR 3 2 0.5\nSENSOR 1 1 -0.5\nODOMETRY -0.3 0.5 0\nSENSOR 3 1.5 0.25\nSENSOR 4 -0.01 2\n"
)


def test_turn_drive_and_turn_of_a_course_are_an_increment(tmp_path):
    (tmp_path / "sensor_data.dat").write_text(STEPS)
    (tmp_path / "world.dat").write_text("3 2 1\n1 0.5 -4\n")
    assert is_course(tmp_path / "sensor_data.dat")
    assert not is_course(tmp_path / "world.dat")
    sigma = np.array([0.01, 0.02, 0.03])
    log = load_course(tmp_path / "sensor_data.dat", "course", tmp_path / "world.dat", sigma, (0.1, 0.2))
    r = log.recorded
    assert r.increments.mean[1] == pytest.approx([np.cos(0.1), np.sin(0.1), 0.3])
    drawn = np.array([0.1, 1.0, 0.2]) + sigma * np.random.default_rng(0).standard_normal((200_000, 3))
    moved = np.stack([drawn[:, 1] * np.cos(drawn[:, 0]), drawn[:, 1] * np.sin(drawn[:, 0]), drawn[:, 0] + drawn[:, 2]])
    assert r.increments.covariance[1] == pytest.approx(np.cov(moved), abs=6e-6)
    assert (r.observations.frame.tolist(), r.map.id.tolist()) == ([1, 1, 2], [1, 3])
    assert log.granted.tolist() == [3, 1, 3]
    assert r.observations.R[0] == pytest.approx(np.diag([0.01, 0.04]))


@pytest.mark.parametrize(
    ("steps", "world", "said"),
    [
        ("SENSOR 1 2\n", "", "sensor_data.dat:7: .*SENSOR id range bearing is needed"),
        ("SENSOR 1.5 2 0\n", "", "sensor_data.dat:7: column id: 1.5 is not a whole number"),
        ("", "1 2\n", "world.dat:1: '1 2'; id x y is needed"),
        ("", "1 2 3\n1 4 5\n", "world.dat:2: column id: 1 is the id of two landmarks"),
    ],
)
def test_lines_that_a_course_does_not_have_are_refused_by_number(tmp_path, steps, world, said):
    (tmp_path / "sensor_data.dat").write_text(STEPS + steps)
    (tmp_path / "world.dat").write_text(world)
    with pytest.raises(DataError, match=said):
        load_course(
            tmp_path / "sensor_data.dat", "course", tmp_path / "world.dat" if world else None, np.ones(3), (1, 1)
        )

"""The simulated lidar: ranges as an independent computation has them, with the stated noise; no more is changed."""

from __future__ import annotations

import numpy as np

from wings.robot.driving import WallFollower
from wings.robot.simulated.physics import Lidar, drive
from wings.robot.simulated.room import cast, room


def test_without_noise_a_range_is_where_the_beam_meets_a_wall():
    place, lidar = room(0), Lidar(beams=90, reach=9.0, sigma=0.0, dropout=0.0)
    pose = np.array([4.0, 2.0, 0.7])
    scan = lidar.scan(place, pose, 1.2345, (1, 2, 3), np.random.default_rng(0))
    angle = pose[2] - np.pi + 2.0 * np.pi * np.arange(90) / 90
    true = cast(place, np.column_stack([np.tile(pose[:2], (90, 1)), angle]), 0.0).distance
    np.testing.assert_allclose(scan.metres, np.where(true < 9.0, true, 0.0), atol=0.0006)
    assert (scan.stamp, scan.odometry) == (1234, (1, 2, 3))


def test_noise_and_missing_returns_are_as_stated():
    place, lidar, rng = room(0), Lidar(sigma=0.02, dropout=0.05), np.random.default_rng(3)
    pose = np.array([3.0, 1.5, 0.0])
    exact = Lidar(sigma=0.0, dropout=0.0).scan(place, pose, 0.0, (0, 0, 0), rng).metres
    scans = np.array([lidar.scan(place, pose, 0.0, (0, 0, 0), rng).metres for _ in range(40)])[
        :, (exact > 0) & (exact < 7.8)
    ]
    assert abs((scans == 0.0).mean() - 0.05) < 0.007
    error = (scans - exact[(exact > 0) & (exact < 7.8)])[scans > 0.0]
    assert abs(error.std() / 0.02 - 1.0) < 0.03
    assert abs(error.mean()) < 0.001


def test_a_lidar_changes_neither_the_path_nor_what_the_sonars_hear():
    plain, scanned = (drive(room(1), WallFollower(), 5.0, np.random.default_rng(2), lidar=x) for x in (None, Lidar()))
    assert [p.answer for p in plain.packets] == [p.answer for p in scanned.packets]
    assert plain.poses.tobytes() == scanned.poses.tobytes()
    assert all(p.scan is None for p in plain.packets)
    assert all(p.scan is not None and p.scan.odometry == p.answer[1:] for p in scanned.packets)

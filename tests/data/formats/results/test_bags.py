"""Poses with covariance from ROS bags of both versions: about the world's axes, and unknown where they say so."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import UsageError
from data.formats.results.path import WORLD
from data.formats.results.reading import read_path
from tests.data.formats.recordings.ros.bags import FORMS, START, Maker

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def covariance(k):
    root = np.random.default_rng(k).normal(size=(6, 6))
    return root @ root.T


def bag(form, folder, known=lambda k: True):
    """Five poses on /amcl, written with the last one first; odometry without covariance on /odom."""
    maker = Maker(form)
    for k in (4, 0, 1, 2, 3):
        place = maker._of(
            "geometry_msgs/msg/Pose",
            maker._of("geometry_msgs/msg/Point", float(k), 0.5 * k, 0.25),
            maker._turn(0.7 * k),
        )
        C = covariance(k).ravel() if known(k) else np.zeros(36)
        pose = maker._of("geometry_msgs/msg/PoseWithCovariance", place, C)
        message = maker._of(POSE, header=maker._header("map", 0.1 * k), pose=pose)
        maker.messages.append((float(k != 4) + 0.1 * k, "/amcl", POSE, message))
        maker.odometry(0.1 * k, (k, 0.0, 0.0))
    return maker.save(folder)


@pytest.mark.parametrize("form", FORMS)
def test_poses_come_in_the_order_of_their_stamps_with_the_covariance_of_x_y_and_yaw(form, tmp_path):
    path = read_path(f"{bag(form, tmp_path)}:/amcl")
    assert path.time - START == pytest.approx(0.1 * np.arange(5), abs=1e-6)
    k = np.arange(5)
    assert path.pose == pytest.approx(np.column_stack([k, 0.5 * k, 0.7 * k]), abs=1e-9)
    assert path.frame == WORLD
    keep = np.ix_([0, 1, 5], [0, 1, 5])
    assert path.covariance == pytest.approx(np.array([covariance(k)[keep] for k in range(5)]), rel=1e-12)
    assert path.outside["z"] == (0.25, 0.25)


def test_zeros_are_no_covariance(tmp_path):
    where = bag("sqlite3", tmp_path, lambda k: k != 2)
    path = read_path(f"{where}:/amcl")
    assert np.isnan(path.covariance[2]).all()
    assert np.isfinite(path.covariance[[0, 1, 3, 4]]).all()
    assert path.notes == ("1 of 5 poses state no covariance (NaN, zeros or -1)",)
    assert read_path(f"{where}:/odom").covariance is None


def test_which_topic_must_be_said_where_there_are_several(tmp_path):
    where = bag("mcap", tmp_path)
    with pytest.raises(UsageError, match=r"which topic\? .*:/TOPIC is needed; with poses: /amcl, /odom"):
        read_path(str(where))
    with pytest.raises(UsageError, match="no poses on /scan; such topics: /amcl, /odom"):
        read_path(f"{where}:/scan")

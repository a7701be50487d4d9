"""Poses with covariance from ROS bags of both versions: about the world's axes, and unknown where they say so."""

import math

import numpy as np
import pytest

from data.errors import DataError, UsageError
from data.formats.results.path import ROWS, WORLD
from data.formats.results.reading import read_path
from eval.score import main as score
from tests.data.formats.bags.made import START, Full, get_types_from_msg
from tests.data.formats.recordings.ros.bags import FORMS

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def covariance(k):
    root = np.random.default_rng(k).normal(size=(6, 6))
    return root @ root.T


def bag(form, folder, known=lambda k: True):
    """Five poses on /amcl, written with the last one first; odometry without covariance on /odom."""
    maker = Full(form)
    for k in (4, 0, 1, 2, 3):
        C = covariance(k).ravel() if known(k) else np.zeros(36)
        pose = maker._of("geometry_msgs/msg/PoseWithCovariance", maker._pose(k, 0.5 * k, 0.7 * k, 0.25), C)
        maker._send(float(k != 4) + 0.1 * k, "/amcl", POSE, header=maker._header("map", 0.1 * k), pose=pose)
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
    with pytest.raises(UsageError, match=r"which transform\?.*moving ones: none"):
        read_path(f"{where}:/tf")
    with pytest.raises(UsageError, match="no poses on /scan; such topics: /amcl, /odom"):
        read_path(f"{where}:/scan")
    assert len(read_path(f"{where}:amcl").time) == 5, "topics of old bags have no slash: it does not matter"


WAY = [(0.5 * k, math.sin(0.3 * k), 0.1 * k) for k in range(30)]


def test_a_path_whose_poses_have_one_stamp_is_of_the_rows_of_the_other_file(tmp_path):
    maker = Full("mcap")
    each = [maker._of("geometry_msgs/msg/PoseStamped", maker._header("map", 0.0), maker._pose(*pose)) for pose in WAY]
    maker._send(1.0, "/plan", "nav_msgs/msg/Path", header=maker._header("map", 0.0), poses=each)
    path = read_path(f"{maker.save(tmp_path)}:/plan")
    assert (path.clock.by, len(path.notes)) == (ROWS, 1)
    assert path.pose == pytest.approx(np.array(WAY))


def moved(place, T):
    x, y, a = T
    c, s = math.cos(a), math.sin(a)
    return x + c * place[0] - s * place[1], y + s * place[0] + c * place[1], place[2] + a


def bags(tmp_path, tf):
    """An estimate in `map` on /amcl, and a truth in `odom` on /truth; map_T_odom changes if `tf` is moving."""
    maker = Full("mcap")
    for k, place in enumerate(WAY):
        T = (3.0 + (0.1 * k if tf == "moving" else 0.0), -2.0, 0.4)
        maker.pose(float(k), moved(place, T), "/amcl", 0.01 * np.eye(6))
        maker.bare_pose(float(k), place, "/truth", "/odom")
        if tf == "moving":
            maker.transform(float(k), "map", "odom", T)
    if tf == "static":
        maker.mounting("map", "odom", 3.0, -2.0, 0.4)
    where = maker.save(tmp_path)
    return [f"{where}:/amcl", f"{where}:/truth"]


@pytest.mark.parametrize("tf", ["static", "moving"])
def test_a_truth_in_another_frame_is_taken_there_by_tf(tf, tmp_path, capsys):
    assert score(bags(tmp_path, tf)) == 0
    out, err = capsys.readouterr()
    values = {line.split()[0]: float(line.split()[1]) for line in out.splitlines() if line.count(" ") == 1}
    assert values["rmse_position_m"] == pytest.approx(0.0, abs=1e-6)
    assert values["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-5)
    assert "question" not in err
    assert "by tf" in err


def test_without_tf_it_is_asked_and_an_alignment_needs_no_answer(tmp_path, capsys):
    files = bags(tmp_path, "")
    assert score(files) == 0
    err = capsys.readouterr().err
    assert "question: the estimate is in frame map, the truth in odom" in err
    assert score([*files, "--align", "se3"]) == 0
    assert "question" not in capsys.readouterr().err


def test_a_path_that_tf_alone_publishes_is_read_by_the_names_of_two_frames(tmp_path):
    maker = Full("mcap")
    for k, place in enumerate(WAY):
        maker.transform(float(k), "odom", "base_link", place)
        if k % 10 == 0:
            maker.transform(float(k), "map", "odom", (3.0 + 0.1 * k, -2.0, 0.4))
    where = maker.save(tmp_path)
    assert read_path(f"{where}:/tf:odom.base_link").pose == pytest.approx(np.array(WAY), abs=1e-12)
    path = read_path(f"{where}:/tf:map.base_link")
    assert path.time - START == pytest.approx(np.arange(30.0), abs=1e-6), "the stamps of the frame that moves fastest"
    x = [3.0 + 0.1 * min(k, 20) for k in range(30)]
    right = [moved(place, (x[k], -2.0, 0.4)) for k, place in enumerate(WAY)]
    assert path.pose[:28] == pytest.approx(np.array(right)[:28], abs=1e-9)
    with pytest.raises(UsageError, match=r"which transform\? .*:/tf:PARENT.CHILD .*: map.odom, odom.base_link"):
        read_path(str(where))


def test_poses_without_covariance_and_without_stamps_are_read_and_said(tmp_path):
    maker = Full("sqlite3")
    for k, place in enumerate(WAY):
        maker.bare_pose(float(k), place, "/pose", stamped=k != 3)
    path = read_path(str(maker.save(tmp_path)))
    assert path.covariance is None
    assert path.pose == pytest.approx(np.array(WAY), abs=1e-12)
    assert path.time - START == pytest.approx(np.arange(30.0), abs=1e-6)
    assert path.notes == ("1 of 30 messages have no stamp: the time of recording is taken",)


TURTLE = "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity"


def test_poses_and_places_without_a_header_have_the_time_of_recording(tmp_path):
    maker, turtle = Full("sqlite3"), "turtlesim/msg/Pose"
    maker.store.register(get_types_from_msg(TURTLE, turtle))
    for k, (x, y, a) in enumerate(WAY):
        maker._send(k, "/turtle", turtle, x=x, y=y, theta=a)
        maker._send(k, "/plane", "geometry_msgs/msg/Pose2D", x=x, y=y, theta=a)
        maker.messages.append((k, "/pose", "geometry_msgs/msg/Pose", maker._pose(x, y, a)))
        maker._send(k, "/vector", "geometry_msgs/msg/Vector3", x=x, y=y)
        maker.poses(k, [(x, y)] * (1 + (k == 29)), topic="/array")
    where = maker.save(tmp_path)
    for topic, known, told in (("turtle", 3, 1), ("plane", 3, 1), ("pose", 3, 1), ("vector", 2, 2)):
        path = read_path(f"{where}:/{topic}")
        assert path.pose[:, :known] == pytest.approx(np.array(WAY)[:, :known], abs=1e-5)
        assert path.time - START == pytest.approx(np.arange(30.0), abs=1e-6)
        assert len(path.notes) == told, "the time of recording is said, and that headings are absent"
    with pytest.raises(DataError, match="2 poses in a message; one is needed"):
        read_path(f"{where}:/array")


def test_half_a_covariance_of_a_message_is_mirrored_and_a_bent_one_refused(tmp_path):
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    C = root @ root.T
    for name, M in (("half", np.triu(C)), ("bent", np.triu(C) + np.tril(C, -1) * 0.5)):
        maker = Full("mcap")
        for k, place in enumerate(WAY):
            maker.pose(float(k), place, "/pose", M)
        (tmp_path / name).mkdir()
        where = str(maker.save(tmp_path / name))
        if name == "bent":
            with pytest.raises(DataError, match="message 0: covariance is not symmetric"):
                read_path(where)
        else:
            path = read_path(where)
            keep = np.ix_([0, 1, 5], [0, 1, 5])
            assert path.covariance[4] == pytest.approx(C[keep])
            assert path.space.covariance[4] == pytest.approx(C)
            assert path.notes == ("30 of 30 covariances have only their upper triangle, which is mirrored",)


def test_poses_outside_the_stamps_of_a_transform_they_need_are_left_out(tmp_path):
    """Those within one of its steps stay: it may have been published at once with what follows."""
    maker = Full("mcap")
    for k, place in enumerate(WAY):
        maker.transform(float(k), "odom", "base_link", place)
        if 8 <= k <= 16 and k % 4 == 0:
            maker.transform(float(k), "map", "odom", (3.0, -2.0, 0.1 * k))
    path = read_path(f"{maker.save(tmp_path)}:/tf:map.base_link")
    assert path.time - START == pytest.approx(np.arange(4.0, 21.0), abs=1e-6)
    assert any("13 of 30 poses are outside the stamps of the transforms they need" in note for note in path.notes)

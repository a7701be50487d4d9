"""A log from arrays is the log that its folder holds, and wrong arrays are refused by name, row and column."""

from __future__ import annotations

import numpy as np
import pytest

import slamref
from data.errors import DataError
from data.formats.open_log.reader import load_folder
from data.formats.open_log.writer import write_folder
from data.log import Log
from data.logs import open_log

SENSOR = {"kind": "relative_point", "sigma": np.array([0.1, 0.1])}
STEPS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [1.0, 0.0, 0.0]])
SEEN = np.array([[0, 4.0, 1.0], [1, 3.0, 1.0], [2, 2.0, 1.0]])
PRIOR = (np.zeros(3), np.zeros(3))


def made(**changed):
    given = {"increments": STEPS, "covariance": [0.1, 0.1, 0.02], **changed}
    return Log.from_arrays(
        "mine", given.pop("prior", PRIOR), given.pop("sensor", SENSOR), given.pop("seen", SEEN), **given
    )


def arrays(log):
    r, t = log.recorded, log.truth
    o = r.observations
    return (r.prior.mean, r.prior.covariance, r.time, r.increments.mean, r.increments.covariance, o.frame, o.z, o.R), t


def test_a_log_from_arrays_is_the_log_of_the_same_numbers_in_a_folder(tmp_path):
    world = open_log("arena:3")
    r, o, t = world.recorded, world.recorded.observations, world.truth
    again = slamref.Log.from_arrays(
        "arena_3",
        (r.prior.mean, r.prior.covariance),
        {
            "kind": "range_bearing",
            "max_range": r.sensor.max_range,
            "min_angle": r.sensor.min_angle,
            "max_angle": r.sensor.max_angle,
        },
        np.column_stack([o.frame, o.z]),
        increments=r.increments.mean,
        covariance=r.increments.covariance,
        time=r.time,
        R=o.R,
        landmarks=np.column_stack([t.landmarks.id, t.landmarks.xy]),
        truth=t.pose,
        true_id=t.landmark_of,
    )
    write_folder(world, tmp_path / "arena_3")
    read = load_folder(tmp_path / "arena_3")
    for one, other in zip(arrays(again)[0], arrays(read)[0], strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.recorded.sensor == read.recorded.sensor
    np.testing.assert_array_equal(again.truth.pose, read.truth.pose)
    np.testing.assert_array_equal(again.truth.landmark_of, read.truth.landmark_of)


def test_one_covariance_holds_for_all_frames_but_the_first():
    log = made()
    np.testing.assert_allclose(log.recorded.increments.covariance[1:], np.tile(np.diag([0.01, 0.01, 4e-4]), (2, 1, 1)))
    assert log.recorded.time_is_index


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"seen": [[0, 4.0, np.nan]]}, "mine: observations:0: column z2: nan is not a number"),
        ({"seen": [[3, 4.0, 1.0]]}, "mine: observations:0: column frame: 3 is out of range; there are frames 0 to 2"),
        ({"seen": np.ones((4, 2))}, r"mine: observations: shape \(4, 2\); \(rows, 3\) is needed"),
        ({"time": [0.0, 1.0, 1.0]}, "mine: increments:2: column t: 1 follows 1.0; t must increase"),
        ({"covariance": None}, "increments need a covariance"),
        ({"covariance": [[1.0, 2.0, 0], [0, 1.0, 0], [0, 0, 1.0]]}, "mine: covariance: not symmetric"),
        ({"truth": np.zeros((2, 3))}, "mine: truth:1: 2 rows for 3 frames"),
        ({"sensor": {"kind": "sonar"}}, "sonar"),
        ({"odometry": np.zeros((3, 3))}, "either increments or odometry is needed"),
        ({"label": [1, 2]}, r"label has shape \(2,\); \(3,\) is needed"),
    ],
)
def test_a_wrong_array_is_refused_with_its_row(changed, message):
    with pytest.raises(DataError, match=message):
        made(**changed)


def test_a_log_prints_a_few_lines():
    assert str(open_log("arena:0")).splitlines() == [
        "Log arena:0",
        "  frames: 200 (99.5 s)",
        "  observations: 1627",
        "  sensor: range_bearing",
        "  map: 25 landmarks",
        "  truth: in 200 frames",
        "  labels: yes",
    ]

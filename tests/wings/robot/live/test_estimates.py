"""Every estimate of a drive as a line of a file, from which the same numbers are read."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from data.errors import UsageError
from data.result import PoseEstimate
from wings.robot.live.session import COLUMNS, Estimates

COVARIANCE = np.array([[0.1, 1 / 3, 0.3], [1 / 3, 0.2, -0.6], [0.3, -0.6, 0.7]])


def taken(number, *steps):
    return SimpleNamespace(frame=SimpleNamespace(number=number, time=0.1 * number), steps=steps)


def test_a_line_holds_the_bits_of_pose_and_covariance_and_who_has_ended_has_none(tmp_path):
    step = PoseEstimate(np.array([1 / 3, -2.0, np.pi / 7]), COVARIANCE)
    with Estimates(tmp_path / "now.csv", ["ekf", "isam2"]) as estimates:
        estimates.add(taken(3, step, step))
        estimates.add(taken(4, None, step))
        head, *rows = (tmp_path / "now.csv").read_text().splitlines()  # written at once
    assert head == COLUMNS
    cells = [row.split(",") for row in rows]
    assert [c[:3] for c in cells] == [["3", repr(0.1 * 3), "ekf"], ["3", repr(0.1 * 3), "isam2"], ["4", "0.4", "isam2"]]
    for c in cells:
        values = dict(zip(COLUMNS.split(",")[3:], map(float, c[3:]), strict=True))
        assert [values[name] for name in ("x", "y", "theta")] == step.mean.tolist()
        named = [["xx", "xy", "xt"], ["xy", "yy", "yt"], ["xt", "yt", "tt"]]
        assert [[values[name] for name in row] for row in named] == COVARIANCE.tolist()


def test_a_file_that_is_there_stays(tmp_path):
    (tmp_path / "now.csv").write_text("mine")
    with pytest.raises(UsageError, match=r"--estimates .*now.csv: "):
        Estimates(tmp_path / "now.csv", ["ekf"])
    assert (tmp_path / "now.csv").read_text() == "mine"

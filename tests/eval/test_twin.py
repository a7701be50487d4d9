"""`eval.twin` writes a log drawn again as it says of itself: an open log with a truth, or one clear line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.formats.open_log import write_folder
from data.log import shortened
from data.logs import open_log
from data.truth import Truth
from eval.twin import main


@pytest.fixture(scope="module")
def unmeasured(tmp_path_factory):
    """A log that nobody measured: no true path, no map, labels of the sensor."""
    log = shortened(open_log("arena:3"), 50)
    folder = tmp_path_factory.mktemp("logs") / "mine"
    given = replace(log, recorded=log.recorded.without_map(), truth=Truth(), label=log.granted, labels_are_sensed=True)
    write_folder(given, folder)
    return folder


def test_a_twin_of_a_log_that_nobody_measured_has_a_truth(unmeasured, tmp_path, capsys):
    assert main([str(unmeasured), str(tmp_path / "twin"), "--seed", "4"]) == 0
    assert "50 frames" in capsys.readouterr().out
    real, made = open_log(str(unmeasured)), open_log(str(tmp_path / "twin"))
    assert real.truth.pose is None
    assert made.truth.known_poses == 50
    assert made.truth.landmark_of is not None
    assert made.recorded.map is None  # SLAM, as with the log itself
    assert made.recorded.observations.frame.tolist() == real.recorded.observations.frame.tolist()
    assert made.source["twin_of"] == "mine"


def test_in_localization_the_path_of_the_localizing_smoother_is_the_truth(tmp_path):
    assert main(["arena:3", str(tmp_path / "l")]) == 0
    assert main(["arena:3", str(tmp_path / "s"), "--task", "slam"]) == 0
    local, slam = (open_log(str(tmp_path / n)) for n in "ls")
    assert local.recorded.map is not None
    true = open_log("arena:3").truth.pose
    assert np.hypot(*(local.truth.pose - true)[:, :2].T).max() < np.hypot(*(slam.truth.pose - true)[:, :2].T).max()


def test_what_makes_no_sense_is_one_line(unmeasured, tmp_path, capsys):
    for arguments, words in (
        ([str(unmeasured), "--task", "localization"], "has no map"),
        (["nowhere"], "nowhere"),
    ):
        assert main([*arguments, str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert error.startswith("slamref: ")
        assert words in error
        assert error.count("\n") == 1
    write_folder(shortened(open_log("arena:3"), 4), tmp_path / "short")
    assert main([str(tmp_path / "short"), str(tmp_path / "twin")]) == 2
    assert "4 frames, at least 10 are needed" in capsys.readouterr().err
    assert not (tmp_path / "twin").exists()
    with pytest.raises(SystemExit) as end:
        main(["arena:3", "out", "--seed", "-1"])
    assert end.value.code == 2
    assert "whole number" in capsys.readouterr().err

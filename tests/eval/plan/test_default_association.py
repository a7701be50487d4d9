"""Who pairs the readings when nobody says it: labels, scans, or decisions in hindsight."""

from __future__ import annotations

from dataclasses import replace

import pytest

from data.errors import UsageError
from data.formats.open_log.writer import write_folder
from data.logs import open_log
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from tests.ekf.lines.world import World, line_log


def said(text: str) -> None:
    """Nobody listens."""


@pytest.mark.parametrize(
    ("name", "labels", "expected"),
    [
        ("arena:0:frames=5", True, "known"),
        ("arena:0:frames=5", False, "jcbb-hindsight"),
        ("floorplan:0:frames=5", False, "scan"),
    ],
)
def test_the_default_association_follows_what_the_log_has(tmp_path, name, labels, expected):
    log = open_log(name)
    if not labels:
        log = replace(log, label=None, truth=replace(log.truth, landmark_of=None))
    write_folder(log, tmp_path / "log")
    plan = make_plan(read_options(["--log", str(tmp_path / "log")], "run"), said)
    assert {work.association for work in plan.experiments[0].work} == {expected}


@pytest.fixture
def walls(tmp_path):
    log = line_log(0, World(seconds=10.0))
    write_folder(replace(log, truth=replace(log.truth, landmark_of=None)), tmp_path / "walls")
    return ["--log", str(tmp_path / "walls"), "--estimator", "ekf"]


def test_walls_are_not_paired_in_hindsight(walls):
    with pytest.raises(UsageError, match="walls can be paired by jcbb"):
        make_plan(read_options([*walls, "--association", "jcbb-hindsight"], "run"), said)


@pytest.mark.parametrize(("errors", "refused"), [("curvature,bearing", True), ("range", True), ("scale", False)])
def test_errors_of_the_sensor_are_not_calibrated_by_walls(walls, errors, refused):
    options = read_options([*walls, "--calibrate", errors], "run")
    if not refused:
        assert make_plan(options, said).experiments
        return
    with pytest.raises(UsageError, match="--calibrate: log 'walls' has walls"):
        make_plan(options, said)

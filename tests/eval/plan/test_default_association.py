"""Who pairs the readings when nobody says it: labels, scans, or decisions in hindsight."""

from __future__ import annotations

from dataclasses import replace

import pytest

from data.logs import open_log
from data.open_log.writer import write_folder
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options


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

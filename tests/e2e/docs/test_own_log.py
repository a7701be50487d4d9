"""The story in docs/logs.md, run as it is written: two CSV files of somebody's robot become a report."""

from __future__ import annotations

import csv
import shlex
from pathlib import Path

import numpy as np
import pytest

import slamref
from data import se2
from data.convert.__main__ import main as convert
from data.worlds.arena import Arena, simulate

DOCS = Path(__file__).parents[3] / "docs" / "logs.md"


def blocks(language: str) -> list[str]:
    """Fenced blocks of the docs in a language ('' for output)."""
    parts = DOCS.read_text(encoding="utf-8").split("```")[1::2]
    return [text.partition("\n")[2] for text in parts if text.partition("\n")[0] == language]


def write_files(folder: Path) -> None:
    """What the robot wrote: arena:5, poses by odometry and cones by distance and angle."""
    recorded = simulate(Arena(), 5).recorded
    pose, o = se2.dead_reckoned(np.zeros(3), recorded.increments.mean), recorded.observations
    stamp = [round(1.7e12 + 1000 * t) for t in recorded.time]
    poses = (
        [t, *np.round(p[:2], 4).tolist(), round(float(np.degrees(p[2])), 3)] for t, p in zip(stamp, pose, strict=True)
    )
    cones = (
        [stamp[k], round(float(z[0]), 4), round(float(np.degrees(z[1])), 3)] for k, z in zip(o.frame, o.z, strict=True)
    )
    for name, head, rows in (
        ("odometry.csv", ["stamp_ms", "pos_x", "pos_y", "yaw_deg"], poses),
        ("cones.csv", ["stamp_ms", "dist_m", "angle_deg"], cones),
    ):
        with (folder / name).open("w", newline="") as file:
            writer = csv.writer(file, delimiter=";")
            writer.writerow(head)
            writer.writerows(rows)


@pytest.mark.slow
def test_the_story_of_the_docs(tmp_path, monkeypatch, capsys):
    write_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    commands = [line for line in blocks("sh")[0].splitlines() if line]
    assert len(commands) <= 5
    said = []
    for line in commands:
        program, *words = shlex.split(line)
        assert program == "slamref"
        assert slamref.main(words) == 0
        said.append(capsys.readouterr().out)
    files, converted, answered, asked = blocks("")[:4]
    for name in ("odometry.csv", "cones.csv"):
        for line in (tmp_path / name).read_text().splitlines()[:3]:
            assert line in files
    assert converted in said[0]
    assert answered in said[-1]
    wrong = shlex.split(commands[0].replace("time=ms,angle=deg", "time=ms"))[2:]
    assert convert(["wrong" if w == "robot" else w for w in wrong]) == 0
    assert asked in capsys.readouterr().out
    assert (tmp_path / "report" / "figures" / "robot-slam-claims.png").exists()
    assert (tmp_path / "report" / "figures" / "robot-slam-fate.png").exists()

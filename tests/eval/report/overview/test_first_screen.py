"""The first screen: whom to trust on each log, at most 900 characters above the table, and the cause without truth."""

from __future__ import annotations

import re

import pytest

from data.formats.open_log.writer import write_folder
from data.log import Log
from data.truth import Truth
from data.worlds.arena import Arena, simulate
from eval.run_all import main

TAGS = re.compile(r"<(style|head)>.*?</\1>|<[^>]+>", re.S)


def above(html: str) -> str:
    """The text between the start of the page and its first table."""
    body = html[html.index("<body>") : html.index("<table>")]
    return TAGS.sub("", body)


@pytest.fixture(scope="module")
def blind(tmp_path_factory):
    """An arena log whose truth was taken away."""
    folder = tmp_path_factory.mktemp("blind")
    log = simulate(Arena(frames=80), 3)
    write_folder(Log("blind", log.recorded, Truth(landmark_of=log.truth.landmark_of)), folder / "blind")
    out = folder / "report"
    logs = ["--log", str(folder / "blind"), "--log", "arena:0", "--log", "corridor:0:people"]
    words = ["--estimator", "ekf,batch", "--task", "slam", "--association", "known,nn", "--runs", "0", "--quick"]
    assert main([*logs, *words, "--jobs", "1", "--no-plots", "--out", str(out), "-q"]) == 0
    return (out / "report.html").read_text(encoding="utf-8"), (out / "report.md").read_text(encoding="utf-8")


def test_at_most_900_characters_stand_above_the_overview(blind):
    assert 100 < len(above(blind[0])) <= 900


def test_the_first_screen_names_the_cause_of_a_log_without_truth(blind):
    row = next(line for line in blind[1][:4000].splitlines() if line.startswith("| [blind, slam]"))
    assert re.search(r"\*\*(cause: (odometry|sensor|estimator|associations)|path: smoother)\*\*", row)
    assert "## Diagnosis without ground truth" in blind[1][:4000]
    assert "NIS " in row


def test_every_log_has_a_row_that_points_to_its_section(blind):
    rows = re.findall(r'<th scope="row"><a href="#([^"]+)">', blind[0])
    assert rows == ["blind-slam", "arena-0-slam", "corridor-0-people-slam"]
    assert all(f'<h2 id="{row}">' in blind[0] for row in rows)
    assert blind[0].count("<svg width=") == 3

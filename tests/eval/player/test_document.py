"""The page: one file that asks for nothing, the same bytes for the same runs, and as small as promised."""

from __future__ import annotations

import html.parser
import json
import re

import numpy as np
import pytest

from data.log import shortened
from data.logs import open_log
from eval import play
from eval.player.document import document, played, player_of
from eval.player.pack import unpacked
from eval.player.scene import scene
from eval.player.watch import Watch
from eval.referee.score import Trial, confusion_of
from eval.replay.run import compare
from eval.replay.settings import Setup


@pytest.fixture(scope="module")
def trial():
    log = shortened(open_log("corridor:0:people"), 15)
    runs = compare(log.inputs(labels=True), "slam", ["dead-reckoning", "ekf", "batch"], "known", watch=Watch)
    runs += compare(log.inputs(), "slam", ["ekf"], "nn", watch=Watch)
    return Trial(log, "slam", tuple(runs))


@pytest.fixture(scope="module")
def page(trial):
    return document(trial.log.name, [scene([trial], Setup())])


class Parts(html.parser.HTMLParser):
    """All attributes that could make a browser ask for something, and ids."""

    def __init__(self, text):
        super().__init__()
        self.asked, self.ids, self.unnamed = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.asked += [(tag, k, v) for k, v in attrs if k in ("src", "href", "srcset", "data", "action", "poster")]
        self.ids += [given["id"]] if "id" in given else []
        if tag == "canvas" and not given.get("aria-label"):
            self.unnamed.append(given)


def test_the_page_asks_for_nothing(page):
    parts = Parts(page)
    assert parts.asked == []
    assert "http://" not in page
    assert "https://" not in page
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket\(|import\(", page)
    assert not parts.unnamed
    assert len(parts.ids) == len(set(parts.ids))


def test_the_page_names_the_licence_of_what_it_carries(page):
    assert "MIT licence" in page
    assert "Permission is hereby granted, free of charge" in page


def test_the_same_runs_give_the_same_bytes(trial, page):
    assert document(trial.log.name, [scene([trial], Setup())]) == page


def chunk_of(page):
    return json.loads(re.search(r'class="chunk">(.*?)</script>', page, re.S).group(1))


def test_paths_decisions_and_outcomes_are_those_of_the_runs(trial, page):
    chunk = chunk_of(page)
    arrays = unpacked(chunk)
    assert [r["estimator"] for r in chunk["runs"]] == ["dead-reckoning", "ekf", "batch", "ekf"]
    for run, entry in zip(trial.runs, chunk["runs"], strict=True):
        for phase in run.phases:
            xy = arrays[f"{entry['key']}{phase}_xy"]
            assert np.abs(xy - run.trajectory(phase).pose[:, :2]).max() < 0.1 * chunk["quantum"]
        if entry["decides"]:
            scored = confusion_of(run, trial.log, "online")
            assert arrays[f"{entry['key']}decision"][:, 0].tolist() == run.decisions.tolist()
            assert arrays[f"{entry['key']}outcome"][:, 0].tolist() == scored.outcome.tolist()
            assert arrays[f"{entry['key']}right"][:, 0].tolist() == scored.ground_truth.tolist()


def test_what_stands_beside_on_the_same_recording_is_in_the_same_player(trial):
    variant = Trial(trial.log, "slam", trial.runs[:1], variant_of=trial.log.name)
    other = Trial(open_log("corridor:1"), "slam", (), variant_of=trial.log.name)
    assert played([trial, variant, other]) == [(trial, variant)]
    assert player_of("corridor:0:people+no-odometry") == "players/corridor_0_people_no-odometry.html"


def test_the_command_writes_one_page(tmp_path, capsys):
    out = tmp_path / "short.html"
    arguments = ["corridor:0:people", "--association", "nn", "--estimator", "ekf", "--frames", "6", "--out", str(out)]
    assert play.main(arguments) == 0
    assert "short.html" in capsys.readouterr().out
    assert chunk_of(out.read_text(encoding="utf-8"))["frames"] == 6


def test_the_command_names_what_it_cannot_do(tmp_path, capsys):
    assert play.main(["arena:0", "--out", str(tmp_path / "a.png")]) == 2
    assert "ends in .html" in capsys.readouterr().err
    assert play.main(["arena:0", "--frames", "none"]) == 2
    assert "--frames none: a whole number" in capsys.readouterr().err

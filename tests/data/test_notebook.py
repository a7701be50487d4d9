"""Logs, runs, trials and scores show themselves in a notebook: well-formed, small, the same bytes each time."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

import slamref
from data.card import BLACK, Path, Points, card, drawing


def tree(html: str) -> ElementTree.Element:
    return ElementTree.fromstring(f"<body>{html.replace('<br>', '<br/>').replace('&ensp;', ' ')}</body>")


def test_a_path_with_a_gap_is_drawn_in_two_pieces_and_north_is_up():
    xy = np.array([[0.0, 0.0], [1.0, 0.0], [np.nan, np.nan], [1.0, 1.0], [0.0, 1.0]])
    made = tree(drawing([Path("true path", xy, BLACK)], [Points("map", xy[:1], BLACK)]))
    lines = [e.get("points") for e in made.iter() if e.tag.endswith("polyline")]
    assert lines == ["8.0,308.0 308.0,308.0", "308.0,8.0 8.0,8.0"]
    assert [(e.get("cx"), e.get("cy")) for e in made.iter() if e.tag.endswith("circle")] == [("8.0", "308.0")]


def test_a_card_shows_any_text_as_it_is_and_nothing_to_draw_is_no_picture():
    html = card("a <b>", [("x & y", "<1>")])
    assert "a &lt;b&gt;" in html
    assert "svg" not in html
    assert "".join(tree(html).itertext()) == "a <b>x & y<1>"


def test_what_slamref_gives_shows_itself():
    log = slamref.open_log("arena:0:frames=12")
    runs = slamref.compare(log.inputs(labels=True), "slam", ("dead-reckoning", "ekf", "isam2", "batch"))
    trial = slamref.Trial(log, "slam", tuple(runs))
    scores = slamref.score([trial])
    for thing, words in (
        (log, ("Log arena:0:frames=12", "true path")), (runs[2], ("Run of isam2", "online", "final", "map")),
        (trial, ("batch", "pose NEES (3 expected)")), (slamref.open_log("victoria-park"), ("dead reckoning",)),
    ):  # fmt: skip
        html = thing._repr_html_()
        shown = "".join(tree(html).itertext())
        assert all(word in shown for word in words)
        assert html == thing._repr_html_()
        assert "<svg" in html
        assert len(html) < 40_000
    assert "rmse_position_m" in scores._repr_html_()

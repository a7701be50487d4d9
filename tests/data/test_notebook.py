"""Logs, runs, trials and scores show themselves in a notebook: well-formed, small, the same bytes each time."""

from xml.etree import ElementTree

import slamref
from data.words import table_html


def test_a_table_shows_any_text_as_it_is():
    html = table_html("a <b>", [("x & y", "<1>")])
    assert "".join(ElementTree.fromstring(html).itertext()) == "a <b>x & y<1>"


def test_what_slamref_gives_shows_itself():
    log = slamref.open_log("arena:0:frames=12")
    runs = slamref.compare(log.inputs(labels=True), "slam", ("dead-reckoning", "ekf", "isam2", "batch"))
    trial = slamref.Trial(log, "slam", tuple(runs))
    scores = slamref.score([trial])
    for thing, words in (
        (log, ("Log arena:0:frames=12", "25 landmarks")), (runs[2], ("Run of isam2", "online, final")),
        (trial, ("batch", "pose NEES (3 expected)")),
    ):  # fmt: skip
        html = thing._repr_html_()
        shown = "".join(ElementTree.fromstring(html).itertext())
        assert all(word in shown for word in words)
        assert html == thing._repr_html_()
    assert "rmse_position_m" in scores._repr_html_()

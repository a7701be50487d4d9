"""The map of a run: when each landmark was seen first, and how often; what a notebook shows of a run."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from data.result import DISCARD, NEW, MapEstimate, MapState, Run, Trajectory, map_estimate


def test_a_landmark_is_first_seen_where_it_was_initialized_and_as_often_as_was_decided():
    decisions = np.array([NEW, NEW, DISCARD, 0, NEW, 0, 1, 2, NEW])
    created = np.array([0, 1, -1, -1, 2, -1, -1, -1, 3])
    frame = np.array([0, 2, 2, 3, 5, 5, 6, 8, 9])
    state = MapState(np.array([0, 2, 3, 5]), np.zeros((4, 2)), np.zeros((4, 2, 2)))
    found = map_estimate(state, frame, decisions, created)
    assert found.number.tolist() == [0, 2, 3, 5]
    assert found.first_frame.tolist() == [0, 5, 9, -1], "-1: never, one that was known"
    assert found.times_seen.tolist() == [3, 2, 1, 0]


DRIVEN = np.array([[0.0, 0.0, 0.1], [2.0, 0.0, 0.2], [2.0, 1.0, 0.3]])
SEEN = MapEstimate(
    np.array([0, 1]), np.array([[1.0, 1.0], [0.0, 1.0]]), np.zeros((2, 2, 2)), np.array([0, 0]), np.array([2, 1])
)
DECIDED = np.array([NEW, NEW, 0, DISCARD])


def shown(**changes) -> tuple[str, dict[str, str], list[tuple[str, str]], int, str]:
    """Title, facts, paths as (colour, points), number of landmarks and legend in what a notebook shows of a run."""
    path = Trajectory(DRIVEN, np.zeros((3, 3, 3)))
    run = Run("isam2", "nn", "slam", path, path, SEEN, DECIDED, np.array([NEW, NEW, 0, 1]), np.array([0, 1, -1, -1]))
    html = replace(run, **changes)._repr_html_()
    tree = ElementTree.fromstring(f"<body>{html.replace('<br>', '<br/>').replace('&ensp;', ' ')}</body>")
    facts = {row[0].text: "".join(row[1].itertext()) for row in tree.iter("tr")}
    drawn = [e for e in tree.iter() if e.tag.endswith("polyline")]
    circles = sum(e.tag.endswith("circle") for e in tree.iter())
    legend = "".join(text for e in tree.iter("small") for text in e.itertext())
    return next(tree.iter("b")).text, facts, [(e.get("stroke"), e.get("points")) for e in drawn], circles, legend

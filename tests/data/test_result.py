"""The map of a run: when each landmark was seen first, and how often; what a notebook shows of a run."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from data.notice import stopped
from data.result import DISCARD, NEW, Failure, MapEstimate, MapState, Run, Trajectory, map_estimate


def test_a_landmark_is_first_seen_where_it_was_initialized_and_as_often_as_was_decided():
    decisions = np.array([NEW, NEW, DISCARD, 0, NEW, 0, 1, 2, NEW])
    created = np.array([0, 1, -1, -1, 2, -1, -1, -1, 3])
    frame = np.array([0, 2, 2, 3, 5, 5, 6, 8, 9])
    state = MapState(np.array([0, 2, 3, 5]), np.zeros((4, 2)), np.zeros((4, 2, 2)))
    found = map_estimate(state, frame, decisions, created)
    assert found.number.tolist() == [0, 2, 3, 5]
    assert found.first_frame.tolist() == [0, 5, 9, -1], "-1: never, one that was known"
    assert found.times_seen.tolist() == [3, 2, 1, 0]


def test_a_map_of_nothing_is_empty():
    nothing = np.empty(0, np.int64)
    state = MapState(nothing, np.empty((0, 2)), np.empty((0, 2, 2)))
    assert len(map_estimate(state, nothing, nothing, nothing)) == 0


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


def test_a_notebook_shows_who_ran_how_far_and_what_was_decided_with_paths_and_map():
    title, facts, paths, landmarks, legend = shown()
    assert title == "Run of isam2"
    assert facts == {
        "task": "slam", "association": "nn", "status": "ok", "frames": "3", "phases": "online, final",
        "observations used": "2 of 4", "landmarks": "2",
    }  # fmt: skip
    # 2 m by 1 m, north up: 300 px to the east, 150 px to the north, 8 px of edge
    way = "8.0,158.0 308.0,158.0 308.0,8.0"
    assert paths == [("#D55E00", way), ("#0064A8", way)]
    assert landmarks == 2
    assert legend == "━ online ━ final ● map 2 x 1 m"


def test_a_notebook_says_why_a_run_is_not_believed_or_did_not_end():
    _, facts, *_ = shown(failure=Failure("diverged", 2, stopped("it left the world")))
    assert (facts["status"], facts["why"]) == ("diverged", "frame 2: it left the world")
    _, facts, *_ = shown(implausible=Failure("implausible", 1, stopped("300 m/s")))
    assert (facts["status"], facts["why"]) == ("implausible", "frame 1: implausible, 300 m/s")


def test_a_notebook_draws_no_walls_as_points_and_nothing_where_there_is_nothing():
    _, facts, paths, landmarks, _ = shown(walls=True, final=None)
    assert (facts["landmarks"], facts["phases"], len(paths), landmarks) == ("2", "online", 1, 0)
    _, facts, paths, landmarks, _ = shown(map=None, online=None)
    assert (facts["frames"], facts["phases"], [colour for colour, _ in paths], landmarks) == (
        "3",
        "final",
        ["#0064A8"],
        0,
    )
    assert "landmarks" not in facts
    _, facts, paths, landmarks, _ = shown(map=None, online=None, final=None)
    assert (facts["frames"], facts["phases"], paths, landmarks) == ("0", "", [], 0)

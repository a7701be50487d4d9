"""Chunks while a robot drives: one after the other they are the whole, and no more of them are kept than agreed."""

from __future__ import annotations

import json

import numpy as np
import pytest

from eval.player.pack import unpacked
from eval.replay.settings import Setup
from tests.wings.robot.live.driven import packets
from wings.robot.live import feed as feeding
from wings.robot.live.feed import MINUTE, Feed, Published, chunk_of, header
from wings.robot.live.session import Session

NAMES = ("ekf", "ekf-iterated")


@pytest.fixture(scope="module")
def taken():
    session = Session(NAMES, "jcbb", Setup())
    return [(session.take(packet), [e.map() for e in session.estimating]) for packet in packets(135.0)], session


def fed(taken, every=4):
    """A feed with all frames, published in turns; what a page has fetched that asked after each."""
    frames, session = taken
    feed, page = Feed(len(NAMES)), []
    for k, (one, maps) in enumerate(frames):
        feed.add(one)
        if k % every == every - 1:
            feed.publish(maps, header("drive", session.estimating, f"frame {k}"))
            at = page[-1]["first"] + page[-1]["frames"] if page else None
            page += json.loads(feed.published.since(at))["chunks"]
    return feed, page


def decoded(chunks):
    """Arrays of chunks one after the other, as the page decodes them: changes of walls add up inside a chunk."""
    found = {}
    for chunk in chunks:
        arrays = unpacked(chunk)
        for name in [n for n in arrays if n.endswith(".change")]:
            number = arrays[f"{name}_number"][:, 0]
            for n in np.unique(number):
                arrays[name][number == n] = np.cumsum(arrays[name][number == n], axis=0)
        for name, values in arrays.items():
            found.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in found.items()}


def test_small_chunks_large_chunks_and_one_chunk_are_the_same(taken):
    frames, _ = taken
    feed, page = fed(taken)
    late = json.loads(feed.published.since(None))["chunks"]
    small, large = decoded(page), decoded(late)
    whole = unpacked(json.loads(chunk_of([one for one, _ in frames], [np.empty((0, 8))] * 2, {}).text))
    assert len(page) == 135
    assert [c["frames"] for c in late[:2]] == [MINUTE, MINUTE]
    assert small.keys() == large.keys() == whole.keys()
    for name, values in small.items():
        assert np.array_equal(values, large[name], equal_nan=True), name
        if "change" not in name:
            assert np.array_equal(values, whole[name], equal_nan=True), name
    assert np.allclose(small["r0.online_xy"], [one.steps[0].mean[:2] for one, _ in frames], atol=1e-4)


@pytest.mark.slow
def test_walls_added_up_are_those_of_the_map(taken):
    frames, _ = taken
    state = frames[-1][1][0]
    arrays = decoded(fed(taken)[1])
    for number, xy in zip(state.number, state.xy, strict=True):
        own = np.flatnonzero(arrays["r0.change_number"][:, 0] == number)
        assert np.abs(arrays["r0.change"][own[-1], :2] * 1e-3 - xy).max() < 1.1e-3
        assert arrays["r0.change_there"][own[-1], 0] == 1


def test_only_what_changed_is_sent_but_each_minute_begins_with_the_whole_map(taken):
    chunks = fed(taken)[1]
    counts = [len(unpacked(c)["r0.change_number"]) for c in chunks]
    begins = [k for k, c in enumerate(chunks) if c["first"] % MINUTE == 0]
    for k in begins[1:]:
        present = decoded(chunks[: k + 1])["r0.change_number"]
        assert counts[k] == len(np.unique(present))
    assert np.median(counts) < 0.8 * max(counts)


def test_what_changed_in_a_chunk_is_of_its_last_frame(taken):
    for chunk in fed(taken)[1]:
        at = unpacked(chunk)["r0.change_frame"][:, 0]
        assert (at == chunk["first"] + chunk["frames"] - 1).all()


@pytest.mark.slow
def test_what_is_kept_is_bounded_and_the_rest_goes_on_from_its_beginning(taken, monkeypatch):
    frames, _ = taken
    feed, _ = fed(taken)
    monkeypatch.setattr(feeding, "MOST", len(feed.published.large[0].text) + 10)
    feed, page = fed(taken)
    assert len(page) == 135, "a page that keeps up misses nothing"
    p = feed.published
    assert len(p.large) == 1
    assert p.begin == MINUTE
    assert len(p.small) <= 2 * MINUTE / 4
    assert p.since(0) is None
    late = json.loads(p.since(None))["chunks"]
    assert late[0]["first"] == MINUTE
    assert late[-1]["first"] + late[-1]["frames"] == len(frames)
    numbers = np.unique(unpacked(late[0])["r0.change_number"])
    known = frames[MINUTE][1][0].number
    assert set(known) <= set(numbers.astype(int))


def test_a_frame_that_no_chunk_begins_with_is_refused_and_the_newest_is_not():
    empty = Published()
    assert json.loads(empty.since(None)) == {"ended": False, "chunks": []}
    assert empty.since(7) is None
    session, feed = Session(NAMES[:1], "jcbb", Setup()), Feed(1)
    for packet in packets(2.0):
        feed.add(session.take(packet))
    feed.publish([session.estimating[0].map()], {})
    before = feed.published
    feed.publish([session.estimating[0].map()], {})
    assert feed.published is before, "nothing new"
    assert before.since(3) is None
    assert json.loads(before.since(8)) == {"ended": False, "chunks": []}
    feed.end()
    assert json.loads(feed.published.since(8))["ended"]
    assert not before.ended, "what was published does not change"


def test_an_estimator_that_ended_leaves_a_gap():
    session, feed = Session(("ekf",), "jcbb", Setup()), Feed(1)
    for k, packet in enumerate(packets(5.0)):
        if k == 10:
            session.estimating[0].failure = "at frame 10: astray"
        feed.add(session.take(packet))
    feed.publish([session.estimating[0].map()], header("drive", session.estimating, ""))
    chunk = json.loads(feed.published.since(None))["chunks"][0]
    assert np.isnan(unpacked(chunk)["r0.online_xy"]).all(axis=1).tolist() == [False] * 10 + [True] * 10
    assert (chunk["runs"][0]["status"], chunk["runs"][0]["why"]) == ("ended", "at frame 10: astray")

"""The live page: chunks that one after the other are the whole, for this machine alone, and read only."""

import http.client
import json
import socket
from urllib.parse import urlsplit

import numpy as np
import pytest

from data.errors import UsageError
from eval.player.document import live_document
from eval.replay.settings import Setup
from tests.builders.unpacked import unpacked
from tests.wings.robot.live.driven import packets
from wings.robot.live import feed as feeding
from wings.robot.live.feed import MINUTE, Chunk, Feed, Published, Server, chunk_of, header
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
    for chunk in chunks:  # what changed in a chunk is of its last frame
        assert (unpacked(chunk)["r0.change_frame"][:, 0] == chunk["first"] + chunk["frames"] - 1).all()
    counts = [len(unpacked(c)["r0.change_number"]) for c in chunks]
    for k in [k for k, c in enumerate(chunks) if c["first"] % MINUTE == 0][1:]:
        assert counts[k] == len(np.unique(decoded(chunks[: k + 1])["r0.change_number"]))
    assert np.median(counts) < 0.8 * max(counts)


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
    assert set(frames[MINUTE][1][0].number) <= set(numbers.astype(int))


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


CHUNKS = Published((), (Chunk(0, 4, b'{"first":0}'), Chunk(4, 8, b'{"first":4}')))


@pytest.fixture
def server():
    with Server(0, b"<html>", lambda: CHUNKS) as served:
        yield served


def ask(server, path, method="GET", **headers):
    where = urlsplit(server.address)
    connection = http.client.HTTPConnection(where.hostname, where.port, timeout=5)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    return answer, answer.read()


def test_the_page_and_its_chunks_answer(server):
    answer, page = ask(server, "/")
    assert (answer.status, page, answer.headers.get_content_type()) == (200, b"<html>", "text/html")
    for path, firsts in (("/chunks", [0, 4]), ("/chunks/0", [0, 4]), ("/chunks/4", [4]), ("/chunks/8", [])):
        answer, text = ask(server, path)
        assert [c["first"] for c in json.loads(text)["chunks"]] == firsts
        assert answer.headers["Cache-Control"] == "no-store"
    assert ask(server, "/chunks/3")[0].status == 410
    answer, text = ask(server, "/", "HEAD")
    assert (answer.status, answer.headers["Content-Length"], text) == (200, "6", b"")


def test_the_newest_grid_answers_where_there_is_one(server):
    assert ask(server, "/grid")[0].status == 404
    with Server(0, b"", lambda: Published(grid=b"{}", grids=1)) as drawn:
        answer, text = ask(drawn, "/grid")
        assert (answer.status, text, answer.headers.get_content_type()) == (200, b"{}", "application/json")
        assert ask(drawn, "/grid/1")[0].status == 404


@pytest.mark.parametrize("path", [
    "/chunks/", "/chunks/-1", "/chunks/x", "/chunks/1/2", "/../etc/passwd", "/chunk", "/log.toml", f"/chunks/{9**999}",
])  # fmt: skip
def test_other_addresses_are_not_there(server, path):
    assert ask(server, path)[0].status == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "BREW"])
def test_it_can_only_be_read(server, method):
    answer, _ = ask(server, "/", method)
    assert (answer.status, answer.headers["Allow"]) == (405, "GET, HEAD")


def test_a_foreign_host_is_refused(server):
    port = urlsplit(server.address).port
    ours = f"127.0.0.1:{port}"
    for host in (
        "evil.example", f"evil.example:{port}", "127.0.0.1", f"{ours}1", "", f"localhost.x:{port}", f"x@{ours}",
    ):  # fmt: skip
        for path in ("/", "/chunks", "/nowhere"):
            answer, text = ask(server, path, Host=host)
            assert answer.status == 403, host
            assert text == b"another host\n"
    assert ask(server, "/", Host=f"localhost:{port}")[0].status == 200


def test_no_other_page_may_read_it_and_the_page_asks_nobody_else(server):
    headers = ask(server, "/chunks")[0].headers
    assert "Access-Control-Allow-Origin" not in headers
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    page = live_document("a <b>")
    assert "connect-src 'self'" in page
    assert "http://" not in page
    assert "https://" not in page
    assert "a &lt;b&gt;" in page


def test_what_is_no_request_is_refused(server):
    where = urlsplit(server.address)
    for words in (b"\x16\x03\x01\x02\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"GET / HTTP/1.0\r\n\r\n"):
        with socket.create_connection((where.hostname, where.port), timeout=5) as connection:
            connection.sendall(words)
            answer = connection.recv(100)
        assert answer.split()[1][:1] in (b"4", b"5") if answer.startswith(b"HTTP") else b"200" not in answer, words


def test_a_port_that_is_taken_is_one_line():
    with Server(0, b"", Published) as first, pytest.raises(UsageError, match="--port"):
        Server(urlsplit(first.address).port, b"", Published)

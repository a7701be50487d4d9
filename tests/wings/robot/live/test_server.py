"""The page is for this machine alone, and can only be read."""

from __future__ import annotations

import http.client
import json
import socket
from urllib.parse import urlsplit

import pytest

from data.errors import UsageError
from eval.player.document import live_document
from wings.robot.live.feed import Chunk, Published, Server

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
        "evil.example",
        f"evil.example:{port}",
        "127.0.0.1",
        f"{ours}1",
        "",
        f"localhost.x:{port}",
        f"x@{ours}",
    ):
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

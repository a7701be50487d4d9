"""HTTP server of the page for this machine: read only, the page and its chunks, no files.

Bound to 127.0.0.1. Other pages in the same browser cannot read it: foreign host names (even if they resolve to
127.0.0.1) and other origins are refused.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

from data.errors import UsageError
from data.terminal import message_of
from wings.robot.live.feed import Published

ADDRESS = "127.0.0.1"
PATIENCE = 10.0  # s after which a silent connection is closed
LONGEST = 12  # digits of a frame's number
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Server:
    """Serves in its own threads; `with` ends it."""

    def __init__(self, port: int, page: bytes, published: Callable[[], Published]) -> None:
        """Listen; port 0 is any free one. Raises UsageError: the port is not available."""
        try:
            self._http = ThreadingHTTPServer((ADDRESS, port), _handler(page, published))
        except (OSError, OverflowError) as fault:
            why = message_of(fault) if isinstance(fault, OSError) else "a number from 0 to 65535 is needed"
            raise UsageError(f"--port {port}: {why}") from None
        self._http.daemon_threads = True
        self.address = f"http://{ADDRESS}:{self._http.server_address[1]}/"  # of the page
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        self._thread.start()

    def __enter__(self) -> Server:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()


def _handler(page: bytes, published: Callable[[], Published]) -> type[BaseHTTPRequestHandler]:
    """Answers `/`, `/chunks` (all chunks), `/chunks/FRAME` (from that frame on) and `/grid` (the newest one)."""

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE
        server_version, sys_version = "slamref", ""

        def _answer(self) -> None:
            assert isinstance(self.server, ThreadingHTTPServer)
            port = self.server.server_address[1]
            if self.headers.get_all("Host") not in ([f"{ADDRESS}:{port}"], [f"localhost:{port}"]):
                self._reply(403, b"another host\n", "text/plain")
            elif self.path == "/":
                self._reply(200, page, "text/html; charset=utf-8")
            elif self.path == "/grid" and (grid := published().grid) is not None:
                self._reply(200, grid, "application/json")
            else:
                self._chunks()

        do_GET = do_HEAD = _answer

        def _chunks(self) -> None:
            first, _, frame = self.path.removeprefix("/").partition("/")
            number = frame.isascii() and frame.isdigit() and len(frame) <= LONGEST
            if first != "chunks" or not (number or self.path == "/chunks"):
                self._reply(404, b"no such page\n", "text/plain")
                return
            found = published().since(int(frame) if number else None)
            if found is None:
                self._reply(410, b"gone\n", "text/plain")
            else:
                self._reply(200, found, "application/json")

        def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
            """Refused by the library: every method but GET and HEAD, and malformed requests."""
            self.close_connection = True
            self._reply(405 if code == 501 else code, b"refused\n", "text/plain")

        def _reply(self, status: int, content: bytes, kind: str) -> None:
            self.send_response(status)
            for name, value in HEADERS.items():
                self.send_header(name, value)
            if status == 405:
                self.send_header("Allow", "GET, HEAD")
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            """Not on the terminal."""

    return Handler

"""The page during a drive: its server, and its chunks, one a second, joined to one a minute.

The driving thread adds frames and publishes; server threads read what was published last, which never changes. Memory
is bounded: single chunks are kept for two minutes, those of a minute up to `MOST` bytes in all. A page that asks for a
dropped chunk reloads: each minute begins with the whole map.

Chunks are those of the player (`eval.player.scene`). Landmarks are walls: x and y are rho [m] and alpha [rad].
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from association.names import SCAN
from data.errors import UsageError
from data.result import DISCARD, MapState
from data.se2 import Array
from data.terminal import message_of
from eval.figures.style import style_of
from eval.player.pack import TIME, Pack, text_of
from eval.player.scene import Head, RunHead, add_changes, add_path, add_points, dashes
from eval.player.watch import MapChanges, spread
from wings.robot.live.session import Online, Taken
from wings.robot.log import SENSOR

QUANTUM = 1.0e-3  # m, rad: smaller changes of a wall are left out
POSE = 1.0e-4  # m


@dataclass(frozen=True)
class Chunk:
    """Frames from `first` to before `end`, as JSON."""

    first: int
    end: int
    text: bytes


def key_of(number: int) -> str:
    """Prefix of the names of an estimator's arrays."""
    return f"r{number}."


def chunk_of(taken: Sequence[Taken], changes: Sequence[Array], header: Mapping[str, object]) -> Chunk:
    """Frames, at least one, with the changes (C, 8) of each estimator's map meanwhile, as JSON with this header."""
    frames = [t.frame for t in taken]
    z, R = (np.concatenate([getattr(f.observations, name) for f in frames]) for name in ("z", "R"))
    points, covariance = SENSOR.body_points(z, R)
    pack = Pack(frames[0].number, len(frames))
    pack.add("time", np.array([f.time for f in frames]), TIME)
    pack.add("count", np.array([float(len(f.observations.z)) for f in frames]))
    add_points(pack, "point", points, spread(covariance), POSE)
    for i, changed in enumerate(changes):
        steps, key = [t.steps[i] for t in taken], key_of(i)
        poses = np.full((len(frames), 6), np.nan)  # x, y, theta, and their sigmas
        rho, nis = np.full(len(frames), np.nan), np.full(len(frames), np.nan)
        for k, step in enumerate(steps):
            if step is not None:
                poses[k, :3], poses[k, 3:] = step.mean, np.sqrt(np.maximum(np.diag(step.covariance), 0.0))
                rho[k], nis[k] = spread(step.covariance[None])[0, 2], step.nis
        blank = [np.full(len(f.observations.z), DISCARD) for f in frames]
        decisions = [b if s is None else s.decisions for b, s in zip(blank, steps, strict=True)]
        created = [b if s is None else s.created for b, s in zip(blank, steps, strict=True)]
        add_path(pack, f"{key}online", poses[:, :3], poses[:, 3:], rho, POSE)
        pack.add_log(f"{key}nis", nis)
        pack.add(f"{key}decision", np.concatenate(decisions).astype(float))
        pack.add(f"{key}created", np.concatenate(created).astype(float))
        frame, number, there = changed[:, :3].astype(np.int64).T
        add_changes(pack, key, frame, number, there, changed[:, 3:5], changed[:, 5:], QUANTUM)
    return Chunk(frames[0].number, frames[0].number + len(frames), text_of(pack.done(header)).encode())


MINUTE = 240  # frames, at least, of a large chunk
MOST = 4_000_000  # bytes of large chunks: hours of a drive


@dataclass(frozen=True)
class Published:
    """All available chunks."""

    large: tuple[Chunk, ...] = ()  # in the order of time; a minute may be in both
    small: tuple[Chunk, ...] = ()
    ended: bool = False  # no more will come
    grid: bytes | None = None  # the newest one, as of `wings.robot.live.session.GridPainter`
    grids: int = 0  # how many there have been

    @property
    def begin(self) -> int:
        """The first available frame, 0 if there is none."""
        return (self.large or self.small)[0].first if self.large or self.small else 0

    def since(self, frame: int | None) -> bytes | None:
        """JSON with the chunks from a frame on, or with all of them; None where no chunk begins with that frame."""
        end = max((c.end for c in self.large + self.small), default=0)
        at = self.begin if frame is None else frame
        by_first = {c.first: c for c in self.small} | {c.first: c for c in self.large}  # large chunks take precedence
        found = []
        while at < end:
            chunk = by_first.get(at)
            if chunk is None:
                return None
            found.append(chunk.text)
            at = chunk.end
        if at != end:
            return None
        return b'{"ended":%s,"chunks":[%s]}' % (b"true" if self.ended else b"false", b",".join(found))


class Feed:
    """Takes frames, publishes chunks."""

    def __init__(self, estimators: int) -> None:
        self.published = Published()  # read it from any thread; it is replaced as a whole
        self._known = [MapChanges(QUANTUM) for _ in range(estimators)]
        self.waiting: list[Taken] = []  # unpublished frames
        self._minute: list[Taken] = []  # of the present minute: frames, and changes of each map
        self._changes = [np.empty((0, 8))] * estimators

    def add(self, taken: Taken) -> None:
        """Add a frame for the next `publish`."""
        self.waiting.append(taken)

    def publish(self, maps: Sequence[MapState | None], header: Mapping[str, object]) -> None:
        """Make a chunk of the waiting frames, if any; maps are those after the last frame."""
        if not self.waiting:
            return
        p, new = self.published, self.waiting
        header = {**header, "grids": p.grids}
        changes = [
            np.empty((0, 8)) if state is None else known.since(new[-1].frame.number, state, whole=not self._minute)
            for known, state in zip(self._known, maps, strict=True)
        ]
        large, small = p.large, (*p.small, chunk_of(new, changes, header))
        self.waiting, self._minute = [], self._minute + new
        self._changes = [np.concatenate(both) for both in zip(self._changes, changes, strict=True)]
        if len(self._minute) >= MINUTE:
            large = (*large, chunk_of(self._minute, self._changes, header))
            self._minute, self._changes = [], [np.empty((0, 8))] * len(self._known)
            while sum(len(c.text) for c in large) > MOST and len(large) > 1:
                large = large[1:]
            # keep this minute and the one before, for pages that have not fetched them yet
            begin = large[-2].first if len(large) > 1 else large[-1].first
            small = tuple(c for c in small if c.first >= begin)
        self.published = replace(p, large=large, small=small)

    def show(self, grid: bytes) -> None:
        """Publish a grid instead of the last one; the next chunk says so."""
        self.published = replace(self.published, grid=grid, grids=self.published.grids + 1)

    def end(self) -> None:
        """No more frames will come."""
        self.published = replace(self.published, ended=True)


def header(name: str, estimating: Sequence[Online], status: str) -> dict[str, object]:
    """Header of a chunk: a log without truth or labels, walls as landmarks, and `now`, the status."""
    runs = []
    for number, each in enumerate(estimating):
        style = style_of(each.name)
        run = RunHead(
            key=key_of(number), name=f"{style.label} {each.association}", estimator=each.name,
            association=each.association, colour=style.colour, dash=dashes(style.line),
            status="ended" if each.failure else "ok", why=each.failure, covariances=not each.smooths,
            decides=each.association != SCAN,
        )  # fmt: skip
        runs.append(run)
    return {**asdict(Head(name, QUANTUM, runs, walls=True)), "now": status}


ADDRESS = "127.0.0.1"
PATIENCE = 10.0  # s after which a silent connection is closed
LONGEST = 12  # digits of a frame's number
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Cache-Control": "no-store", "Content-Security-Policy": POLICY, "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff",
}  # fmt: skip


class Server(AbstractContextManager["Server"]):
    """HTTP server of the page, in its own threads: read only, the page and its chunks, no files; `with` ends it.

    Bound to 127.0.0.1. Other pages in the same browser cannot read it: foreign host names (even if they resolve to
    127.0.0.1) and other origins are refused.
    """

    def __init__(self, port: int, page: bytes, published: Callable[[], Published]) -> None:
        """Listen; port 0 is any free one. Raises UsageError: the port is not available."""
        try:
            self._http = ThreadingHTTPServer((ADDRESS, port), _handler(page, published))
        except OSError as fault:
            raise UsageError(f"--port {port}: {message_of(fault)}") from None
        self._http.daemon_threads = True
        self.address = f"http://{ADDRESS}:{self._http.server_address[1]}/"  # of the page
        self._thread = threading.Thread(target=self._http.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        self._thread.start()

    def __exit__(self, *_: object) -> None:
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

"""Chunks for the page during a drive: one a second, joined to one a minute.

The driving thread adds frames and publishes; server threads read what was published last, which never changes. Memory
is bounded: single chunks are kept for two minutes, those of a minute up to `MOST` bytes in all. A page that asks for a
dropped chunk reloads: each minute begins with the whole map.

Chunks are those of the player (`eval.player.scene`). Landmarks are walls: x and y are rho [m] and alpha [rad].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from association.names import SCAN
from data.result import DISCARD, MapState
from data.se2 import Array
from eval.figures.style import style_of
from eval.player.pack import TIME, Pack, text_of
from eval.player.scene import Head, RunHead, add_changes, add_path, add_points, dashes
from eval.player.watch import MapChanges, spread
from wings.robot.live.session import Online, Taken
from wings.robot.log import SENSOR

QUANTUM = 1.0e-3  # m, rad: smaller changes of a wall are left out
POSE = 1.0e-4  # m


@dataclass(frozen=True, eq=False)
class Part:
    """Consecutive frames."""

    first: int
    frames: int
    arrays: Mapping[str, Array]  # by name, rows in the order of time; `change` holds rows of `MapChanges`


def key_of(number: int) -> str:
    """Prefix of the names of an estimator's arrays."""
    return f"r{number}."


def part_of(taken: Sequence[Taken], changes: Sequence[Array]) -> Part:
    """Frames, at least one, with the changes (C, 8) of each estimator's map meanwhile."""
    frames = [t.frame for t in taken]
    z, R = (np.concatenate([getattr(f.observations, name) for f in frames]) for name in ("z", "R"))
    points, covariance = SENSOR.body_points(z, R)
    arrays: dict[str, Array] = {
        "time": np.array([f.time for f in frames]),
        "count": np.array([float(len(f.observations.z)) for f in frames]),
        "point": points,
        "point_spread": spread(covariance),
    }
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
        made, begun = (np.concatenate(rows).astype(float) for rows in (decisions, created))
        own = {"pose": poses, "rho": rho, "nis": nis, "change": changed, "decision": made, "created": begun}
        arrays |= {f"{key}{name}": values for name, values in own.items()}
    return Part(frames[0].number, len(frames), arrays)


def joined(parts: Sequence[Part]) -> Part:
    """Join consecutive parts."""
    names = parts[0].arrays
    arrays = {name: np.concatenate([part.arrays[name] for part in parts]) for name in names}
    return Part(parts[0].first, sum(part.frames for part in parts), arrays)


def chunk_of(part: Part, header: Mapping[str, object]) -> bytes:
    """A part as a chunk, in JSON, with this header."""
    pack, a = Pack(part.first, part.frames), part.arrays
    pack.add("time", a["time"], TIME)
    pack.add("count", a["count"])
    add_points(pack, "point", a["point"], a["point_spread"], POSE)
    for key in sorted({name.partition(".")[0] + "." for name in a if "." in name}):
        poses, changes = a[f"{key}pose"], a[f"{key}change"]
        add_path(pack, f"{key}online", poses[:, :3], poses[:, 3:], a[f"{key}rho"], POSE)
        pack.add_log(f"{key}nis", a[f"{key}nis"])
        pack.add(f"{key}decision", a[f"{key}decision"])
        pack.add(f"{key}created", a[f"{key}created"])
        frame, number, there = changes[:, :3].astype(np.int64).T
        add_changes(pack, key, frame, number, there, changes[:, 3:5], changes[:, 5:], QUANTUM)
    return text_of(pack.done(header)).encode()


MINUTE = 240  # frames, at least, of a large chunk
MOST = 4_000_000  # bytes of large chunks: hours of a drive


@dataclass(frozen=True)
class Chunk:
    """Frames from `first` to before `end`, as JSON."""

    first: int
    end: int
    text: bytes


@dataclass(frozen=True)
class Published:
    """All available chunks."""

    large: tuple[Chunk, ...] = ()  # in the order of time; a minute may be in both
    small: tuple[Chunk, ...] = ()
    ended: bool = False  # no more will come
    grid: bytes | None = None  # the newest one, as of `wings.robot.live.grid`
    grids: int = 0  # how many there have been

    @property
    def begin(self) -> int:
        """The first available frame, 0 if there is none."""
        return (self.large or self.small)[0].first if self.large or self.small else 0

    def since(self, frame: int | None) -> bytes | None:
        """JSON with the chunks from a frame on, or with all of them; None where no chunk begins with that frame."""
        end = max((c.end for c in self.large + self.small), default=0)
        at = self.begin if frame is None else frame
        # large chunks take precedence
        by_first = {c.first: c for c in self.small} | {c.first: c for c in self.large}
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
        self._waiting: list[Taken] = []
        self._parts: list[Part] = []  # of the present minute

    def add(self, taken: Taken) -> None:
        """Add a frame for the next `publish`."""
        self._waiting.append(taken)

    @property
    def waiting(self) -> int:
        """Number of unpublished frames."""
        return len(self._waiting)

    def publish(self, maps: Sequence[MapState | None], header: Mapping[str, object]) -> None:
        """Make a chunk of the waiting frames, if any; maps are those after the last frame."""
        if not self._waiting:
            return
        header = {**header, "grids": self.published.grids}
        frame, whole = self._waiting[-1].frame.number, not self._parts
        changes = [
            np.empty((0, 8)) if state is None else known.since(frame, state, whole=whole)
            for known, state in zip(self._known, maps, strict=True)
        ]
        part = part_of(self._waiting, changes)
        self._waiting = []
        self._parts.append(part)
        p = self.published
        large, small = p.large, (*p.small, _chunk(part, header))
        minute = joined(self._parts)
        if minute.frames >= MINUTE:
            large, self._parts = (*large, _chunk(minute, header)), []
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


def _chunk(part: Part, header: Mapping[str, object]) -> Chunk:
    return Chunk(part.first, part.first + part.frames, chunk_of(part, header))


def header(name: str, estimating: Sequence[Online], status: str) -> dict[str, object]:
    """Header of a chunk: a log without truth or labels, walls as landmarks, and `now`, the status."""
    runs = [_run(number, each) for number, each in enumerate(estimating)]
    return {**asdict(Head(name, QUANTUM, runs, walls=True)), "now": status}


def _run(number: int, each: Online) -> RunHead:
    association, style = each.association, style_of(each.name)
    return RunHead(
        key=key_of(number),
        name=f"{style.label} {association}",
        estimator=each.name,
        association=association,
        colour=style.colour,
        dash=dashes(style.line),
        status="ended" if each.failure else "ok",
        why=each.failure,
        covariances=not each.smooths,
        decides=each.association != SCAN,
    )

"""Chunks for the page, made while the robot drives: one a second, a minute's together once it is over.

The driving thread adds frames and publishes; whoever serves the page reads what was published last, which never
changes. Memory is bounded: single chunks are kept for two minutes, those of a minute up to `MOST` bytes in all. A page
that asks for what is gone begins anew with what there is: each minute begins with the whole map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from data.result import MapState
from eval.online.rows import Maps, Part, chunk_of, joined, part_of
from eval.online.session import Taken

MINUTE = 240
"""Frames, at least, of a large chunk."""
MOST = 4_000_000
"""Bytes of large chunks: hours of a drive, as walls and estimators are."""


@dataclass(frozen=True)
class Chunk:
    """Frames from `first` up to `end`, which it does not hold, as JSON."""

    first: int
    end: int
    text: bytes


@dataclass(frozen=True)
class Published:
    """All that the page can be given.

    Attributes:
        large, small: in the order of time; a minute may be in both.
        ended: no more will come.
    """

    large: tuple[Chunk, ...] = ()
    small: tuple[Chunk, ...] = ()
    ended: bool = False

    @property
    def begin(self) -> int:
        """The first frame there is, 0 where there is none yet."""
        return (self.large or self.small)[0].first if self.large or self.small else 0

    def since(self, frame: int | None) -> bytes | None:
        """JSON with the chunks from a frame on, or with all there are; None where no chunk begins with that frame."""
        end = max((c.end for c in self.large + self.small), default=0)
        at = self.begin if frame is None else frame
        # of two that begin with a frame the large one
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
    """Takes frames, publishes chunks.

    Attributes:
        published: read it from any thread; it is replaced as a whole.
    """

    def __init__(self, estimators: int) -> None:
        """Nothing to show yet."""
        self.published = Published()
        self._maps = Maps(estimators)
        self._waiting: list[Taken] = []
        self._parts: list[Part] = []  # of the minute that is not over

    def add(self, taken: Taken) -> None:
        """A frame, which waits for the next `publish`."""
        self._waiting.append(taken)

    @property
    def waiting(self) -> int:
        """Frames that were not published yet."""
        return len(self._waiting)

    def publish(self, maps: Sequence[MapState | None], header: Mapping[str, object]) -> None:
        """The frames that wait become a chunk; maps as they are after the last one. Without frames nothing happens."""
        if not self._waiting:
            return
        changes = self._maps.changes(self._waiting[-1].frame.number, maps, whole=not self._parts)
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
            # those of this minute and the one before, for pages that have not fetched them yet
            begin = large[-2].first if len(large) > 1 else large[-1].first
            small = tuple(c for c in small if c.first >= begin)
        self.published = replace(p, large=large, small=small)

    def end(self) -> None:
        """No more will come."""
        self.published = replace(self.published, ended=True)


def _chunk(part: Part, header: Mapping[str, object]) -> Chunk:
    return Chunk(part.first, part.first + part.frames, chunk_of(part, header))

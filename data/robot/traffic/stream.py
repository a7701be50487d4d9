"""Records of a line to packets and faults: where answers begin in bytes that have no marker and no checksum.

A lost byte shifts everything behind it. Evidence that an answer begins at a byte, in points:

     1  it is possible: every distance in range, and the robot can have come there since the last packet
    +1  the bytes before it were used as a packet
    +1  a pause goes before it, +1 a pause comes after it (bytes of an answer follow each other, answers do not)
    -2  a pause is inside it: held up on the way, or bytes of two answers
    +1  for each of the next two behind it that is possible after it

`ENOUGH` points make a packet; without a packet from which the robot can have come `ALONE`, and then either a pause
goes before it or no other place begins three answers in a row. Three in a row that the robot can only have reached
while the line was held up (it drives on until its watchdog stops it) are used as well; three that it cannot have
reached at all show that its odometry began anew. What is not possible is never used, whatever its evidence.
The same code runs while records come in and when they are read again.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple, Protocol

from data.robot.packets import ANSWER_BYTES, ANSWER_TIMEOUT, FRAME_BYTES, PERIOD, Answer, decode_answer, next_frame
from data.robot.traffic.motion import Heard, Packet, Unwrapper, came_from, possible, reachable
from data.robot.traffic.recording import GONE, RECEIVED, SENT, Record

PAUSE = 0.1
"""s. Bytes of an answer come within an adapter's 16 ms, answers are 0.2 s apart; the middle."""
FRAME_SIZE = ANSWER_BYTES + FRAME_BYTES
ENOUGH, ALONE = 2, 3
CHAIN = 3
"""Answers that go with each other when odometry began anew."""
KEPT = 4 * ANSWER_BYTES
"""Bytes among which an answer is looked for; older ones are given up."""
SHORT, SHIFTED, GARBAGE = "short", "shifted", "garbage"
SURE = {2: 0.999, 3: 0.9999}
"""By points: share of answers that are one; see tests/data/robot/test_stream.py for what was measured."""


class _Place(NamedTuple):
    """Where an answer begins, its points, and whether the robot can have come there from the last packet."""

    k: int
    points: int
    joined: bool

    @property
    def rank(self) -> tuple[bool, int]:
        return self.joined, self.points


class Stream(Protocol):
    """Bytes in, packets out."""

    faults: Counter[str]

    def feed(self, t: float | None, data: bytes) -> list[Packet]:
        """The packets that these bytes complete, oldest first; t [s] is when they came, None where nobody knows."""


class Unframed:
    """Packets of a stream without markers.

    Attributes:
        faults: pieces given up, by name: `short`, less than an answer between two pauses; `garbage`, as long as an
            answer or longer, but not possible; `shifted`, an answer that begins at another byte than the ones before
            led to expect, with no pause to show it.
    """

    def __init__(self) -> None:
        """Nothing received yet."""
        self.faults: Counter[str] = Counter()
        self._bytes = bytearray()
        self._stamps: list[float] = []
        self._fresh: list[bool] = []  # a pause goes before the byte
        self._last: tuple[float, Answer] | None = None
        self._contiguous = False  # the byte before the first pending one ended a packet
        self._came: float | None = None
        self._clock = 0.0
        self._unwrapper = Unwrapper()

    def feed(self, t: float | None, data: bytes) -> list[Packet]:
        """The packets that these bytes complete, oldest first; t [s] is when they came, None where nobody knows."""
        if not data:
            return []
        begins = t is not None and (self._came is None or t - self._came > PAUSE)
        if t is None:  # the stream itself is the clock
            self._stamps += [self._clock + (i + 1) * PERIOD / ANSWER_BYTES for i in range(len(data))]
        else:
            self._stamps += [t] * len(data)
            self._came = t
        self._clock = self._stamps[-1]
        self._bytes += data
        self._fresh += [begins] + [False] * (len(data) - 1)
        found: list[Packet] = []
        while (best := self._best()) is not None:
            found.append(self._take(best))
        self._give_up(len(self._bytes) - KEPT)
        return found

    def _best(self) -> _Place | None:
        """Where the next packet begins; None where no place is sure."""
        best: _Place | None = None
        for k in range(len(self._bytes) - ANSWER_BYTES + 1):
            place = self._place(k)
            if place is not None and (best is None or place.rank > best.rank):
                best = place
            if best is not None and best.k == 0 and best.joined and best.points >= ALONE:  # the usual case
                break
        return best

    def _answer(self, k: int) -> Answer | None:
        """The answer that begins at byte k, if it is whole and possible."""
        if k + ANSWER_BYTES > len(self._bytes):
            return None
        answer = decode_answer(bytes(self._bytes[k : k + ANSWER_BYTES]))
        return answer if possible(answer) else None

    def _stamp(self, k: int) -> float:
        """Of the last byte of the answer that begins at byte k."""
        return self._stamps[k + ANSWER_BYTES - 1]

    def _place(self, k: int) -> _Place | None:
        """An answer that begins at byte k, if the evidence is enough."""
        answer = self._answer(k)
        if answer is None:
            return None
        chain = self._chain(k, answer)
        end = k + ANSWER_BYTES
        torn = any(self._fresh[k + 1 : end])
        joined = False
        if self._last is not None:
            elapsed = self._stamp(k) - self._last[0]
            joined = came_from(self._last[1], answer, elapsed, held_up=chain >= CHAIN and not torn)
        if not joined:
            anchored = self._fresh[k] or (chain >= CHAIN and self._only(k))
            if torn or not anchored or (self._last is not None and chain < CHAIN):
                return None
        points = (
            chain
            + (k == 0 and self._contiguous and joined)
            + self._fresh[k]
            + (end < len(self._bytes) and self._fresh[end])
            - 2 * torn
        )
        return _Place(k, points, joined) if points >= (ENOUGH if joined else ALONE) else None

    def _only(self, k: int) -> bool:
        """Whether no other alignment has as long a chain: a robot at rest repeats itself at every one."""
        for other in range(min(2 * ANSWER_BYTES, len(self._bytes))):
            answer = self._answer(other)
            if (other - k) % ANSWER_BYTES and answer is not None and self._chain(other, answer) >= CHAIN:
                return False
        return True

    def _chain(self, k: int, answer: Answer) -> int:
        """How many answers from byte k on, up to `CHAIN`, can follow each other."""
        for n in range(1, CHAIN):
            behind = self._answer(k + ANSWER_BYTES)
            if behind is None or not reachable(answer, behind, self._stamp(k + ANSWER_BYTES) - self._stamp(k)):
                return n
            k, answer = k + ANSWER_BYTES, behind
        return CHAIN

    def _take(self, place: _Place) -> Packet:
        k = place.k
        if k % ANSWER_BYTES and not self._fresh[k]:
            self.faults[SHIFTED] += 1
            self._drop(k)
        else:
            self._give_up(k)
        answer, t = decode_answer(bytes(self._bytes[:ANSWER_BYTES])), self._stamp(0)
        self._drop(ANSWER_BYTES)
        self._contiguous = True
        self._last = (t, answer)
        return self._unwrapper.packet(Heard(t, answer, SURE[min(place.points, max(SURE))]), place.joined)

    def _give_up(self, count: int) -> None:
        """Drop bytes and count what they were: pieces between pauses."""
        if count <= 0:
            return
        starts = [0, *(i for i in range(1, count) if self._fresh[i]), count]
        for a, b in itertools.pairwise(starts):
            self.faults[SHORT if b - a < ANSWER_BYTES else GARBAGE] += 1
        self._drop(count)
        self._contiguous = False

    def _drop(self, count: int) -> None:
        del self._bytes[:count], self._stamps[:count], self._fresh[:count]


class Framed:
    """Packets of a stream of frames: the checksum says which bytes are an answer, the robot's motion is asked as well.

    Attributes:
        faults: pieces that are no frame, by name: `short`, less than one; `garbage`, others, or not possible.
    """

    def __init__(self) -> None:
        """Nothing received yet."""
        self.faults: Counter[str] = Counter()
        self._bytes = bytearray()
        self._last: tuple[float, Answer] | None = None
        self._refused: list[tuple[float, Answer]] = []
        self._clock = 0.0
        self._unwrapper = Unwrapper()

    def feed(self, t: float | None, data: bytes) -> list[Packet]:
        """The packets that these bytes complete, oldest first; t [s] is when they came, None where nobody knows."""
        self._bytes += data
        found: list[Packet] = []
        while True:
            used, content = next_frame(self._bytes, ANSWER_BYTES)
            if junk := used - FRAME_SIZE * (content is not None):
                self.faults[SHORT if junk < FRAME_SIZE else GARBAGE] += 1
            del self._bytes[:used]
            if content is None:
                return found
            self._clock = self._clock + PERIOD if t is None else t
            found += self._judged(self._clock, decode_answer(content))

    def _judged(self, t: float, answer: Answer) -> list[Packet]:
        """The packet, if it is possible; three in a row that it is only after each other are judged together."""
        if not possible(answer):
            self.faults[GARBAGE] += 1
            return []
        row = [*self._refused, (t, answer)]
        if self._refused and not reachable(self._refused[-1][1], answer, t - self._refused[-1][0]):
            row = row[-1:]
        joined = False
        if self._last is not None:
            # the checksum vouches for the bytes, so an answer that was held up need not wait for others like it
            if came_from(self._last[1], answer, t - self._last[0], held_up=True):
                joined, row = True, row[-1:]
            elif len(row) < CHAIN:
                self.faults[GARBAGE] += len(self._refused) + 1 - len(row)
                self._refused = row
                return []
        self.faults[GARBAGE] += len(self._refused) + 1 - len(row)
        self._refused, self._last = [], row[-1]
        sure = 1.0 - 2.0**-16
        return [self._unwrapper.packet(Heard(*each, sure), joined or i > 0) for i, each in enumerate(row)]


LOST, LATE, DEVICE_GONE = "lost", "late", "device gone"
FAULTS = (LOST, LATE, SHORT, SHIFTED, GARBAGE, DEVICE_GONE)
"""lost: nothing came after a command. late: an answer after its time; it is used, unless a newer one came with it.
short, shifted, garbage: see `data.robot.traffic.stream.Unframed`. device gone: the line broke off."""


class Exchange:
    """Commands and answers of a link, record by record.

    The time of a packet is that of the bytes that ended it; of several that came at once only the newest is used, so
    times increase.
    """

    def __init__(self, *, framed: bool) -> None:
        """Before the first record."""
        self._stream: Stream = Framed() if framed else Unframed()
        self._counted: Counter[str] = Counter()
        self._asked: float | None = None  # when the command was sent that has no answer yet
        self._silent = True  # since then
        self._unanswered = 0  # commands that were given up as lost, in a row

    @property
    def faults(self) -> dict[str, int]:
        """How often each of `FAULTS` was met so far."""
        both = self._counted + self._stream.faults
        return {name: both[name] for name in FAULTS}

    def consume(self, record: Record) -> list[Packet]:
        """The packets that can be used now, oldest first, times increasing."""
        if record.kind == SENT:
            if self._asked is not None and self._silent:
                self._counted[LOST] += 1
                self._unanswered += 1
            self._asked, self._silent = record.t, True
        elif record.kind == GONE:
            self._counted[DEVICE_GONE] += 1
            self._asked, self._unanswered = None, 0
        elif record.kind == RECEIVED:
            self._silent = False
            return self._received(record)
        return []

    def _received(self, record: Record) -> list[Packet]:
        packets = self._stream.feed(record.t, record.data)
        used: list[Packet] = []
        for packet in packets:
            if used and used[-1].t == packet.t:
                self._late()
                packet = replace(packet, joined=packet.joined and used.pop().joined)
            used.append(packet)
        if used:
            if self._asked is None or record.t - self._asked > ANSWER_TIMEOUT:
                self._late()
            self._asked, self._unanswered = None, 0
        return used

    def _late(self) -> None:
        """An answer that was taken for lost, if one was, is late."""
        self._counted[LATE] += 1
        if self._unanswered:
            self._unanswered -= 1
            self._counted[LOST] -= 1


def decoded(records: Iterable[Record], *, framed: bool) -> tuple[list[Packet], dict[str, int]]:
    """All packets of records, and how often each of `FAULTS` was met; as the link had them when they came."""
    exchange = Exchange(framed=framed)
    packets = [packet for record in records for packet in exchange.consume(record)]
    return packets, exchange.faults

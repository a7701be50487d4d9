"""Records of a line to packets and faults: finding answers in bytes without marker and checksum.

A lost byte shifts all later ones. Evidence that an answer begins at a byte, in points:

     1  it is possible: every distance in range, and reachable from the last packet
     +1  the bytes before it were used as a packet
     +1  a pause precedes it, +1 a pause follows it (answers have pauses between them, not inside)
     -2  a pause is inside it: delayed, or bytes of two answers
     +1  for each of the next two answers that is possible after it

`ENOUGH` points make a packet. Where no packet precedes from which it is reachable, `ALONE` points are needed, and a
pause before it or three answers in a row at no other alignment. Three in a row that are reachable only if the line was
delayed are used as well; three that are not reachable at all show that the odometry restarted. Impossible answers are
never used. The same code runs live and on recordings.

Odometry is counted in int16 and overflows; between packets the robot moves less than half the counters' range, so
differences modulo 2^16 are right. Odometry that restarted continues from the last pose, and the packet says that the
motion in between is unknown.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from data.se2 import Array, between, compose
from wings.robot.packets import (
    ANSWER_BYTES,
    ANSWER_TIMEOUT,
    FASTEST,
    FASTEST_TURN,
    FRAME_BYTES,
    MARKER,
    PERIOD,
    TIMEOUT_MM,
    WATCHDOG,
    Answer,
    decode_answer,
    next_frame,
    overflowed,
)
from wings.robot.scan_packets import SCAN_BYTES, SCAN_MARKER, TORN, Beams, Scan, ScanParts
from wings.robot.traffic.recording import GONE, RECEIVED, SENT, Record

SLACK = 0.1  # s, largest delay of a byte's stamp
ROUNDING = 2  # mm, mrad: rounding of a difference, and one for the ticks


@dataclass(frozen=True)
class Packet:
    """A usable answer.

    Attributes:
        t: s, time of its last byte.
        ranges: (8,) m, inf for no echo.
        odometry: (3,) pose by the wheels [m, m, rad], heading included unwrapped.
        joined: False where the motion since the last packet is unknown: the first packet, or restarted odometry.
        answer: the transmitted numbers.
        scan: the lidar's, taken where the odometry is that of the answer; None: no lidar, or the scan was lost.
    """

    t: float
    ranges: Array
    odometry: Array
    joined: bool
    answer: Answer
    scan: Scan | None = None


def possible(answer: Answer) -> bool:
    """Whether each distance lies between 0 and the timeout value; the pose may have any value."""
    return min(answer.distances) >= 0 and max(answer.distances) <= TIMEOUT_MM


def reachable(before: Answer, after: Answer, elapsed: float, *, held_up: bool = False) -> bool:
    """Whether the robot can have moved from one answer to the other within `elapsed` [s] and `SLACK`.

    Delayed answers come at once, so less than a period counts as one. An answer `held_up` on the line leaves the robot
    the time until its watchdog stopped it.
    """
    time = max(elapsed + WATCHDOG * held_up, PERIOD) + SLACK
    dx, dy, turn = moved(before, after)
    return (
        math.hypot(dx, dy) <= 1000.0 * FASTEST * time + ROUNDING
        and abs(turn) <= 1000.0 * FASTEST_TURN * time + ROUNDING
    )


def moved(before: Answer, after: Answer) -> tuple[int, int, int]:
    """Differences of x, y [mm] and heading [mrad], across overflow."""
    return (overflowed(after.x - before.x), overflowed(after.y - before.y), overflowed(after.heading - before.heading))


class Unwrapper:
    """Unwraps the odometry from answer to answer."""

    def __init__(self) -> None:
        self._before: Answer | None = None
        self._counted = np.zeros(3, np.int64)  # mm, mm, mrad, unwrapped
        self._base = np.zeros(3)  # pose of the odometry's frame

    def packet(self, t: float, answer: Answer, joined: bool, scan: Scan | None = None) -> Packet:
        """The next packet, see `Packet`; if not `joined`, odometry goes on from the last pose in a frame of its own."""
        present = np.array([answer.x, answer.y, answer.heading], np.int64)
        if self._before is None:
            self._counted, joined = present, False
        elif joined:
            self._counted = self._counted + moved(self._before, answer)
        else:
            # the frame in which `present` is where the last pose is; headings are not wrapped
            pose, counted = self._pose(), present / 1000.0
            self._base = compose(pose, between(counted, np.zeros(3)))
            self._base[2] = pose[2] - counted[2]
            self._counted = present
        self._before = answer
        mm = np.array(answer.distances, float)
        ranges = np.where(mm < TIMEOUT_MM, mm / 1000.0, np.inf)
        return Packet(t, ranges, self._pose(), joined, answer, scan)

    def _pose(self) -> Array:
        counted = self._counted / 1000.0
        pose = compose(self._base, counted)
        pose[2] = self._base[2] + counted[2]
        return pose


PAUSE = 0.1
"""s. Bytes of an answer come within 16 ms, answers are 0.2 s apart."""
FRAME_SIZE = ANSWER_BYTES + FRAME_BYTES
ENOUGH, ALONE = 2, 3
CHAIN = 3  # consistent answers that show that the odometry restarted
KEPT = 4 * ANSWER_BYTES  # bytes searched for an answer; older ones are dropped
SHORT, SHIFTED, GARBAGE = "short", "shifted", "garbage"


class _Place(NamedTuple):
    """An answer that begins at byte k: whether it is reachable from the last packet, and its points."""

    k: int
    joined: bool
    points: int


class Stream(ABC):
    """Bytes in, packets out; `faults` counts pieces that are no packet, by name."""

    def __init__(self) -> None:
        self.faults: Counter[str] = Counter()
        self._bytes = bytearray()
        self._last: tuple[float, Answer] | None = None
        self._unwrapper = Unwrapper()

    def missing(self) -> int:
        """Bytes to read after which something may be complete."""
        return ANSWER_BYTES

    @abstractmethod
    def feed(self, t: float, data: bytes) -> list[Packet]:
        """The packets that bytes received at t [s] complete, oldest first."""


class Unframed(Stream):
    """Packets of a stream without markers.

    Faults: `short`, less than an answer between two pauses; `garbage`, at least an answer long but impossible;
    `shifted`, an answer at an unexpected byte without a pause before it.
    """

    def __init__(self) -> None:
        super().__init__()
        self._stamps: list[float] = []
        self._fresh: list[bool] = []  # a pause precedes the byte
        self._contiguous = False  # the byte before the first pending one ended a packet
        self._came = -math.inf

    def feed(self, t: float, data: bytes) -> list[Packet]:
        """See `Stream.feed`."""
        if not data:
            return []
        self._bytes += data
        self._stamps += [t] * len(data)
        self._fresh += [t - self._came > PAUSE] + [False] * (len(data) - 1)
        self._came = t
        found: list[Packet] = []
        while (best := self._best()) is not None:
            found.append(self._take(best))
        self._give_up(len(self._bytes) - KEPT)
        return found

    def _best(self) -> _Place | None:
        """Where the next packet begins; None where no place has enough points."""
        best: _Place | None = None
        for k in range(len(self._bytes) - ANSWER_BYTES + 1):
            place = self._place(k)
            if place is not None and (best is None or place[1:] > best[1:]):
                best = place
            if best is not None and best.k == 0 and best.joined and best.points >= ALONE:  # the usual case
                break
        return best

    def _answer(self, k: int) -> Answer | None:
        """The answer at byte k, if it is complete and possible."""
        if k + ANSWER_BYTES > len(self._bytes):
            return None
        answer = decode_answer(bytes(self._bytes[k : k + ANSWER_BYTES]))
        return answer if possible(answer) else None

    def _stamp(self, k: int) -> float:
        """Time [s] of the last byte of the answer at byte k."""
        return self._stamps[k + ANSWER_BYTES - 1]

    def _place(self, k: int) -> _Place | None:
        """The answer at byte k, if it has enough points."""
        answer = self._answer(k)
        if answer is None:
            return None
        chain = self._chain(k, answer)
        end = k + ANSWER_BYTES
        torn = any(self._fresh[k + 1 : end])
        joined = False
        if self._last is not None:
            elapsed = self._stamp(k) - self._last[0]
            joined = reachable(self._last[1], answer, elapsed, held_up=chain >= CHAIN and not torn)
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
        return _Place(k, joined, points) if points >= (ENOUGH if joined else ALONE) else None

    def _only(self, k: int) -> bool:
        """Whether no other alignment has as long a chain; of a robot at rest all have."""
        for other in range(min(2 * ANSWER_BYTES, len(self._bytes))):
            answer = self._answer(other)
            if (other - k) % ANSWER_BYTES and answer is not None and self._chain(other, answer) >= CHAIN:
                return False
        return True

    def _chain(self, k: int, answer: Answer) -> int:
        """Number of answers from byte k on, up to `CHAIN`, that are reachable one after the other."""
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
        return self._unwrapper.packet(t, answer, place.joined)

    def _give_up(self, count: int) -> None:
        """Drop bytes and count them as pieces between pauses."""
        if count <= 0:
            return
        starts = [0, *(i for i in range(1, count) if self._fresh[i]), count]
        for a, b in itertools.pairwise(starts):
            self.faults[SHORT if b - a < ANSWER_BYTES else GARBAGE] += 1
        self._drop(count)
        self._contiguous = False

    def _drop(self, count: int) -> None:
        del self._bytes[:count], self._stamps[:count], self._fresh[:count]


class Framed(Stream):
    """Packets of a stream of frames, checked by checksum and by the robot's motion; with scans of a lidar, or without.

    Faults: `short`, less than a frame; `garbage`, other bytes or an impossible answer; `torn`, a scan of which a packet
    is missing or damaged, with other beams than the first scan, or without the answer of the same odometry.
    """

    def __init__(self, *, scans: bool = False) -> None:
        super().__init__()
        self._sizes = {MARKER: ANSWER_BYTES, **({SCAN_MARKER: SCAN_BYTES} if scans else {})}
        self._refused: list[tuple[float, Answer]] = []
        self._parts = ScanParts(self.faults)
        self._scan: Scan | None = None  # the newest one, whose answer has not come yet
        self._beams: Beams | None = None

    def missing(self) -> int:
        """Bytes that complete the frame that has begun, or the shortest one."""
        whole = self._sizes.get(bytes(self._bytes[: len(MARKER)]), ANSWER_BYTES) + FRAME_BYTES
        return max(whole - len(self._bytes), 1)

    def feed(self, t: float, data: bytes) -> list[Packet]:
        """See `Stream.feed`."""
        self._bytes += data
        found: list[Packet] = []
        while True:
            used, marker, content = next_frame(self._bytes, self._sizes)
            if junk := used - (0 if content is None else len(content) + FRAME_BYTES):
                self.faults[SHORT if junk < FRAME_SIZE else GARBAGE] += 1
            del self._bytes[:used]
            if content is None:
                return found
            if marker == SCAN_MARKER:
                self._scanned(self._parts.add(content))
            else:
                found += self._judged(t, decode_answer(content))

    def _scanned(self, scan: Scan | None) -> None:
        """Keep a whole scan for its answer."""
        if scan is not None:
            self.faults[TORN] += self._scan is not None
            self._beams = self._beams or scan.beams
            self._scan = scan if scan.beams == self._beams else None
            self.faults[TORN] += self._scan is None

    def _scan_of(self, answer: Answer) -> Scan | None:
        """The scan that belongs to an answer; one is kept for one answer only."""
        self._parts.give_up()
        scan, self._scan = self._scan, None
        if scan is None or scan.odometry == answer[1:]:
            return scan
        self.faults[TORN] += 1
        return None

    def _judged(self, t: float, answer: Answer) -> list[Packet]:
        """The packet, if it is possible; three in a row that are reachable only from each other are used together."""
        scan = self._scan_of(answer)
        if not possible(answer):
            self.faults[GARBAGE] += 1
            return []
        row = [*self._refused, (t, answer)]
        if self._refused and not reachable(self._refused[-1][1], answer, t - self._refused[-1][0]):
            row = row[-1:]
        joined = False
        if self._last is not None:
            # the checksum vouches for the bytes, so a delayed answer need not wait for others
            if reachable(self._last[1], answer, t - self._last[0], held_up=True):
                joined, row = True, row[-1:]
            elif len(row) < CHAIN:
                self.faults[GARBAGE] += len(self._refused) + 1 - len(row)
                self._refused = row
                return []
        self.faults[GARBAGE] += len(self._refused) + 1 - len(row)
        self._refused, self._last = [], row[-1]
        return [
            self._unwrapper.packet(*each, joined or i > 0, scan if i + 1 == len(row) else None)
            for i, each in enumerate(row)
        ]


LOST, LATE, DEVICE_GONE = "lost", "late", "device gone"
FAULTS = (LOST, LATE, SHORT, SHIFTED, GARBAGE, TORN, DEVICE_GONE)
"""lost: no answer to a command. late: an answer after its time; it is used, unless a newer one came with it. short,
shifted, garbage: see `Unframed`. torn: see `Framed`. device gone: the device disappeared."""


class Exchange:
    """Commands and answers of a link, record by record.

    A packet's time is that of its last bytes; of several received at once only the newest is used, so times increase.
    """

    def __init__(self, *, framed: bool, scans: bool = False) -> None:
        """`scans`: those of a lidar come in frames, too."""
        self._stream: Stream = Framed(scans=scans) if framed or scans else Unframed()
        self._counted: Counter[str] = Counter()
        self._asked: float | None = None  # time of the unanswered command
        self._silent = True  # no byte since then
        self._unanswered = 0  # consecutive commands counted as lost

    @property
    def faults(self) -> dict[str, int]:
        """Counts of each of `FAULTS` so far."""
        both = self._counted + self._stream.faults
        return {name: both[name] for name in FAULTS}

    @property
    def missing(self) -> int:
        """Bytes to read after which something may be complete."""
        return self._stream.missing()

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
        used: list[Packet] = []
        for packet in self._stream.feed(record.t, record.data):
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
        """Count a late answer, which may have been counted as lost."""
        self._counted[LATE] += 1
        if self._unanswered:
            self._unanswered -= 1
            self._counted[LOST] -= 1


def decoded(records: Iterable[Record], *, framed: bool, scans: bool = False) -> tuple[list[Packet], dict[str, int]]:
    """All packets of records, and the counts of each of `FAULTS`; as the live link had them."""
    exchange = Exchange(framed=framed, scans=scans)
    packets = [packet for record in records for packet in exchange.consume(record)]
    return packets, exchange.faults

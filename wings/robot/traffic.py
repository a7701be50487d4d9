"""The line's traffic: its recording, a folder with `log.toml` and `packets.bin`; records to packets and faults.

`packets.bin` is `MAGIC` and records, little-endian:

    1 byte    kind: S command sent, R bytes received, O device opened, G device gone
    2 bytes   uint16, length of the data
    8 bytes   int64, time since the link began [us], increasing
    data
    4 bytes   CRC-32 of all that

Every record is one system write: a killed process leaves whole records and at most the beginning of one.

An answer in a frame is found by marker and checksum. One without begins where a pause ends, or where a used answer
ended; the rest of what comes without a pause is lost with an answer that is not used. Impossible answers are never
used, and those that the robot cannot have come to wait: three in a row that are reachable from each other are used
together. They were delayed, or the odometry restarted. The same code runs live and on recordings.

Odometry is counted in int16 and overflows; between packets the robot moves less than half the counters' range, so
differences modulo 2^16 are right. Odometry that restarted continues from the last pose, and the packet says that the
motion in between is unknown.
"""

import binascii
import math
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w

from data.columns.header import FORMAT
from data.csv_table import bytes_of
from data.errors import DataError, UsageError
from data.se2 import Array, between, compose
from data.toml_table import load_toml
from wings.robot import packets as protocol
from wings.robot.packets import SCAN_BYTES, SCAN_MARKER, TORN, Beams, Scan, ScanParts
from wings.robot.walls import FITS, USUAL_FIT

HEADER, PACKETS = "log.toml", "packets.bin"
MAGIC = b"robot 1\n"
SENT, RECEIVED, OPENED, GONE = b"S", b"R", b"O", b"G"
SOURCE = "robot link"
NOISE, LIDAR = ("slip", "sonar_sigma"), "lidar_sigma"
_HEAD = struct.Struct("<cHq")
_CHECK = struct.Struct("<I")


class Record(NamedTuple):
    """An event of the line: kind, time [s, whole us], bytes."""

    kind: bytes
    t: float
    data: bytes = b""


class Recorded(NamedTuple):
    """A recording as read."""

    records: list[Record]  # in the order of their times
    framed: bool  # whether the line carried frames
    cut: int  # bytes of an unfinished record at the end; 0 of a closed log
    noise: tuple[float, ...]  # stated slip [m per sqrt(m)] and sonar sigma [m]; empty if not stated
    source: Mapping[str, object]  # `[source]` of the header
    fit: str  # of walls, see `wings.robot.walls.FITS`
    lidar_sigma: float | None = None  # m, standard deviation of a lidar's range; None: no lidar


class Recording(AbstractContextManager["Recording"]):
    """A recording being written; `with` closes it."""

    def __init__(
        self, folder: Path, *, framed: bool = False, noise: tuple[float, ...] = (), fit: str = USUAL_FIT,
        lidar_sigma: float | None = None,
    ) -> None:  # fmt: skip
        """Create both files; `noise`, `fit`, `lidar_sigma` as of `Recorded`. UsageError if the folder holds a log."""
        if (folder / HEADER).exists() or (folder / PACKETS).exists():
            raise UsageError(f"{folder}: the folder holds a log already; name another folder")
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._file = (folder / PACKETS).open("xb", buffering=0)  # unbuffered: the system has it when `append` returns
        self._file.write(MAGIC)
        source = {"kind": SOURCE, "framed": framed, **dict(zip(NOISE, noise, strict=False))}
        source |= {} if fit == USUAL_FIT else {"fit": fit}
        source |= {} if lidar_sigma is None else {LIDAR: lidar_sigma}
        with (folder / HEADER).open("wb") as file:
            tomli_w.dump({"format": FORMAT, "name": folder.absolute().name, "source": source}, file)

    def append(self, record: Record) -> None:
        """Write a record through to the system."""
        head = _HEAD.pack(record.kind, len(record.data), round(record.t * 1e6)) + record.data
        self._file.write(head + _CHECK.pack(binascii.crc32(head)))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def discard(self) -> None:
        """Remove both files, and the folder if it is empty then."""
        self.close()
        for name in (PACKETS, HEADER):
            (self.folder / name).unlink()
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def __exit__(self, *_: object) -> None:
        self.close()


def read_recording(folder: Path) -> Recorded:
    """Read a recording that is finished, truncated, or still being written; DataError if it is damaged."""
    header = folder / HEADER
    contents = load_toml(header, lambda what: DataError.at(header, what), "no such file; a recording needs one")
    source = contents.get("source")
    if not isinstance(source, dict) or source.get("kind") != SOURCE or not isinstance(source.get("framed"), bool):
        raise DataError.at(header, f"not the recording of a link; [source] kind = {SOURCE!r} and framed are needed")
    noise = tuple(source[key] for key in NOISE if key in source)
    if len(noise) == 1 or not all(isinstance(v, float | int) and 0.0 <= v < math.inf for v in noise):
        raise DataError.at(header, f"[source] {' and '.join(NOISE)}: two numbers from 0 up, or neither")
    fit = source.get("fit", USUAL_FIT)
    if fit not in FITS:
        raise DataError.at(header, f"[source] fit {fit!r}: {' or '.join(FITS)} is needed")
    lidar = source.get(LIDAR)
    if lidar is not None and not (isinstance(lidar, float | int) and 0.0 < lidar < math.inf):
        raise DataError.at(header, f"[source] {LIDAR} {lidar!r}: a number above 0 is needed")
    path = folder / PACKETS
    data = bytes_of(path)
    if not data.startswith(MAGIC) and not MAGIC.startswith(data):
        raise DataError.at(path, f"begins with {data[: len(MAGIC)]!r}; {MAGIC!r} is needed")
    records, end = _records(path, data)
    return Recorded(records, source["framed"], len(data) - end, noise, source, fit, lidar)


def _records(path: Path, data: bytes) -> tuple[list[Record], int]:
    """All whole records and the position after the last one."""
    records: list[Record] = []
    at = min(len(MAGIC), len(data))
    while len(data) >= at + _HEAD.size:
        kind, length, microseconds = _HEAD.unpack_from(data, at)
        middle = at + _HEAD.size + length
        end = middle + _CHECK.size
        if end > len(data):
            break
        if _CHECK.unpack_from(data, middle)[0] != binascii.crc32(data[at:middle]):
            if end == len(data):  # after a crash a file may have its length before its contents
                break
            raise DataError.at(path, f"the record at byte {at} is damaged; {len(records)} records before it are intact")
        records.append(Record(kind, microseconds / 1e6, data[at + _HEAD.size : middle]))
        at = end
    return records, at


SLACK = 0.1  # s, largest delay of a byte's stamp
ROUNDING = 2  # mm, mrad: rounding of a difference, and one for the ticks


@dataclass(frozen=True)
class Packet:
    """A usable answer."""

    t: float  # s, time of its last byte
    ranges: Array  # (8,) m, inf for no echo
    odometry: Array  # (3,) pose by the wheels [m, m, rad], heading included unwrapped
    joined: bool  # False where the motion since the last packet is unknown: the first packet, or restarted odometry
    answer: protocol.Answer  # the transmitted numbers
    # the lidar's, taken where the odometry is that of the answer; None: no lidar, or the scan was lost
    scan: Scan | None = None


def reachable(before: protocol.Answer, after: protocol.Answer, elapsed: float, *, held_up: bool = False) -> bool:
    """Whether the robot can have moved so within `elapsed` [s] and `SLACK`; less than a period counts as one (delayed
    answers come at once), `held_up` ones leave it the time until its watchdog stopped it.
    """
    time = max(elapsed + protocol.WATCHDOG * held_up, protocol.PERIOD) + SLACK
    dx, dy, turn = moved(before, after)
    reach, most = 1000.0 * protocol.FASTEST * time + ROUNDING, 1000.0 * protocol.FASTEST_TURN * time + ROUNDING
    return math.hypot(dx, dy) <= reach and abs(turn) <= most


def moved(before: protocol.Answer, after: protocol.Answer) -> tuple[int, int, int]:
    """Differences of x, y [mm] and heading [mrad], across overflow."""
    dx, dy, turn = (protocol.overflowed(b - a) for a, b in zip(before[1:], after[1:], strict=True))
    return dx, dy, turn


class Unwrapper:
    """Unwraps the odometry from answer to answer."""

    def __init__(self) -> None:
        self._before: protocol.Answer | None = None
        self._counted = np.zeros(3, np.int64)  # mm, mm, mrad, unwrapped
        self._base = np.zeros(3)  # pose of the odometry's frame

    def packet(self, t: float, answer: protocol.Answer, joined: bool, scan: Scan | None = None) -> Packet:
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
        return Packet(t, np.where(mm < protocol.TIMEOUT_MM, mm / 1000.0, np.inf), self._pose(), joined, answer, scan)

    def _pose(self) -> Array:
        counted = self._counted / 1000.0
        pose = compose(self._base, counted)
        pose[2] = self._base[2] + counted[2]
        return pose


PAUSE = 0.1  # s. Bytes of an answer come within 16 ms, answers are 0.2 s apart.
FRAME_SIZE = protocol.ANSWER_BYTES + protocol.FRAME_BYTES
CHAIN = 3  # consistent answers that are used though the last packet is far
SHORT, GARBAGE = "short", "garbage"


class Stream(ABC):
    """Bytes in, packets out; `faults` counts pieces that are no packet, by name."""

    vouched: bool  # whether a checksum vouches for the bytes, so that a delayed answer need not wait for others

    def __init__(self) -> None:
        self.faults: Counter[str] = Counter()
        self._bytes = bytearray()
        self._last: tuple[float, protocol.Answer] | None = None
        self._refused: list[tuple[float, protocol.Answer]] = []
        self._unwrapper = Unwrapper()

    def missing(self) -> int:
        """Bytes to read after which something may be complete."""
        return protocol.ANSWER_BYTES

    @abstractmethod
    def feed(self, t: float, data: bytes) -> list[Packet]:
        """The packets that bytes received at t [s] complete, oldest first."""

    def _judged(self, t: float, answer: protocol.Answer, scan: Scan | None = None) -> list[Packet]:
        """The packet of an answer with its scan and those that waited for it; none if it waits or is impossible."""
        if min(answer.distances) < 0 or max(answer.distances) > protocol.TIMEOUT_MM:  # the pose may have any value
            self.faults[GARBAGE] += 1
            return []
        row = [*self._refused, (t, answer)]
        if self._refused and not reachable(self._refused[-1][1], answer, t - self._refused[-1][0]):
            row = row[-1:]
        joined = False
        if self._last is not None:
            if reachable(self._last[1], answer, t - self._last[0], held_up=self.vouched):
                joined, row = True, row[-1:]
            elif len(row) < CHAIN:
                self.faults[GARBAGE] += len(self._refused) + 1 - len(row)
                self._refused = row
                return []
            else:
                joined = reachable(self._last[1], row[0][1], row[0][0] - self._last[0], held_up=True)
        self.faults[GARBAGE] += len(self._refused) + 1 - len(row)
        self._refused, self._last = [], row[-1]
        last = len(row) - 1
        return [self._unwrapper.packet(*one, joined or i > 0, scan if i == last else None) for i, one in enumerate(row)]


class Unframed(Stream):
    """Packets without markers. Faults: `short`, less than an answer between pauses; `garbage`, an impossible answer."""

    vouched = False

    def __init__(self) -> None:
        super().__init__()
        self._came = -math.inf
        self._lost = False  # up to the next pause nothing tells where an answer begins

    def feed(self, t: float, data: bytes) -> list[Packet]:
        """See `Stream.feed`."""
        if t - self._came > PAUSE:
            self.faults[SHORT] += bool(self._bytes)
            self._bytes.clear()
            self._lost = False
        self._came = t
        self._bytes += data
        found: list[Packet] = []
        while len(self._bytes) >= protocol.ANSWER_BYTES and not self._lost:
            used = self._judged(t, protocol.decode_answer(bytes(self._bytes[: protocol.ANSWER_BYTES])))
            del self._bytes[: protocol.ANSWER_BYTES]
            self._lost = not used
            found += used
        if self._lost:
            self._bytes.clear()
        return found


class Framed(Stream):
    """Packets of a stream of frames, checked by checksum and by the robot's motion; with scans of a lidar, or without.

    Faults: `short`, less than a frame; `garbage`, other bytes or an impossible answer; `torn`, a scan of which a packet
    is missing or damaged, with other beams than the first scan, or without the answer of the same odometry.
    """

    vouched = True

    def __init__(self, *, scans: bool = False) -> None:
        super().__init__()
        self._sizes = {protocol.MARKER: protocol.ANSWER_BYTES, **({SCAN_MARKER: SCAN_BYTES} if scans else {})}
        self._parts = ScanParts(self.faults)
        self._scan: Scan | None = None  # the newest one, whose answer has not come yet
        self._beams: Beams | None = None

    def missing(self) -> int:
        """Bytes that complete the frame that has begun, or the shortest one."""
        size = self._sizes.get(bytes(self._bytes[: len(protocol.MARKER)]), protocol.ANSWER_BYTES)
        return max(size + protocol.FRAME_BYTES - len(self._bytes), 1)

    def feed(self, t: float, data: bytes) -> list[Packet]:
        """See `Stream.feed`."""
        self._bytes += data
        found: list[Packet] = []
        while True:
            used, marker, content = protocol.next_frame(self._bytes, self._sizes)
            if junk := used - (0 if content is None else len(content) + protocol.FRAME_BYTES):
                self.faults[SHORT if junk < FRAME_SIZE else GARBAGE] += 1
            del self._bytes[:used]
            if content is None:
                return found
            if marker == SCAN_MARKER:
                scan = self._parts.add(content)
                if scan is not None:
                    self.faults[TORN] += self._scan is not None
                    self._beams = self._beams or scan.beams
                    self._scan = scan if scan.beams == self._beams else None
                    self.faults[TORN] += self._scan is None
            else:
                answer = protocol.decode_answer(content)
                found += self._judged(t, answer, self._scan_of(answer))

    def _scan_of(self, answer: protocol.Answer) -> Scan | None:
        """The scan that belongs to an answer; one is kept for one answer only."""
        self._parts.give_up()
        scan, self._scan = self._scan, None
        if scan is None or scan.odometry == answer[1:]:
            return scan
        self.faults[TORN] += 1
        return None


LOST, LATE, DEVICE_GONE = "lost", "late", "device gone"
FAULTS = (LOST, LATE, SHORT, GARBAGE, TORN, DEVICE_GONE)
"""lost: no answer to a command. late: an answer after its time; it is used, unless a newer one came with it. short,
garbage: see `Unframed`. torn: see `Framed`. device gone: the device disappeared."""


class Exchange:
    """Commands and answers of a link; a packet's time is that of its last bytes, of several the newest counts."""

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
            if self._asked is None or record.t - self._asked > protocol.ANSWER_TIMEOUT:
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
    return [packet for record in records for packet in exchange.consume(record)], exchange.faults

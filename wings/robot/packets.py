"""The robot's dimensions, and its serial protocol byte for byte: command, answer, the framed variant, scans.

    command   4 bytes: int16 speed [mm/s], int16 turn rate [mrad/s]
    answer   22 bytes: eight int16 sonar distances [mm], int16 x, y [mm], int16 heading [mrad]

Little-endian. x, y and heading overflow at 32.767 m and rad. A framed packet is `MARKER`, the same bytes, and their
CRC-16 (0x1021, initial value 0xFFFF, not reflected: `binascii.crc_hqx`, CRC-16/IBM-3740), little-endian.

A lidar's scan is sent in pieces of up to `BEAMS` beams, each a frame of one size: `SCAN_MARKER`, content, and the
CRC-16 of the content. docs/notes/lidar.md has a table of the content, 148 bytes, little-endian. A packet is read alone,
so what lies between those of one scan does no harm. A scan is used if all packets have arrived, agree on everything but
the first beam, and its ranges fit their CRC-32. The lidar is over the robot's centre.

A round hobby robot with differential drive. Body frame: x ahead, y left, origin midway between the wheels.
"""

import binascii
import math
import struct
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from data.inputs import Scanner
from data.se2 import Array

RADIUS = 0.15  # m, of the body; the sonars sit on its rim
_around = 2.0 * math.pi * np.arange(8) / 8
SONARS: Array = np.stack(
    [RADIUS * np.cos(_around), RADIUS * np.sin(_around), np.where(_around > math.pi, _around - 2 * math.pi, _around)],
    -1,
)
"""Poses (8, 3) of the sonars on the body [m, m, rad], counter-clockwise from the one ahead.

At 45 degree steps one sonar is always within 22.5 degrees of a wall's normal, the limit at which a smooth wall returns
an echo (`wings.robot.simulated`).
"""
SONARS.setflags(write=False)
AHEAD, RIGHT = 0, 6  # rows of `SONARS`

CONE_HALF_ANGLE = math.radians(7.5)
"""rad. A sonar measures the nearest point inside its cone of 15 degrees, not that point's direction."""
TIMEOUT_MM = 4000  # The distance for "no echo": eight echoes of 5.8 us/mm x 4000 mm fit into a cycle of 0.25 s
LONGEST_RANGE = TIMEOUT_MM / 1000.0  # m

WHEEL_BASE = 0.25  # m, track width
WHEEL_RADIUS = 0.0325  # m
TICKS_PER_TURN = 960  # encoder ticks per turn of a wheel, 0.21 mm each
FASTEST_WHEEL = 0.4  # m/s of a wheel's rim; faster commands are limited to it
FASTEST = FASTEST_WHEEL  # m/s of the body
FASTEST_TURN = 2.0 * FASTEST_WHEEL / WHEEL_BASE  # rad/s, with the wheels at full speed in opposite directions


PERIOD = 0.25  # s between commands
ANSWER_TIMEOUT = 0.25  # s to wait for an answer
WATCHDOG = 1.0  # s without a command after which the robot stops itself
BAUD = 9600  # bit/s; a byte takes 10 bits (8N1)
LIDAR_BAUD = 115200  # bit/s of a line that carries scans
BITS_PER_BYTE = 10.0
BYTE_TIME = BITS_PER_BYTE / BAUD  # s

SONAR_COUNT = 8
_COMMAND = struct.Struct("<2h")
_ANSWER = struct.Struct(f"<{SONAR_COUNT + 3}h")
COMMAND_BYTES, ANSWER_BYTES = _COMMAND.size, _ANSWER.size

MARKER = b"\xa5\x5a"
FRAME_BYTES = len(MARKER) + 2  # bytes a frame adds to its content
_LOW, _HIGH = -(1 << 15), (1 << 15) - 1


class Command(NamedTuple):
    """A command: speed [mm/s] and turn rate [mrad/s], counter-clockwise."""

    speed: int
    turn: int


class Answer(NamedTuple):
    """An answer: eight distances [mm], and the odometry's x, y [mm] and heading [mrad] as int16."""

    distances: tuple[int, ...]
    x: int
    y: int
    heading: int


def command_of(v: float, omega: float) -> Command:
    """The command nearest to v [m/s] and omega [rad/s], clipped to int16."""
    return Command(*(min(max(round(1000.0 * value), _LOW), _HIGH) for value in (v, omega)))


def overflowed(value: int) -> int:
    """A value as int16: modulo 2^16, -32768 to 32767."""
    return (value - _LOW) % (1 << 16) + _LOW


def encode_command(command: Command) -> bytes:
    """Bytes (4) of a command."""
    return _COMMAND.pack(*command)


def decode_command(data: bytes) -> Command:
    """The command of 4 bytes."""
    return Command(*_COMMAND.unpack(data))


def encode_answer(answer: Answer) -> bytes:
    """Bytes (22) of an answer."""
    return _ANSWER.pack(*answer.distances, answer.x, answer.y, answer.heading)


def decode_answer(data: bytes) -> Answer:
    """The answer of 22 bytes, unchecked."""
    values = _ANSWER.unpack(data)
    return Answer(values[:SONAR_COUNT], *values[SONAR_COUNT:])


def checksum(data: bytes) -> bytes:
    """CRC-16 of a frame's content, 2 bytes."""
    return struct.pack("<H", binascii.crc_hqx(data, 0xFFFF))


def framed(data: bytes, marker: bytes = MARKER) -> bytes:
    """The bytes of a packet between marker and checksum."""
    return marker + data + checksum(data)


def next_frame(pending: bytearray, sizes: Mapping[bytes, int]) -> tuple[int, bytes, bytes | None]:
    """The first intact frame (`sizes`: of content by marker): how many bytes are consumed, marker, content or None.
    After a false marker one byte is, so an intact frame behind a damaged one is found.
    """
    first = next(iter(sizes))[:1]
    at = pending.find(first)
    while at >= 0:
        begin = at + len(MARKER)
        marker = bytes(pending[at:begin])
        end = begin + sizes.get(marker, 0)
        if at + 1 == len(pending) or (marker in sizes and len(pending) < end + 2):
            return at, b"", None
        if marker in sizes and pending[end : end + 2] == checksum(content := bytes(pending[begin:end])):
            return end + 2, marker, content
        at = pending.find(first, at + 1)
    return len(pending), b"", None


TORN = "torn"
SCAN_MARKER = b"\xa5\x5c"
BEAMS = 60  # beams in a packet
MOST_BEAMS = 1440  # A quarter of a degree apart all round
NARROWEST, WIDEST = 10_000, 1_000_000_000  # nrad between beams; a scan is at most a full circle
CIRCLE = 6_283_186_000  # nrad, and a rounding
_HEAD = struct.Struct("<I3hHHiiHI")
_RANGES = struct.Struct(f"<{BEAMS}H")
SCAN_BYTES = _HEAD.size + _RANGES.size


class Beams(NamedTuple):
    """Directions of a scan's beams and the largest range, as transmitted."""

    number: int  # of beams
    first: int  # urad, direction of beam 0 from ahead, counter-clockwise
    step: int  # nrad, from each beam to the next
    reach: int  # mm

    def scanner(self, sigma: float) -> Scanner:
        """The scanner that has them, in radians and metres, over the robot's centre; `sigma` [m] of a range."""
        return Scanner(self.first / 1e6, self.step / 1e9, self.reach / 1000.0, sigma)

    @property
    def possible(self) -> bool:
        """Whether a scanner can have them: at least one beam, at most a circle, directions within a turn of ahead."""
        step, ahead = abs(self.step), abs(1000 * self.first) <= CIRCLE and self.reach > 0
        fine = NARROWEST <= step <= WIDEST and step * (self.number - 1) < CIRCLE
        return ahead and fine and 0 < self.number <= MOST_BEAMS


class Scan(NamedTuple):
    """A scan as transmitted: time [ms], odometry x, y [mm], heading [mrad], and ranges [mm], 0 for no return."""

    stamp: int
    odometry: tuple[int, int, int]
    beams: Beams
    ranges: tuple[int, ...]

    @property
    def metres(self) -> Array:
        """Ranges (B,) [m], 0 for no return."""
        mm = np.array(self.ranges, float)
        return np.asarray(np.where(mm < self.beams.reach, mm / 1000.0, 0.0))


def encode_scan(scan: Scan) -> bytes:
    """All packets of a scan, one after the other."""
    check = binascii.crc32(np.array(scan.ranges, "<u2").tobytes())
    frames = []
    for first in range(0, scan.beams.number, BEAMS):
        part = scan.ranges[first : first + BEAMS]
        b = scan.beams
        head = _HEAD.pack(scan.stamp, *scan.odometry, b.number, first, b.first, b.step, b.reach, check)
        frames.append(framed(head + _RANGES.pack(*part, *(0,) * (BEAMS - len(part))), SCAN_MARKER))
    return b"".join(frames)


class ScanParts:
    """Puts packets of scans together; `faults` counts those `TORN`: a packet missing, or ranges unlike their CRC-32."""

    def __init__(self, faults: Counter[str]) -> None:
        self._faults = faults
        self._head: tuple[int, ...] | None = None  # of the scan that has begun, without the first beam
        self._parts: dict[int, tuple[int, ...]] = {}  # its ranges by first beam

    def add(self, content: bytes) -> Scan | None:
        """The scan that a packet's content completes, or None. An impossible packet ends the scan that has begun."""
        stamp, x, y, heading, count, first, angle, step, reach, check = _HEAD.unpack_from(content)
        beams = Beams(count, angle, step, reach)
        head = (stamp, x, y, heading, *beams, check)
        if head != self._head:
            self.give_up()
            self._head = head
        if not beams.possible or first % BEAMS or first >= count:
            self.give_up()
            return None
        self._parts[first] = _RANGES.unpack_from(content, _HEAD.size)[: count - first]
        if len(self._parts) < -(-count // BEAMS):
            return None
        ranges = tuple(r for _, part in sorted(self._parts.items()) for r in part)
        self._head, self._parts = None, {}
        if binascii.crc32(np.array(ranges, "<u2").tobytes()) != check:
            self._faults[TORN] += 1
            return None
        return Scan(stamp, (x, y, heading), beams, ranges)

    def give_up(self) -> None:
        """Forget the scan that has begun."""
        self._faults[TORN] += self._head is not None
        self._head, self._parts = None, {}

"""Packets of a lidar's scan on the robot's line, byte for byte: scan to frames, frames to scan.

A scan is sent in pieces of up to `BEAMS` beams, each a frame of one size: `SCAN_MARKER`, content, and the CRC-16 of the
content, as of `wings.robot.packets`. docs/notes/lidar.md has a table of the content, 148 bytes, little-endian.

A packet is read alone, so what lies between those of one scan does no harm. A scan is used if all packets have arrived,
agree on everything but the first beam, and its ranges fit their CRC-32. The lidar is over the robot's centre.
"""

import binascii
import struct
from collections import Counter
from typing import NamedTuple

import numpy as np

from data.inputs import Scanner
from data.se2 import Array
from wings.robot.packets import framed

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
        return (
            0 < self.number <= MOST_BEAMS
            and NARROWEST <= abs(self.step) <= WIDEST
            and abs(self.step) * (self.number - 1) < CIRCLE
            and abs(1000 * self.first) <= CIRCLE
            and self.reach > 0
        )


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
        found: Array = np.where(mm < self.beams.reach, mm / 1000.0, 0.0)
        return found


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

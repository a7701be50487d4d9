"""What goes over the robot's serial line, byte for byte: command, answer, sonar controller, and the framed variant.

    command   4 bytes: int16 speed [mm/s], int16 turn rate [mrad/s]
    answer   22 bytes: eight int16 sonar distances [mm], int16 x, y [mm], int16 heading [mrad]
    sonars   16 bytes: eight uint16 echo times [us]

The low byte comes first. x, y and heading are counted on and overflow at 32.767 m and rad. Framed, a packet is
`MARKER`, the same bytes, and a CRC-16 of these, low byte first: the polynomial 0x1021 of CCITT, begun at 0xFFFF so
that leading zeros count, not reflected (`binascii.crc_hqx`; known as CRC-16/IBM-3740).
"""

from __future__ import annotations

import binascii
import struct
from typing import NamedTuple

from data.robot.body import TIMEOUT_MM

PERIOD = 0.25
"""s between commands."""
ANSWER_TIMEOUT = 0.25
"""s that an answer is waited for."""
WATCHDOG = 1.0
"""s without a command after which the robot stops by itself."""
BAUD = 9600
"""bit/s; a byte is 10 bits on the line (8N1)."""
BYTE_TIME = 10.0 / BAUD
"""s."""

SONAR_COUNT = 8
_COMMAND = struct.Struct("<2h")
_ANSWER = struct.Struct(f"<{SONAR_COUNT + 3}h")
_ECHOES = struct.Struct(f"<{SONAR_COUNT}H")
COMMAND_BYTES, ANSWER_BYTES, SONAR_BYTES = _COMMAND.size, _ANSWER.size, _ECHOES.size
MICROSECONDS_PER_MM = 5.8
"""There and back: 2 x 29 us/cm."""

MARKER = b"\xa5\x5a"
FRAME_BYTES = len(MARKER) + 2
"""Bytes that a frame has more than what it holds."""
_LOW, _HIGH = -(1 << 15), (1 << 15) - 1


class Command(NamedTuple):
    """What the robot is told: speed [mm/s], turn rate [mrad/s], counter-clockwise."""

    speed: int
    turn: int


class Answer(NamedTuple):
    """What the robot tells: distances (8) [mm], x, y [mm] and heading [mrad] of its odometry, as int16 they are."""

    distances: tuple[int, ...]
    x: int
    y: int
    heading: int


def command_of(v: float, omega: float) -> Command:
    """The command nearest to v [m/s] and omega [rad/s]; what an int16 cannot hold is brought to its ends."""
    return Command(*(min(max(round(1000.0 * value), _LOW), _HIGH) for value in (v, omega)))


def overflowed(value: int) -> int:
    """An int16 that counted on to `value`: modulo 2^16, -32768 to 32767."""
    return (value - _LOW) % (1 << 16) + _LOW


def encode_command(command: Command) -> bytes:
    """4 bytes."""
    return _COMMAND.pack(*command)


def decode_command(data: bytes) -> Command:
    """Of 4 bytes."""
    return Command(*_COMMAND.unpack(data))


def encode_answer(answer: Answer) -> bytes:
    """22 bytes."""
    return _ANSWER.pack(*answer.distances, answer.x, answer.y, answer.heading)


def decode_answer(data: bytes) -> Answer:
    """Of 22 bytes, whatever they are; nothing is judged here."""
    values = _ANSWER.unpack(data)
    return Answer(values[:SONAR_COUNT], *values[SONAR_COUNT:])


def encode_echoes(distances: tuple[int, ...]) -> bytes:
    """16 bytes of the sonar controller for distances [mm]."""
    return _ECHOES.pack(*(round(MICROSECONDS_PER_MM * d) for d in distances))


def decode_echoes(data: bytes) -> tuple[int, ...]:
    """Distances (8) [mm] of the sonar controller's 16 bytes; from `TIMEOUT_MM` on nothing was seen, and it says so."""
    return tuple(min(round(echo / MICROSECONDS_PER_MM), TIMEOUT_MM) for echo in _ECHOES.unpack(data))


def checksum(data: bytes) -> bytes:
    """CRC-16 of a frame's content, 2 bytes."""
    return struct.pack("<H", binascii.crc_hqx(data, 0xFFFF))


def framed(data: bytes) -> bytes:
    """A packet's bytes between marker and checksum."""
    return MARKER + data + checksum(data)


def next_frame(pending: bytearray, size: int) -> tuple[int, bytes | None]:
    """The first intact frame that holds `size` bytes.

    Returns:
        How many of the pending bytes are done with (the frame and all before it, or what can no longer become one), and
        the frame's content, or None where none is complete. After a marker that is none only one byte is done with, so
        an intact frame behind a damaged one is found.
    """
    at = 0
    while True:
        at = pending.find(MARKER, at)
        if at < 0:
            return len(pending) - (pending[-1:] == MARKER[:1]), None
        if len(pending) < at + size + FRAME_BYTES:
            return at, None
        content = bytes(pending[at + len(MARKER) : at + len(MARKER) + size])
        end = at + len(MARKER) + size
        if pending[end : end + 2] == checksum(content):
            return end + 2, content
        at += 1

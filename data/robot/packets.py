"""The robot as numbers, and its serial line byte for byte: command, answer, sonar controller, and the framed variant.

    command   4 bytes: int16 speed [mm/s], int16 turn rate [mrad/s]
    answer   22 bytes: eight int16 sonar distances [mm], int16 x, y [mm], int16 heading [mrad]
    sonars   16 bytes: eight uint16 echo times [us]

The low byte comes first. x, y and heading are counted on and overflow at 32.767 m and rad. Framed, a packet is
`MARKER`, the same bytes, and a CRC-16 of these, low byte first: the polynomial 0x1021 of CCITT, begun at 0xFFFF so
that leading zeros count, not reflected (`binascii.crc_hqx`; known as CRC-16/IBM-3740).

A round hobby robot on two driven wheels. Body frame: x ahead, y to the left, the origin midway between the wheels.
"""

from __future__ import annotations

import binascii
import math
import struct
from typing import NamedTuple

import numpy as np

from data.se2 import Array

RADIUS = 0.15
"""m, of the round body; the sonars sit on its rim."""


def _ring(count: int) -> Array:
    angle = 2.0 * math.pi * np.arange(count) / count
    return np.stack(
        [RADIUS * np.cos(angle), RADIUS * np.sin(angle), np.where(angle > math.pi, angle - 2 * math.pi, angle)], axis=-1
    )


SONARS: Array = _ring(8)
"""Poses (8, 3) of the sonars on the body [m, m, rad], counter-clockwise from the one ahead.

Steps of 45 degrees all round: whatever the heading, one sonar points within 22.5 degrees of a wall's normal, which is
where a smooth wall stops to send an echo back (see `data.robot.simulated.physics`). A ring that is denser ahead would
lose the walls beside and behind, from which a position along a corridor comes.
"""
SONARS.setflags(write=False)
AHEAD, LEFT, BEHIND, RIGHT = 0, 2, 4, 6
"""Rows of `SONARS`."""

CONE_HALF_ANGLE = math.radians(7.5)
"""rad. A sonar hears the nearest thing inside 15 degrees and does not know in which direction it is."""
TIMEOUT_MM = 4000
"""mm. The distance that stands for "nothing seen".

All eight are fired in turn within a cycle of 0.25 s: 8 echoes of 5.8 us/mm x 4000 mm = 0.19 s; 5000 mm would not fit.
"""
LONGEST_RANGE = TIMEOUT_MM / 1000.0
"""m. An echo from here on is not waited for."""

WHEEL_BASE = 0.25
"""m, between the tracks of the two wheels."""
WHEEL_RADIUS = 0.0325
"""m; 65 mm is the common wheel of such kits."""
TICKS_PER_TURN = 960
"""Encoder ticks of one turn of a wheel; 0.21 mm of way each."""
FASTEST_WHEEL = 0.4
"""m/s of a wheel's rim; commands beyond are brought down to it."""
FASTEST = FASTEST_WHEEL
"""m/s of the body."""
FASTEST_TURN = 2.0 * FASTEST_WHEEL / WHEEL_BASE
"""rad/s, both wheels at their fastest against each other."""


def wheel_speeds(v: float, omega: float) -> tuple[float, float]:
    """Speeds of the left and the right rim [m/s] for a body speed v [m/s] and turn rate omega [rad/s]."""
    return v - 0.5 * WHEEL_BASE * omega, v + 0.5 * WHEEL_BASE * omega


def body_speeds(left: float, right: float) -> tuple[float, float]:
    """Body speed v [m/s] and turn rate omega [rad/s] from the rims' speeds [m/s]; undoes `wheel_speeds`."""
    return 0.5 * (left + right), (right - left) / WHEEL_BASE


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

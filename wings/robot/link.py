"""Serial link: a command every 0.25 s, its answer awaited and recorded; a device that disappears is opened again.

`Link.step` keeps its period whatever happens on the line, and raises nothing: faults are counted by name.
"""

from __future__ import annotations

import contextlib
import termios
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from data.errors import UsageError
from wings.robot.packets import ANSWER_TIMEOUT, BAUD, LIDAR_BAUD, PERIOD, Command, encode_command, framed
from wings.robot.traffic import GONE, OPENED, RECEIVED, SENT, Exchange, Packet, Record, Recording

if TYPE_CHECKING:
    from serial import Serial

REST = 0.03  # s to wait for the rest of a packet after its first byte: 22 bytes take 0.023 s, 152 of a scan 0.013 s
BROKEN = (OSError, termios.error)  # errors of a device that disappeared; pyserial's own error is an OSError


class Clock:
    """Robot time [s] since construction; `speed` robot seconds pass in a second of real time."""

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self._start = time.monotonic()

    def now(self) -> float:
        """Robot time [s]."""
        return (time.monotonic() - self._start) * self.speed

    def sleep(self, seconds: float) -> None:
        """Wait for an interval of robot time [s]."""
        if seconds > 0.0:
            time.sleep(seconds / self.speed)


def open_serial(device: str, baud: int) -> Serial:
    """Open the device at `baud` 8N1, exclusively, and discard pending input."""
    from serial import Serial

    port = Serial(device, baud, timeout=ANSWER_TIMEOUT, write_timeout=PERIOD, exclusive=True)
    port.reset_input_buffer()
    return port


class Link(contextlib.AbstractContextManager["Link"]):
    """A link to the robot; `with` closes it. `exchange` counts commands, answers and faults."""

    def __init__(
        self, device: str, clock: Clock, recording: Recording | None = None, *, with_frames: bool = False,
        with_scans: bool = False, open_port: Callable[[str], Serial] | None = None,
    ) -> None:  # fmt: skip
        """Open the device by pyserial or `open_port`; UsageError if that fails. `with_scans`: a faster line."""
        self.exchange = Exchange(framed=with_frames, scans=with_scans)
        self._open_port = open_port or partial(open_serial, baud=LIDAR_BAUD if with_scans else BAUD)
        self._device, self._clock, self._recording = device, clock, recording
        self._framed = with_frames or with_scans
        self._stamp = 0.0
        self._next = clock.now()
        self._port: Serial | None = None
        try:
            self._open()
        except BROKEN as error:
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise UsageError(f"{device}: cannot be opened as a serial line: {reason}") from None

    def step(self, command: Command) -> list[Packet]:
        """Wait for the next period, send a command, and wait for its answer until the period ends. Returns the packets
        received, oldest first: usually one, none without an answer, several if some were late.
        """
        packets = self._listen(self._next, first=False)
        if self._clock.now() - self._next > PERIOD:  # delayed: periods restart, none is caught up
            self._next = self._clock.now()
        self._next += PERIOD
        if self._port is None:
            with contextlib.suppress(*BROKEN):
                self._open()
        data = encode_command(command)
        self._send(framed(data) if self._framed else data)
        return packets + self._listen(self._next, first=True)

    def _listen(self, until: float, *, first: bool) -> list[Packet]:
        """Packets received until a time; `first`: stop after the first ones."""
        packets: list[Packet] = []
        while (left := until - self._clock.now()) > 0.0 and not (first and packets):
            if self._port is None:
                self._clock.sleep(left)
                break
            data = self._read(self._port, left)
            if data:
                packets += self._keep(RECEIVED, data)
        return packets

    def _read(self, port: Serial, left: float) -> bytes:
        """Bytes of one packet, as far as they arrive; none where nothing does or the device disappeared."""
        try:
            port.timeout = left / self._clock.speed
            data: bytes = port.read(1)
            if data:
                port.timeout = REST / self._clock.speed
                data += port.read(max(self.exchange.missing - 1, port.in_waiting))
        except BROKEN:
            self._gone()
            return b""
        return data

    def _send(self, data: bytes) -> None:
        if self._port is None:
            return
        try:
            self._port.write(data)
        except BROKEN:
            self._gone()
            return
        self._keep(SENT, data)

    def _gone(self) -> None:
        if self._port is not None:
            with contextlib.suppress(*BROKEN):
                self._port.close()
            self._port = None
            self._keep(GONE)

    def _open(self) -> None:
        self._port = self._open_port(self._device)
        self._keep(OPENED)

    def _keep(self, kind: bytes, data: bytes = b"") -> list[Packet]:
        """Record an event on disk before it is used; times of records increase."""
        self._stamp = round(max(self._clock.now(), self._stamp + 1e-6) * 1e6) / 1e6
        record = Record(kind, self._stamp, data)
        if self._recording is not None:
            self._recording.append(record)
        return self.exchange.consume(record)

    def close(self) -> None:
        """Release the device; the robot's watchdog stops it."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def __exit__(self, *_: object) -> None:
        self.close()

"""The line to the simulated robot, byte by byte with its faults, and its firmware; times are arguments."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from wings.robot import packets as protocol
from wings.robot.packets import encode_scan
from wings.robot.simulated.physics import Robot

COMMAND_PAUSE = 0.05  # s of silence after which a byte begins a command; a command is 4 ms long
BETWEEN_STALLS = 6000  # mean number of bytes between stalls: a minute of traffic


@dataclass(frozen=True)
class Faults:
    """Faults of the line, per byte in both directions."""

    drop: float = 0.0  # probability that a byte is lost
    flip: float = 0.0  # probability that one of its bits is flipped
    # s, length of a stall of one direction, once in `BETWEEN_STALLS` bytes. Stalled answers come late; stalled commands
    # are lost, or the robot would obey them after its sender was gone
    stall: float = 0.0


class Wire:
    """Robot, firmware and both directions of the line. A robot with a lidar has a faster line with frames."""

    def __init__(self, robot: Robot, faults: Faults, rng: np.random.Generator, *, with_frames: bool = False) -> None:
        self.robot = robot
        self._byte_time = protocol.BYTE_TIME if robot.lidar is None else protocol.BITS_PER_BYTE / protocol.LIDAR_BAUD
        self._framed = with_frames or robot.lidar is not None
        self._pending, self._came = bytearray(), -math.inf  # of a command
        self._faults = faults
        self._rng = {"to": rng.spawn(1)[0], "from": rng.spawn(1)[0]}
        self._to_robot: deque[tuple[float, int]] = deque()
        self._from_robot: deque[tuple[float, int]] = deque()
        self._still_until = {"to": -math.inf, "from": -math.inf}

    def write(self, t: float, data: bytes) -> None:
        """Bytes from the program at time t [s]."""
        self._put(t, data, self._to_robot, "to")

    def read(self, t: float) -> bytes:
        """Bytes that came from the robot up to time t [s]."""
        self.advance(t)
        came = bytearray()
        while self._from_robot and self._from_robot[0][0] <= t:
            came.append(self._from_robot.popleft()[1])
        return bytes(came)

    def due(self) -> float:
        """Arrival time of the next byte at either end [s]; inf if none is on its way."""
        return min((queue[0][0] for queue in (self._to_robot, self._from_robot) if queue), default=math.inf)

    def advance(self, t: float) -> None:
        """Run the robot up to time t [s]."""
        while self._to_robot and self._to_robot[0][0] <= t:
            at, byte = self._to_robot.popleft()
            answer = self._receive(at, byte)
            if answer:
                self._put(at, answer, self._from_robot, "from")
        self.robot.advance(t)

    def _receive(self, t: float, byte: int) -> bytes:
        """What the firmware answers at t [s] to the command that a byte completes, after its scan, or nothing."""
        if t - self._came > COMMAND_PAUSE:
            self._pending.clear()
        self._came = t
        self._pending.append(byte)
        if self._framed:
            used, _, content = protocol.next_frame(self._pending, {protocol.MARKER: protocol.COMMAND_BYTES})
            del self._pending[:used]
        else:
            content = bytes(self._pending) if len(self._pending) == protocol.COMMAND_BYTES else None
            if content is not None:
                self._pending.clear()
        if content is None:
            return b""
        self.robot.command(t, protocol.decode_command(content))
        answer = self.robot.answer(t)
        scan, data = self.robot.scan(answer), protocol.encode_answer(answer)
        return (b"" if scan is None else encode_scan(scan)) + (protocol.framed(data) if self._framed else data)

    def _put(self, t: float, data: bytes, queue: deque[tuple[float, int]], way: str) -> bool:
        """Put bytes onto the line in order; returns whether all of them passed unchanged."""
        rng, faults, unharmed = self._rng[way], self._faults, True
        at = max(t, queue[-1][0] if queue else t)
        for byte in data:
            chance = rng.random(3)
            if faults.stall and chance[0] * BETWEEN_STALLS < 1.0:
                self._still_until[way] = at + faults.stall
            at += self._byte_time
            if chance[1] < faults.drop or (way == "to" and at < self._still_until[way]):
                unharmed = False
                continue
            at = max(at, self._still_until[way])
            flipped = byte
            if chance[2] < faults.flip:
                flipped ^= 1 << int(rng.integers(8))
                unharmed = False
            queue.append((at, flipped))
        return unharmed

"""A link to the simulated robot without terminal and without waiting: time passes when the link waits."""

import math

import numpy as np

from wings.robot.link import Link
from wings.robot.simulated import Faults, Robot, Wire, room

CALM = Faults()


class StandingClock:
    """Time that passes only when somebody waits."""

    speed = 1.0

    def __init__(self):
        self.time = 0.0

    def now(self):
        return self.time

    def sleep(self, seconds):
        self.time += max(seconds, 0.0)


class WirePort:
    """A serial port at the end of a wire; `gone` makes it fail as a device does that was pulled out."""

    def __init__(self, wire, clock):
        self.wire, self.clock, self.timeout, self.gone, self.came = wire, clock, None, False, bytearray()

    def _alive(self):
        if self.gone:
            raise OSError(5, "Input/output error")

    @property
    def in_waiting(self):
        self._alive()
        self.came += self.wire.read(self.clock.time)
        return len(self.came)

    def read(self, size):
        until = self.clock.time + self.timeout
        while self.in_waiting < size and self.clock.time < until:
            self.clock.time = min(max(self.wire.due(), self.clock.time), until)
        data = bytes(self.came[:size])
        del self.came[:size]
        return data

    def write(self, data):
        self._alive()
        self.wire.write(self.clock.time, data)

    def close(self):
        self.gone = True


class KeepingWire(Wire):
    """Keeps every answer (with its scan), and whether its bytes went onto the line unharmed."""

    def __init__(self, *args, **more):
        super().__init__(*args, **more)
        self.sent, self.keep = [], True

    def _put(self, t, data, queue, way):
        unharmed = super()._put(t, data, queue, way)
        if way == "from" and self.keep:
            self.sent.append((data, unharmed))
        return unharmed


def linked(faults=CALM, seed=0, *, framed=False, recording=None, world=0, lidar=None):
    """A link, its wire (which keeps what the robot sent) and its clock."""
    body, line = np.random.default_rng(seed).spawn(2)
    wire = KeepingWire(Robot(room(world), body, lidar=lidar), faults, line, with_frames=framed)
    clock, scans = StandingClock(), lidar is not None
    link = Link(
        "robot", clock, recording, with_frames=framed, with_scans=scans, open_port=lambda _: WirePort(wire, clock)
    )
    return link, wire, clock


def wander(packet, rng):
    """Speed [m/s] and turn rate [rad/s]: ahead, a little to either side, and round where something is near; or rest."""
    if packet is None or math.fmod(packet.t, 60.0) > 55.0:
        return 0.0, 0.0
    ahead = min(packet.ranges[[0, 1, 7]])
    return (0.3, 0.2 * rng.standard_normal()) if ahead > 0.6 else (0.0, 1.0)

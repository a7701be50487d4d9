"""Motion, sonars and lidar of the simulated robot, in steps of its own time.

The same generator, room and timed commands give the same path and answers. Each wheel's PI loop with anti-windup brings
its encoder to the commanded speed; the ground follows with slip. A wall stops the body, not the wheels.

The motor is a first-order lag from duty to speed, with friction. The loop's zero cancels the motor's pole, so without a
load the wheel follows as a lag of `RESPONSE` (Astrom and Hagglund, PID Controllers, section 4.4).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.se2 import Array, compose, wrap_angle
from wings.laser.floorplan.world import scan_ranges
from wings.robot import packets as protocol
from wings.robot.packets import Beams, Scan
from wings.robot.simulated.room import Room, cast, clearance
from wings.robot.traffic.stream import Packet, Unwrapper
from wings.robot.walls import MIRROR

LAG = 0.1  # s, time constant of the motor: a geared motor of 6 V with a 65 mm wheel
FULL_SPEED = 1.25 * protocol.FASTEST_WHEEL
"""m/s of the rim at full duty without load: 25 % above the limit, as reserve of the loop."""
RESPONSE = 0.05  # s, time constant of the closed loop: half the motor's, five steps of 0.01 s
PROPORTIONAL = LAG / (FULL_SPEED * RESPONSE)  # duty per m/s
INTEGRAL = 1.0 / (FULL_SPEED * RESPONSE)  # duty per m
FRICTION = 0.1  # smallest duty that turns the wheel


@dataclass
class SpeedLoop:
    """A wheel's PI controller; `integral` is the duty it has accumulated."""

    integral: float = 0.0

    def duty(self, wanted: float, measured: float, dt: float) -> float:
        """Duty, -1 to 1, for speeds [m/s] wanted and measured, dt [s] after the last call.

        At the limit the integral holds unless the error leads away from it (conditional integration). At rest it is
        zero: friction holds the wheel.
        """
        error = wanted - measured
        if wanted == 0.0:
            self.integral = 0.0
            return min(max(PROPORTIONAL * error, -1.0), 1.0)
        integral = self.integral + INTEGRAL * error * dt
        duty = PROPORTIONAL * error + integral
        limited = min(max(duty, -1.0), 1.0)
        if duty == limited or (duty - limited) * error < 0.0:
            self.integral = integral
        return limited


def turned(speed: float, duty: float, dt: float, load: float = 0.0) -> float:
    """Speed [m/s] after dt [s]; `load`: opposing push in full duties, which stops a wheel as friction does."""
    against = FRICTION + load
    pushed = speed + (duty * FULL_SPEED - speed) * dt / LAG
    brake = against * FULL_SPEED * dt / LAG
    return 0.0 if abs(pushed) <= brake else pushed - math.copysign(brake, pushed)


STEP = 0.01  # s, step of motion and of the firmware's encoders
BRAKING = 0.1  # s in which the loop stops a wheel from full speed
PATIENCE = protocol.WATCHDOG - BRAKING - 2.0 * STEP
"""s without a command after which the firmware brakes, so that the robot stands at `WATCHDOG`."""
METRES_PER_TICK = 2.0 * math.pi * protocol.WHEEL_RADIUS / protocol.TICKS_PER_TURN
SHORTEST_RANGE = 0.02
"""m. Nearer echoes return while the sonar still sends."""


@dataclass(frozen=True)
class Physics:
    """Imperfections of the robot."""

    # m per sqrt(m) of a wheel's travel, standard deviation, independent per wheel; 0.005 turns the body by 1.6 degrees
    # per metre, as hobby wheels do on a smooth floor
    slip: float = 0.005
    range_sigma: float = 0.005  # m, standard deviation of a distance
    dropout: float = 0.01  # share of echoes that are missed
    crosstalk: float = 0.01  # share of readings that are another sonar's ping: any distance below the true one


@dataclass(frozen=True)
class Lidar:
    """A planar scanner over the centre of the body, of the walls that the sonars hear, whose scan is taken at once; a
    real head turns in 0.1 s, in which the robot moves by 2 cm.
    """

    beams: int = 360  # in a circle, the first one astern, counter-clockwise
    reach: float = 8.0  # m, largest range
    sigma: float = 0.01  # m, standard deviation of a range, as of low-cost lidars for hobby robots
    dropout: float = 0.01  # share of beams without a return

    @property
    def directions(self) -> Beams:
        """As they are transmitted."""
        step = 2.0 * math.pi / self.beams
        return Beams(self.beams, round(-1e6 * math.pi), round(1e9 * step), round(1000.0 * self.reach))

    def scan(self, room: Room, pose: Array, t: float, odometry: tuple[int, int, int], rng: np.random.Generator) -> Scan:
        """The scan from a true pose (3,) at robot time t [s]; odometry as in the answer, int16."""
        walls = np.ascontiguousarray(room.segments.reshape(-1, 4))  # x0, y0, x1, y1
        ranges = scan_ranges(pose[None], self.directions.scanner(self.sigma), self.beams, walls)[0]
        noise, missed = rng.standard_normal(self.beams), rng.random(self.beams) < self.dropout
        mm = np.round(1000.0 * (ranges + self.sigma * noise))
        mm = np.where(np.isfinite(mm) & ~missed & (mm < 1000.0 * self.reach), np.maximum(mm, 1.0), 0.0)
        return Scan(round(1000.0 * t) % (1 << 32), odometry, self.directions, tuple(mm.astype(int).tolist()))


class Robot:
    """The simulated body with wheels, encoders, sonars and watchdog, at rest at the start of its room."""

    def __init__(
        self, room: Room, rng: np.random.Generator, physics: Physics | None = None, lidar: Lidar | None = None
    ) -> None:
        """Motion, sonars and lidar draw from separate generators: neither answers nor a lidar change the others."""
        self.room, self.physics, self.lidar = room, physics or Physics(), lidar
        self._ground, self._sound, self._light = rng.spawn(3)
        self.pose = np.array(room.start, float)  # the true one [m, m, rad], world frame, heading wrapped
        self.wheels = (0.0, 0.0)  # speeds [m/s] of the left and the right one
        self._loops = (SpeedLoop(), SpeedLoop())
        self._wanted: tuple[float, ...] = (0.0, 0.0)
        self._commanded = -math.inf
        self._steps = 0
        self._turned = [0.0, 0.0]
        self._ticks = [0, 0]
        self._odometry = [0.0, 0.0, 0.0]
        self._free = 0.0

    @property
    def time(self) -> float:
        """Time of the last step [s]."""
        return self._steps * STEP

    def command(self, t: float, command: protocol.Command) -> None:
        """Obey from time t [s] on, within the limits of each wheel."""
        self.advance(t)
        left, right = protocol.wheel_speeds(command.speed / 1000.0, command.turn / 1000.0)
        most = protocol.FASTEST_WHEEL
        self._wanted = tuple(min(max(speed, -most), most) for speed in (left, right))
        self._commanded = t

    def advance(self, t: float) -> None:
        """Move to the last step not after t [s]; a past time changes nothing."""
        for _ in range(math.floor(t / STEP + 1e-9) - self._steps):
            self._step()

    def _step(self) -> None:
        wanted = self._wanted if self.time - self._commanded < PATIENCE - 1e-9 else (0.0, 0.0)
        self._steps += 1
        before = self.wheels
        each = zip(self._loops, before, wanted, strict=True)
        left, right = (turned(now, loop.duty(goal, now, STEP), STEP) for loop, now, goal in each)
        self.wheels = (left, right)
        if left == right == 0.0 and before == (0.0, 0.0):
            return
        ways = [0.5 * (a + b) * STEP for a, b in zip(before, self.wheels, strict=True)]
        noise = self._ground.standard_normal(2)
        true = [w + self.physics.slip * math.sqrt(abs(w)) * float(n) for w, n in zip(ways, noise, strict=True)]
        self._encode(ways)
        self._move(0.5 * (true[0] + true[1]), (true[1] - true[0]) / protocol.WHEEL_BASE)

    def _encode(self, ways: list[float]) -> None:
        """Count whole ticks and advance the firmware's odometry by them."""
        counted = []
        for i in (0, 1):
            self._turned[i] += ways[i]
            ticks = math.floor(self._turned[i] / METRES_PER_TICK)
            counted.append((ticks - self._ticks[i]) * METRES_PER_TICK)
            self._ticks[i] = ticks
        forward, turn = 0.5 * (counted[0] + counted[1]), (counted[1] - counted[0]) / protocol.WHEEL_BASE
        x, y, heading = self._odometry
        middle = heading + 0.5 * turn
        self._odometry = [x + forward * math.cos(middle), y + forward * math.sin(middle), heading + turn]

    def _move(self, forward: float, turn: float) -> None:
        """Move the body unless a wall is in the way; clearance is computed only where a wall may be reached."""
        x, y, theta = self.pose.tolist()
        middle = theta + 0.5 * turn
        to = (x + forward * math.cos(middle), y + forward * math.sin(middle))
        self._free -= abs(forward)
        if self._free <= 0.0:
            self._free = clearance(self.room, np.array(to)) - protocol.RADIUS
            if self._free <= 0.0:
                self._free = 0.0
                if clearance(self.room, np.array(to)) < clearance(self.room, self.pose):
                    to = (x, y)
        self.pose = np.array([to[0], to[1], wrap_angle(theta + turn)])

    def answer(self, t: float) -> protocol.Answer:
        """The firmware's answer at time t [s]: present distances, odometry in whole mm and mrad, overflowed."""
        self.advance(t)
        x, y, heading = (protocol.overflowed(round(1000.0 * value)) for value in self._odometry)
        return protocol.Answer(tuple(self._distances()), x, y, heading)

    def scan(self, answer: protocol.Answer) -> Scan | None:
        """The lidar's scan at the time of an answer that was just given; None without a lidar."""
        if self.lidar is None:
            return None
        odometry = (answer.x, answer.y, answer.heading)
        return self.lidar.scan(self.room, self.pose, self.time, odometry, self._light)

    def _distances(self) -> list[int]:
        p = self.physics
        echo = cast(self.room, compose(self.pose, protocol.SONARS), protocol.CONE_HALF_ANGLE)
        missed, early, where = self._sound.random((3, len(protocol.SONARS)))
        heard: Array = echo.distance + p.range_sigma * self._sound.standard_normal(len(protocol.SONARS))
        heard[(echo.incidence > MIRROR) | (missed < p.dropout)] = np.inf
        heard = np.clip(heard, SHORTEST_RANGE, protocol.LONGEST_RANGE)
        heard = np.where(early < p.crosstalk, SHORTEST_RANGE + where * (heard - SHORTEST_RANGE), heard)
        return [min(round(1000.0 * d), protocol.TIMEOUT_MM) for d in heard.tolist()]


class Drive(NamedTuple):
    """A drive without a line: N packets, one a period from time 0 on, and the true poses (N, 3) at their times."""

    packets: list[Packet]
    poses: Array


def drive(
    room: Room, policy: Callable[[Packet], tuple[float, float]], seconds: float, rng: np.random.Generator,
    physics: Physics | None = None, lidar: Lidar | None = None,
) -> Drive:  # fmt: skip
    """Drive through a room without waiting, as over a perfect line, for seconds / PERIOD packets. `policy` returns the
    speed [m/s] and turn rate [rad/s] to command after a packet; `rng` draws slip and sonars.
    """
    robot, unwrapper = Robot(room, rng, physics, lidar), Unwrapper()
    packets, poses = [], []
    for k in range(round(seconds / protocol.PERIOD)):
        t = k * protocol.PERIOD
        answer = robot.answer(t)
        packets.append(unwrapper.packet(t, answer, joined=True, scan=robot.scan(answer)))
        poses.append(robot.pose)
        robot.command(t, protocol.command_of(*policy(packets[-1])))
    return Drive(packets, np.array(poses).reshape(-1, 3))

"""The simulated robot: rooms (`walls:SEED`), motion, sonars and lidar in steps of its own time, a line with faults.

The same generator, room and timed commands give the same path and answers. Each wheel's PI loop with anti-windup brings
its encoder to the commanded speed; the ground follows with slip. A wall stops the body, not the wheels.

The motor is a first-order lag from duty to speed, with friction. The loop's zero cancels the motor's pole, so without a
load the wheel follows as a lag of `RESPONSE` (Astrom and Hagglund, PID Controllers, section 4.4).
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.se2 import Array, compose, wrap_angle
from wings.laser.floorplan.world import plan_of, scan_ranges
from wings.robot import packets as protocol
from wings.robot.packets import CONE_HALF_ANGLE, RADIUS, Beams, Scan, encode_scan
from wings.robot.traffic import Packet, Unwrapper
from wings.robot.walls import MIRROR

GAP = 6.0 * RADIUS  # m, least distance between objects in a room: three robots wide, so a wall follower gets through
TRIES = 1000


@dataclass(frozen=True)
class Room:
    """Walls (S, 2, 2) by their end points [m], and the start pose (3,) [m, m, rad], world frame."""

    segments: Array
    start: Array


class Echo(NamedTuple):
    """The nearest wall point in each of N cones."""

    distance: Array  # (N,) m, inf where the cone is empty
    incidence: Array  # (N,) rad, 0 to pi/2, between the direction of that point and the wall's normal


def _box(x0: float, y0: float, x1: float, y1: float) -> Array:
    """Sides (4, 2, 2) of an axis-parallel rectangle."""
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def room(seed: int) -> Room:
    """The room of a seed: 0 is 10 x 6 m with two boxes; others vary in size, boxes and partition walls. Objects are at
    least `GAP` apart; the robot starts a metre from two walls, facing along the one on its right.
    """
    start = np.array([1.0, 1.0, 0.0])
    if seed == 0:
        return Room(np.concatenate([_box(0, 0, 10, 6), _box(2.5, 3.4, 3.7, 4.6), _box(6.2, 1.8, 7.6, 2.8)]), start)
    rng = np.random.default_rng(seed)
    width, depth = rng.uniform(7.0, 12.0), rng.uniform(5.0, 8.0)
    walls = [_box(0.0, 0.0, width, depth)]
    taken = [(0.0, 0.0, start[0] + 0.5, start[1] + 0.5)]
    if rng.random() < 0.5:
        x, length = rng.uniform(0.4, 0.6) * width, rng.uniform(0.3, 0.5) * depth
        walls.append(np.array([[[x, depth], [x, depth - length]]]))
        taken.append((x, depth - length, x, depth))
    boxes = int(rng.integers(1, 5))
    for _ in range(TRIES):
        if not boxes:
            break
        w, d = rng.uniform(0.6, 1.6, 2)
        if min(width - w, depth - d) < 2.0 * GAP:
            continue
        x0, y0 = rng.uniform(GAP, width - GAP - w), rng.uniform(GAP, depth - GAP - d)
        new = (x0, y0, x0 + w, y0 + d)
        if all(_apart(new, other) >= GAP for other in taken):
            walls.append(_box(*new))
            taken.append(new)
            boxes -= 1
    return Room(np.concatenate(walls), start)


def floor_of(seed: int) -> Room:
    """The building of `floorplan:SEED` as a room; the robot starts on the first of its ways, along it."""
    building = plan_of(seed)
    at, to = building.ways.trace()[:2]
    return Room(building.walls.reshape(-1, 2, 2), np.array([*at, math.atan2(to[1] - at[1], to[0] - at[0])]))


def _apart(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> float:
    """Distance [m] of two rectangles x0, y0, x1, y1."""
    return math.hypot(max(a[0] - b[2], b[0] - a[2], 0.0), max(a[1] - b[3], b[1] - a[3], 0.0))


def cast(room: Room, poses: Array, half_angle: float = CONE_HALF_ANGLE) -> Echo:
    """Nearest wall point inside the cones of sensors at `poses` (N, 3), world frame, exactly: of each segment the foot
    of the perpendicular, an end, or where it meets an edge. A half angle of 0 is a beam, pi the whole circle.
    """
    poses = np.asarray(poses, float)
    a, b = room.segments[None, :, 0] - poses[:, None, :2], room.segments[None, :, 1] - poses[:, None, :2]
    e = b - a
    length2 = np.sum(e * e, axis=-1)
    share = np.clip(-np.sum(a * e, axis=-1) / length2, 0.0, 1.0)  # of the nearest point, were the cone all round
    shares = [share, np.zeros_like(share), np.ones_like(share)]
    for edge in (-half_angle, half_angle):
        dx, dy = np.cos(poses[:, 2, None] + edge), np.sin(poses[:, 2, None] + edge)
        across = e[..., 1] * dx - e[..., 0] * dy
        with np.errstate(divide="ignore", invalid="ignore"):
            shares.append((a[..., 0] * dy - a[..., 1] * dx) / across)
    u = np.stack(shares)  # (5, N, S)
    on_segment = (u >= 0.0) & (u <= 1.0)
    u = np.where(on_segment, u, 0.0)
    points = a + u[..., None] * e
    bearing = np.arctan2(points[..., 1], points[..., 0]) - poses[:, 2, None]
    bearing = np.abs(np.remainder(bearing + math.pi, 2.0 * math.pi) - math.pi)
    far = np.hypot(points[..., 0], points[..., 1])
    far = np.where(on_segment & (bearing <= half_angle + 1e-9), far, np.inf)
    which = np.argmin(far, axis=0)[None]
    far = np.take_along_axis(far, which, axis=0)[0]  # (N, S)
    wall = np.argmin(far, axis=1)
    rows = np.arange(len(poses))
    point = np.take_along_axis(points, which[..., None], axis=0)[0][rows, wall]
    along = np.abs(np.sum(point * e[rows, wall], axis=-1))
    norm = np.sqrt(length2[0, wall]) * np.hypot(point[:, 0], point[:, 1])
    return Echo(far[rows, wall], np.arcsin(np.clip(along / np.where(norm > 0.0, norm, 1.0), 0.0, 1.0)))


def clearance(room: Room, point: Array) -> float:
    """Distance [m] from a point (2,) or pose (3,) to the nearest wall."""
    a, b = room.segments[:, 0] - point[:2], room.segments[:, 1] - point[:2]
    e = b - a
    share = np.clip(-np.sum(a * e, axis=1) / np.sum(e * e, axis=1), 0.0, 1.0)
    return float(np.sqrt(np.sum((a + share[:, None] * e) ** 2, axis=1).min()))


LAG = 0.1  # s, time constant of the motor: a geared motor of 6 V with a 65 mm wheel
FULL_SPEED = 1.25 * protocol.FASTEST_WHEEL  # m/s of the rim at full duty without load: 25 % as reserve of the loop
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
SHORTEST_RANGE = 0.02  # m. Nearer echoes return while the sonar still sends


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
        v, turning = command.speed / 1000.0, 0.5 * protocol.WHEEL_BASE * (command.turn / 1000.0)
        most = protocol.FASTEST_WHEEL
        self._wanted = tuple(min(max(speed, -most), most) for speed in (v - turning, v + turning))
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
        return self.lidar.scan(self.room, self.pose, self.time, (answer.x, answer.y, answer.heading), self._light)

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

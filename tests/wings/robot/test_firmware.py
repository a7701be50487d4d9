"""The firmware of docs/robot/firmware in a simulated ATmega328: motors, encoders and sonars of the simulated robot."""

import math
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data.logs import open_log
from data.se2 import compose, wrap_angle
from tests.wings.robot.line import StandingClock, WirePort
from tests.wings.robot.live.driven import Process, started, wait
from wings.robot.link import Clock, Link
from wings.robot.packets import FASTEST_WHEEL, PERIOD, SONARS, TIMEOUT_MM, WATCHDOG, WHEEL_BASE, command_of
from wings.robot.simulate import Terminal, run
from wings.robot.simulated import METRES_PER_TICK, PATIENCE, STEP, cast, room, turned
from wings.robot.walls import MIRROR

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "docs" / "robot" / "firmware"
pytestmark = [
    pytest.mark.slow,  # the chip is simulated cycle by cycle
    pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="avr-gcc is not installed"),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder of both programs of the firmware, and of the board that runs them."""
    folder = tmp_path_factory.mktemp("firmware")
    subprocess.run(["make", "-s", "-C", FOLDER, f"OUT={folder}"], check=True, capture_output=True)
    source = Path(__file__).with_name("avr_board.c")
    words = ["cc", "-O2", "-o", folder / "avr_board", source, "-lsimavr", "-lelf"]
    if shutil.which("cc") is None or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("a C compiler with libsimavr and libelf is not installed")
    return folder


class Board:
    """The board on a robot without slip in room 0, as a wire (see `Wire`); `drop` and `flip` harm its bytes."""

    def __init__(self, built, framed, rng=None):
        program = built / ("robot-framed.elf" if framed else "robot.elf")
        self._process = subprocess.Popen(
            [built / "avr_board", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.room, self.pose = room(0), np.array(room(0).start, float)
        self.start, self.steps, self.duty, self.wheels = self.pose.copy(), 0, (0.0, 0.0), (0.0, 0.0)
        self.drop = self.flip = 0.0
        self._rng, self._out, self._came = rng, b"", bytearray()
        self.advance(0.5)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.communicate()

    def _harmed(self, data):
        if not self.drop and not self.flip:
            return data
        kept = [b for b in data if self._rng.random() >= self.drop]
        return bytes(b ^ (1 << int(self._rng.integers(8))) if self._rng.random() < self.flip else b for b in kept)

    def echoes(self):
        """Distances (8,) [m] that the sonars can hear now; inf for none."""
        echo = cast(self.room, compose(self.pose, SONARS))
        return np.where((echo.incidence > MIRROR) | (echo.distance > TIMEOUT_MM / 1000.0), np.inf, echo.distance)

    def _step(self, seconds=STEP):
        """Longer steps are for a robot at rest."""
        before = self.wheels
        self.wheels = tuple(turned(now, duty, STEP) for now, duty in zip(before, self.duty, strict=True))
        left, right = (0.5 * (a + b) for a, b in zip(before, self.wheels, strict=True))
        turn, forward = (right - left) / WHEEL_BASE * STEP, 0.5 * (left + right) * STEP
        middle = self.pose[2] + 0.5 * turn
        self.pose = self.pose + [forward * math.cos(middle), forward * math.sin(middle), turn]
        if self.steps % 3 == 0:  # a sonar's turn
            self.widths = [f"{5800.0 * d:.0f}" if d < math.inf else "0" for d in self.echoes()]
        rates = f"{left / METRES_PER_TICK:.9f} {right / METRES_PER_TICK:.9f}"
        self._process.stdin.write(f"{seconds * 1e6:.0f} {rates} {' '.join(self.widths)} {self._out.hex() or '-'}\n")
        self._process.stdin.flush()
        duty_left, duty_right, came = self._process.stdout.readline().split()
        self.duty = int(duty_left) / 1000.0, int(duty_right) / 1000.0
        self._came += self._harmed(b"" if came == "-" else bytes.fromhex(came))
        self._out, self.steps = b"", self.steps + round(seconds / STEP)

    def advance(self, seconds):
        for _ in range(round(seconds / STEP)):
            self._step()

    def driven(self):
        """The pose (3,) from the start, heading included unwrapped."""
        c, s = math.cos(self.start[2]), math.sin(self.start[2])
        dx, dy, turn = self.pose - self.start
        return np.array([c * dx + s * dy, c * dy - s * dx, turn])

    # as a wire; times count from the end of the first half second

    def write(self, t, data):
        self._pass(t)
        self._out += self._harmed(data)

    def _pass(self, t):
        self.advance(max(t - self.steps * STEP + 0.5 + 1e-9, 0.0))

    def read(self, t):
        self._pass(t)
        came, self._came = bytes(self._came), bytearray()
        return came

    def due(self):
        return (self.steps + 1) * STEP - 0.5


def linked(board, framed):
    clock = StandingClock()
    return Link("robot", clock, with_frames=framed, open_port=lambda _: WirePort(board, clock))


@pytest.mark.parametrize("framed", [False, True])
def test_odometry_and_sonars_follow_the_robot(built, framed):
    with Board(built, framed) as board:
        link = linked(board, framed)
        heard = board.echoes()
        first = link.step(command_of(0.0, 0.0))[-1]
        np.testing.assert_allclose(first.ranges[:2], heard[:2], atol=0.002)  # the others have not had their turn
        for k in range(36):
            speed, turn = [(0.3, 0.5), (-0.25, -0.8), (0.0, 2.0)][k // 12]
            (packet,) = link.step(command_of(speed, turn))
            if k % 12 == 11:
                # the wheels run at the commanded speeds
                got = 0.5 * sum(board.wheels), (board.wheels[1] - board.wheels[0]) / WHEEL_BASE
                np.testing.assert_allclose(got, (speed, turn), atol=0.05)
        for _ in range(4):
            (packet,) = link.step(command_of(0.0, 0.0))
        assert board.wheels == (0.0, 0.0)
        turn = packet.odometry[2] - board.driven()[2]
        np.testing.assert_allclose(packet.odometry[:2], board.driven()[:2], atol=0.003)
        assert abs(turn) < 0.005
        assert abs(board.driven()[2]) > 4.0
        link.step(command_of(0.0, 0.0))
        (packet,) = link.step(command_of(0.0, 0.0))
        np.testing.assert_allclose(packet.ranges, board.echoes(), atol=0.002)
        (packet,) = [link.step(command_of(30.0, 0.0)) for _ in range(4)][-1]  # limited
        assert max(board.wheels) < 1.1 * FASTEST_WHEEL


@pytest.mark.parametrize("framed", [False, True])
def test_answers_go_on_when_bytes_are_lost_and_flipped(built, framed):
    with Board(built, framed, np.random.default_rng(3)) as board:
        link = linked(board, framed)
        board.drop, board.flip = 0.01, 0.001
        answers = sum(len(link.step(command_of(0.1, 1.0))) for _ in range(80))
        faults = sum(link.exchange.faults.values())
        assert answers > 40  # 34 bytes with frames: 0.989 ^ 34 = 0.69 of them pass
        assert faults > 7
        board.drop = board.flip = 0.0
        link.step(command_of(0.0, 0.0))
        for _ in range(6):
            packets = link.step(command_of(0.0, 0.0))
            assert len(packets) >= 1
        np.testing.assert_allclose(packets[-1].odometry[:2], board.driven()[:2], atol=0.003)
        assert abs(wrap_angle(packets[-1].odometry[2] - board.driven()[2])) < 0.005


@pytest.mark.parametrize("framed", [False, True])
def test_motors_stop_a_second_after_the_last_command(built, framed):
    with Board(built, framed) as board:
        link = linked(board, framed)
        for _ in range(8):
            link.step(command_of(0.3, 0.0))
        # step returns with the answer, some 0.03 s after the command
        board.advance(PATIENCE - (board.steps * STEP - 0.5 - (link._next - PERIOD)) - 0.02)
        assert min(board.wheels) > 0.25
        board.advance(WATCHDOG - PATIENCE + 0.04)
        assert board.duty == (0.0, 0.0)
        assert board.wheels == (0.0, 0.0)
        board._step(70.0)  # the firmware's milliseconds overflow
        assert board.duty == (0.0, 0.0)


def pumped(words):
    """The board on a pseudo-terminal until it is terminated, by a clock; where the robot stands then goes to a file."""
    built, link, speed = words
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with Board(Path(built), True, np.random.default_rng(3)) as board, Terminal(Path(link)) as terminal:
        board.drop, board.flip = 0.003, 0.001
        try:
            run(board, terminal, Clock(float(speed)))
        finally:
            np.savetxt(f"{link}.end", board.driven())


def test_a_drive_over_a_pseudo_terminal_with_bytes_lost_and_flipped_is_scored(built, tmp_path):
    link, speed = tmp_path / "robot", 0.2  # the chip is simulated three times as fast as it is on an idle machine
    board = Process(pumped, [built, link, speed], tmp_path / "board.out")
    try:
        wait(link.exists)
        words = ["--speed", speed, "--framed", "--seconds", 20, "--no-page", "--estimator", "ekf-fej,isam2"]
        with started(tmp_path, link, *words) as live:
            assert live.status(900.0) == 0, live.said
        board.signal(signal.SIGTERM)
        board.status()
    finally:
        board.kill()
    log, end = open_log(str(tmp_path / "log")), np.loadtxt(f"{link}.end")
    assert "Faults of the link" in log.notes[0]
    assert len(log.recorded) > 50
    assert set(pd.read_csv(tmp_path / "log-report" / "metrics.csv")["status"]) == {"ok"}
    path = pd.read_csv(tmp_path / "log-report" / "runs" / "log" / "slam-isam2-jcbb" / "final.csv")
    assert np.hypot(*end[:2]) > 2.0
    np.testing.assert_allclose(path[["x", "y"]].to_numpy()[-1], end[:2], atol=0.1)

"""The simulated robot on a pseudo-terminal, byte-compatible with the real one: `python -m data.robot.simulate`."""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import sys
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from data.errors import UsageError
from data.terminal import ending
from eval.plan.flags import command_of

if TYPE_CHECKING:
    from wings.robot.link import Clock
    from wings.robot.simulated import Wire

PROG = "python -m data.robot.simulate"
TRUTH_PERIOD = 0.05  # s of robot time between rows of the truth
LONGEST_WAIT = 0.05  # s of real time to wait for a byte before the robot moves on


class Terminal(contextlib.AbstractContextManager["Terminal"]):
    """A pseudo-terminal with a symbolic link to the end that serves as serial device; `with` removes it."""

    def __init__(self, path: Path) -> None:
        """Open it; UsageError if impossible. A link to a terminal is replaced: a killed simulator leaves it behind."""
        self._path = path
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self._device = os.ttyname(self._slave)
        try:
            if path.is_symlink() and os.readlink(path).startswith("/dev/"):
                path.unlink()
            path.symlink_to(self._device)
        except FileExistsError:
            self._close()
            raise UsageError(f"--link {path}: exists already; remove it or name another path") from None
        except OSError as error:
            self._close()
            raise UsageError(f"--link {path}: {error.strerror}") from None

    def read(self, wait: float) -> bytes:
        """Bytes received within a real time [s]."""
        ready, _, _ = select.select([self.master], [], [], max(wait, 0.0))
        return os.read(self.master, 4096) if ready else b""

    def write(self, data: bytes) -> None:
        """Send; bytes that nobody reads are lost, as on a line."""
        with contextlib.suppress(BlockingIOError):
            os.write(self.master, data)

    def _close(self) -> None:
        os.close(self.master)
        os.close(self._slave)  # held open until now, so that a reader may come and go

    def __exit__(self, *_: object) -> None:
        if self._path.is_symlink() and os.readlink(self._path) == self._device:
            self._path.unlink()
        self._close()


def run(wire: Wire, terminal: Terminal, clock: Clock, truth: TextIO | None = None) -> None:
    """Run the robot by the clock until the process is terminated; its true path (t,x,y,theta) goes to `truth`."""
    rows = 0
    if truth is not None:
        truth.write("t,x,y,theta\n")
    while True:
        now = clock.now()
        while truth is not None and rows * TRUTH_PERIOD <= now:
            wire.advance(rows * TRUTH_PERIOD)
            x, y, theta = wire.robot.pose.tolist()
            truth.write(f"{rows * TRUTH_PERIOD:.2f},{x!r},{y!r},{theta!r}\n")
            rows += 1
        data = wire.read(now)
        if data:
            terminal.write(data)
        came = terminal.read(min((wire.due() - clock.now()) / clock.speed, LONGEST_WAIT))
        if came:
            wire.write(clock.now(), came)


@ending()
def main(argv: Sequence[str] | None = None) -> None:
    """Simulate until terminated; 0, or 2 with one line on stderr."""
    args = command_of(PROG, PROG, "simulate").read(argv)
    world = re.fullmatch(r"(walls|floorplan):([0-9]{1,9})", args.world)
    if world is None:
        right = "walls:SEED or floorplan:SEED is one, with a whole number from 0 up"
        raise UsageError(f"--world {args.world}: no such world; {right}")
    import numpy as np

    from wings.robot.link import Clock
    from wings.robot.simulated import Faults, Lidar, Robot, Wire, floor_of, room

    body, line = np.random.default_rng(args.seed).spawn(2)
    place = (room if world[1] == "walls" else floor_of)(int(world[2]))
    robot = Robot(place, body, lidar=Lidar() if args.lidar else None)
    if robot.lidar is not None:  # compiles, or loads, what measures ranges: the robot's clock has not begun
        robot.lidar.scan(robot.room, robot.pose, 0.0, (0, 0, 0), np.random.default_rng(0))
    wire = Wire(robot, Faults(args.drop, args.flip, args.stall), line, with_frames=args.framed)
    for name in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(name, lambda *_: sys.exit(0))
    with contextlib.ExitStack() as stack:
        truth = None if args.truth is None else stack.enter_context(args.truth.open("w", buffering=1))
        run(wire, stack.enter_context(Terminal(args.link)), Clock(args.speed), truth)

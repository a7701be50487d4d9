"""The simulated robot on a pseudo-terminal, with the same bytes as the real one: `python -m data.robot.simulate`."""

from __future__ import annotations

import argparse
import os
import re
import select
import signal
import sys
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from data.errors import UsageError
from data.terminal import ended
from data.worlds.registry import seed

if TYPE_CHECKING:
    from data.robot.link import Clock
    from data.robot.simulated.wire import Wire

TRUTH_PERIOD = 0.05
"""s of robot time between rows of the truth."""
LONGEST_WAIT = 0.05
"""s of real time after which the robot's time goes on though no byte came."""
TERMINALS = "/dev/"
"""Where pseudo-terminals have their names."""
EXAMPLE = """\
example:
  python -m data.robot.simulate --world walls:0 --link /tmp/robot &
  python -m data.robot.simulate --world walls:3 --link /tmp/robot --drop 0.01 --flip 0.001 --stall 5 --truth path.csv
"""


class Terminal:
    """A pseudo-terminal with a symbolic link to the end that is opened as a serial device; `with` removes it."""

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            UsageError: the path cannot become a link. One to a terminal, or to where there was one, is replaced: a
                simulator that was killed leaves it behind, and numbers of terminals are given out again.
        """
        self._path = path
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self._device = os.ttyname(self._slave)
        try:
            if path.is_symlink() and os.readlink(path).startswith(TERMINALS):
                path.unlink()
            path.symlink_to(self._device)
        except FileExistsError:
            self._close()
            raise UsageError(f"--link {path}: there is something already; remove it or name another path") from None
        except OSError as error:
            self._close()
            raise UsageError(f"--link {path}: {error.strerror}") from None

    def read(self, wait: float) -> bytes:
        """Bytes that have come, within a real time [s]."""
        ready, _, _ = select.select([self.master], [], [], max(wait, 0.0))
        return os.read(self.master, 4096) if ready else b""

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost, as on a line."""
        try:
            os.write(self.master, data)
        except BlockingIOError:
            return

    def _close(self) -> None:
        os.close(self.master)
        os.close(self._slave)  # held open until now, so that a reader may come and go

    def __enter__(self) -> Terminal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._path.is_symlink() and os.readlink(self._path) == self._device:
            self._path.unlink()
        self._close()


def run(wire: Wire, terminal: Terminal, clock: Clock, truth: TextIO | None = None) -> None:
    """Let the robot live by the clock until the process is told to end; its true path to `truth`, t,x,y,theta."""
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


def seed_of(world: str) -> int:
    """The seed of a world's name, `walls:SEED`."""
    match = re.fullmatch(r"walls:([0-9]{1,9})", world)
    if match is None:
        raise UsageError(f"--world {world}: no such world; walls:SEED is one, with a whole number from 0 up")
    return int(match[1])


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = argparse.ArgumentParser(
        prog="python -m data.robot.simulate",
        description="A small robot on a pseudo-terminal, until it is interrupted. It stops by itself 1 s after the last"
        " command.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    top.add_argument("--world", default="walls:0", metavar="walls:SEED", help="its room (default: walls:0)")
    top.add_argument(
        "--link", type=Path, required=True, metavar="PATH", help="symbolic link to the terminal; there when it is ready"
    )
    share = _number(0.0, 1.0)
    top.add_argument("--drop", type=share, default=0.0, metavar="P", help="probability that a byte is lost")
    top.add_argument("--flip", type=share, default=0.0, metavar="P", help="probability that a bit of a byte turns over")
    top.add_argument(
        "--stall",
        type=_number(0.0, 3600.0),
        default=0.0,
        metavar="SECONDS",
        help="how long a direction stands still, about once a minute (once in 6000 bytes): answers come late, commands"
        " are lost",
    )
    top.add_argument(
        "--speed", type=_number(0.01, 1000.0), default=1.0, metavar="X", help="robot seconds in a second (default: 1)"
    )
    top.add_argument("--framed", action="store_true", help="packets between a marker and a checksum, both ways")
    top.add_argument("--seed", type=seed, default=0, metavar="N", help="of slip, sonars and faults (default: 0)")
    top.add_argument(
        "--truth", type=Path, metavar="FILE", help="CSV to write the true path to: t,x,y,theta, 20 a second"
    )
    return top


def _number(low: float, high: float) -> Callable[[str], float]:
    def convert(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not from {low:g} to {high:g}")
        return value

    convert.__name__ = "number"  # argparse names the type in its message
    return convert


def _told_to_end(*_: object) -> None:
    raise SystemExit(0)


def _simulate(argv: Sequence[str] | None) -> None:
    args = parser().parse_args(argv)
    where = seed_of(args.world)
    import numpy as np

    from data.robot.link import Clock
    from data.robot.simulated.physics import Robot
    from data.robot.simulated.room import room
    from data.robot.simulated.wire import Faults, Wire

    body, line = np.random.default_rng(args.seed).spawn(2)
    wire = Wire(Robot(room(where), body), Faults(args.drop, args.flip, args.stall), line, with_frames=args.framed)
    for name in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(name, _told_to_end)
    truth = None if args.truth is None else args.truth.open("w", buffering=1)
    try:
        with Terminal(args.link) as terminal:
            run(wire, terminal, Clock(args.speed), truth)
    finally:
        if truth is not None:
            truth.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Simulate until told to end; 0, or 2 with one line on stderr."""
    return ended(lambda: _simulate(argv))


if __name__ == "__main__":
    sys.exit(main())

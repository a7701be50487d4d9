"""The loop of a drive: command, answer, estimates; signals are deferred to the time between two packets."""

import signal
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from wings.robot.link import Clock, Link
from wings.robot.live.feed import MINUTE, Feed, header
from wings.robot.live.scanning import GridPainter
from wings.robot.live.session import Latencies, Session, Step, Taken, estimator_words, latency_table, status_line
from wings.robot.packets import PERIOD, WATCHDOG, Command, command_of
from wings.robot.traffic import Packet

REST = Command(0, 0)
SECOND = 1.0  # s of real time between status lines

Policy = Callable[[Packet], tuple[float, float]]


def at_rest(packet: Packet) -> tuple[float, float]:
    """The policy of `--drive none`."""
    return 0.0, 0.0


def drive(
    link: Link, clock: Clock, session: Session, policy: Policy, stop: Callable[[], bool],
    look: Callable[[float], None] = lambda t: None, latencies: Latencies | None = None,
) -> None:  # fmt: skip
    """Drive until `stop`, then command rest, as after a silence of `WATCHDOG`; every received packet is processed, and
    `look` is called after each period with the robot's time [s].
    """
    command, heard = REST, clock.now()

    def take(packets: Sequence[Packet]) -> None:
        for packet in packets:
            session.take(packet)
        # the newest one counts: an answer without a marker may wait for the next one
        if packets and latencies is not None:
            latencies.add((clock.now() - packets[-1].t) / clock.speed)

    try:
        while not stop():
            packets = link.step(command)
            take(packets)
            for packet in packets:
                command, heard = command_of(*policy(packet)), packet.t
            if clock.now() - heard > WATCHDOG:
                command = REST
            look(clock.now())
    finally:
        last = link.step(REST)
    take(last)


class Looking:
    """Prints the status and feeds the page, once a second."""

    def __init__(
        self, name: str, session: Session, faults: Callable[[], dict[str, int]], say: Callable[[str], None], *,
        feed: Feed | None = None, speed: float = 1.0, painter: GridPainter | None = None,
    ) -> None:  # fmt: skip
        """`say` gets the lines, `faults` counts those of the link; `speed` is the clock's; `painter` draws the grid."""
        self.latencies = Latencies()  # of all estimates so far
        self._name, self._session, self._faults, self._say, self._feed = name, session, faults, say, feed
        self._period, self._painter = PERIOD / speed, painter
        self._newest: list[Step | None] = [None] * len(session.estimating)
        self._ended: set[int] = set()
        self._at = time.monotonic()

    def take(self, taken: Taken) -> None:
        """Take a processed frame."""
        self._newest = [new or old for new, old in zip(taken.steps, self._newest, strict=True)]
        if self._feed is not None:
            self._feed.add(taken)

    def look(self, t: float) -> None:
        """Finish a period at robot time t [s]."""
        if self._painter is not None:
            self._painter.work(t)
        now = time.monotonic()
        if now - self._at >= SECOND:
            self._at += SECOND * int((now - self._at) / SECOND)
            self.say(t)
        elif self._feed is not None and len(self._feed.waiting) >= MINUTE:
            self.say(t, aloud=False)

    def end(self, t: float) -> None:
        """Finish the drive: the last line and grid, and the table of latencies."""
        if self._painter is not None:
            self._painter.work(t, last=True)
        self.say(t)
        for line in latency_table([each.title for each in self._session.estimating], self._session.spent, self._period):
            self._say(line)

    def say(self, t: float, *, aloud: bool = True) -> None:
        """Print the line, and publish the page's next chunk."""
        s = self._session
        for number, each in enumerate(s.estimating):
            if each.failure and number not in self._ended:
                self._ended.add(number)
                self._say(f"{each.title} ended {each.failure}; the others and the recording go on")
        maps = [each.map() for each in s.estimating]
        newest = zip(s.estimating, self._newest, strict=True)
        words = [estimator_words(each.title, step, each.counted(), each.failure) for each, step in newest]
        line = status_line(t, words, self._faults(), self.latencies, self._period)
        if aloud:
            self.latencies.begin()
            self._say(line)
        if self._feed is not None:
            self._feed.publish(maps, header(self._name, s.estimating, line))


class Presses:
    """Deferred SIGINT and SIGTERM: counts them while the block runs, and restores their handlers afterwards."""

    def __init__(self) -> None:
        self.count, self._heeded = 0, False
        self._before: dict[int, Any] = {}

    def _press(self, *_: object) -> None:
        self.count += 1
        if self._heeded:
            raise KeyboardInterrupt

    def heed(self) -> None:
        """From now on both signals end the program at once."""
        self._heeded = True

    def __enter__(self) -> "Presses":
        if threading.current_thread() is threading.main_thread():
            self._before = {s: signal.signal(s, self._press) for s in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

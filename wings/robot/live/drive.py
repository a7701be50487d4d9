"""The loop of a drive: command, answer, estimates; signals are deferred to the time between two packets."""

import math
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from data.se2 import wrap_angle
from wings.robot.link import Clock, Link
from wings.robot.live.feed import MINUTE, Feed, header
from wings.robot.live.session import GridPainter, Latencies, Session, Step, Taken
from wings.robot.packets import PERIOD, WATCHDOG, Command, command_of
from wings.robot.traffic import Packet

REST = Command(0, 0)
SECOND = 1.0  # s of real time between status lines


def drive(
    link: Link, clock: Clock, session: Session, policy: Callable[[Packet], tuple[float, float]],
    stop: Callable[[], bool], look: Callable[[float], None] = lambda t: None, latencies: Latencies | None = None,
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


def estimator_words(name: str, step: Step | None, counted: str, failure: str) -> str:
    """An estimator with its newest pose and 3 sigma (m, degrees) and how much it has mapped, or its end."""
    if failure or step is None:
        return f"{name} ended" if failure else f"{name} waits"
    x, y, heading = 3.0 * np.sqrt(np.maximum(np.diag(step.covariance), 0.0))
    at = f"x {step.mean[0]:.3f} ± {x:.3f}, y {step.mean[1]:.3f} ± {y:.3f} m"
    degrees = math.degrees(float(wrap_angle(float(step.mean[2]))))
    return f"{name} {at}, heading {degrees:.1f} ± {math.degrees(heading):.1f}°" + (f", {counted}" if counted else "")


def latency_table(titles: Sequence[str], spent: Sequence[Latencies], period: float) -> list[str]:
    """Lines of a table: time of each estimator by frame, and whether it stays below the `period` [s] of real time."""
    width = max(map(len, ("estimator", *titles)))
    lines = [f"{'estimator':{width}}  median    99 %  longest  [ms a frame; period {1e3 * period:g}]"]
    for title, own in zip(titles, spent, strict=True):
        cells = (own.within(0.5), own.within(0.99), own.longest)
        if math.isfinite(cells[0]):
            lines.append(f"{title:{width}}  {1e3 * cells[0]:6.1f}  {1e3 * cells[1]:6.1f}  {1e3 * cells[2]:7.1f}")
    return lines


def status_line(t: float, names: Sequence[str], faults: Mapping[str, int], latencies: Latencies, period: float) -> str:
    """The status; `period` [s]: real time between frames, beyond which an estimate is late."""
    counted = ", ".join(f"{name} {count}" for name, count in faults.items() if count)
    parts = [f"{t:7.1f} s", *names, f"link: {counted or 'no faults'}"]
    soon = latencies.within(0.99)
    if math.isfinite(soon):
        parts.append(f"latency {1e3 * latencies.longest:.1f} ms, 99 % < {1e3 * soon:.1f} ms")
    if latencies.longest > period:
        parts.append(f"late: {latencies.longest:.2f} s, longer than a period of {period:g} s")
    return " | ".join(parts)


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

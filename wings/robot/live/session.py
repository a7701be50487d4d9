"""Online estimators: each packet becomes a frame, which passes the front end of each.

The steps are those of a replay (`eval.replay.run.through`), so a replayed recording gives the same numbers. A failure
ends one estimator alone. Also here: estimates written to CSV at once; a rehearsal, so that nothing is compiled while
the robot moves (compiling a kernel takes seconds, loading one 40 ms; a frame has 250 ms); and the status line.
"""

import math
import time
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data.errors import UsageError
from data.inputs import Frame, IntArray
from data.result import DISCARD, MapState, Updated
from data.se2 import Array, wrap_angle
from data.terminal import message_of
from ekf.slam import EkfSlam
from eval.player.watch import map_now
from eval.replay.external.adapter import CannotError, ForeignError, require
from eval.replay.external.spec import is_foreign, name_of
from eval.replay.run import DIVERGED, front_end, through
from eval.replay.settings import Beginning, Setup
from graph.factors import UnderConstrained
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from wings.robot.driving import WallFollower
from wings.robot.log import SENSOR, USUAL, Framing, Noise, prior
from wings.robot.packets import Scan
from wings.robot.simulated import Lidar, drive, room
from wings.robot.traffic import Packet
from wings.robot.walls import USUAL_FIT

ROBOT = Beginning(prior(), SENSOR)  # SLAM from the origin


@dataclass(frozen=True, eq=False)
class Step:
    """An estimator after a frame."""

    mean: Array  # (3,) pose [m, m, rad], world frame
    covariance: Array  # (3, 3) of it
    decisions: IntArray  # (m,) about the frame's observations, as in `data.result.Run`
    created: IntArray  # (m,) landmarks they initialized, -1 for none
    nis: float  # per degree of freedom; NaN where nothing was paired


class Taken(NamedTuple):
    """A frame and each estimator's step, None after its end."""

    frame: Frame
    steps: tuple[Step | None, ...]


class Online(ABC):
    """An online estimator."""

    name: str  # as in a replay
    association: str
    title: str  # both, where the association is not that of the others
    failure = ""  # why it ended; empty while it runs
    smooths: bool

    def take(self, frame: Frame, scan: Scan | None = None) -> Step | None:
        """Process the next frame, and its scan; None if the estimator has ended, or has nothing yet."""
        if self.failure:
            return None
        try:
            return self._take(frame, scan)
        except (*DIVERGED, ForeignError, UnderConstrained) as stop:
            self.failure = f"at frame {frame.number}: {stop}"
            return None

    @abstractmethod
    def _take(self, frame: Frame, scan: Scan | None) -> Step | None: ...

    @abstractmethod
    def map(self) -> MapState | None:
        """Its current walls, without side effects; None if not available."""

    @abstractmethod
    def counted(self) -> str:
        """How much it has mapped, in words; empty if not available."""


class Estimating(Online):
    """One online estimator by walls."""

    def __init__(self, name: str, association: str, setup: Setup) -> None:
        """Make it. Raises UsageError: a foreign estimator lacks something, or failed at once."""
        self.name = self.title = name_of(name)
        setup = setup.settled(sensed=False)
        try:
            if is_foreign(name):
                require(name, "slam", association, setup)
            self.front = front_end(name, association, ROBOT, setup)
        except (CannotError, ForeignError) as stop:
            raise UsageError(f"--estimator {self.name}: {stop}") from None
        if isinstance(self.front.estimator, FixedLagSmoother):
            self.front.estimator.keep_no_path()
        self.association, self.smooths = self.front.association, self.front.estimator.smooths

    def _take(self, frame: Frame, scan: Scan | None) -> Step:
        nothing = len(frame.observations.z)
        decided, created, nis = np.full(nothing, DISCARD, np.int64), np.full(nothing, -1, np.int64), np.nan

        def used(part: Frame, decisions: IntArray, done: Updated) -> None:
            nonlocal nis
            rows = slice(part.first - frame.first, part.first - frame.first + len(decisions))
            decided[rows] = np.where((decisions >= 0) & ~done.used, DISCARD, decisions)
            created[rows] = done.created
            nis = done.nis / done.dof if done.dof else np.nan

        through(self.front, frame, used)
        return Step(*self.front.estimator.estimate(), decided, created, nis)

    def map(self) -> MapState | None:
        """Its current walls."""
        estimator = self.front.estimator
        return map_now(estimator) if isinstance(estimator, EkfSlam | Isam2Smoother) and not self.failure else None

    def counted(self) -> str:
        """Its number of walls."""
        state = self.map()
        return "" if state is None else f"walls {len(state.number)}"


class Session:
    """Frames of a drive."""

    def __init__(
        self, names: Sequence[str], association: str, setup: Setup, noise: Noise = USUAL,
        processed: Callable[[Taken], None] = lambda taken: None, fit: str = USUAL_FIT, scanning: Online | None = None,
    ) -> None:  # fmt: skip
        """Start; `processed` gets frames, `fit` is of walls (`walls.FITS`), `scanning` another estimator."""
        self.estimating: list[Online] = [Estimating(name, association, setup) for name in names]
        self.estimating += [] if scanning is None else [scanning]
        self.spent = [Latencies() for _ in self.estimating]  # time of each estimator by frame
        self.frames = self.observations = 0
        self._framing, self._processed = Framing(noise, fit), processed

    def take(self, packet: Packet) -> Taken:
        """Convert a packet to a frame, and pass it to every estimator."""
        frame = self._framing.frame(packet)
        self.frames, self.observations = frame.number + 1, frame.first + len(frame.observations.z)
        steps = []
        for each, spent in zip(self.estimating, self.spent, strict=True):
            began = time.perf_counter()
            steps.append(each.take(frame, packet.scan))
            spent.add(time.perf_counter() - began)
        taken = Taken(frame, tuple(steps))
        self._processed(taken)
        return taken


COLUMNS = "frame,t,estimator,x,y,theta,xx,xy,xt,yy,yt,tt"  # Pose [m, rad] and its covariance, written without loss


@contextmanager
def estimates(path: Path, names: Sequence[str]) -> Iterator[Callable[[Taken], None]]:
    """A receiver that writes each estimator's line of a frame at once. UsageError: not writable, or it exists."""
    try:
        file = path.open("x", encoding="utf-8", buffering=1)
    except OSError as fault:
        raise UsageError(f"--estimates {path}: {message_of(fault)}") from None

    def add(taken: Taken) -> None:
        for name, step in zip(names, taken.steps, strict=True):
            if step is not None:
                values = [*step.mean.tolist(), *step.covariance[np.triu_indices(3)].tolist()]
                file.write(",".join([str(taken.frame.number), repr(taken.frame.time), name, *map(repr, values)]) + "\n")

    with file:
        file.write(COLUMNS + "\n")
        yield add


DRIVEN = 15.0  # s of a simulated drive


def rehearse(names: Sequence[str], association: str, setup: Setup, scanning: Online | None = None) -> None:
    """A short simulated drive, with a lidar for an estimator of scans."""
    session = Session(names, association, setup, scanning=scanning)
    lidar = None if scanning is None else Lidar()
    for packet in drive(room(0), WallFollower(), DRIVEN, np.random.default_rng(0), lidar=lidar).packets:
        session.take(packet)
    for each in session.estimating:
        each.map()


SIGMAS = 3.0


class Latencies:
    """Latencies [s] of a drive; `longest`: of those since `begin`."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._all = array("d")

    def add(self, seconds: float) -> None:
        """Add a latency."""
        self.longest = max(self.longest, seconds)
        self._all.append(seconds)

    def begin(self) -> None:
        """Reset the longest one."""
        self.longest = 0.0

    def within(self, share: float) -> float:
        """Time [s] within which this share of all estimates came; NaN if there are none."""
        return float(np.quantile(self._all, share)) if self._all else math.nan


def estimator_words(name: str, step: Step | None, counted: str, failure: str) -> str:
    """An estimator with its newest pose and 3 sigma (m, degrees) and how much it has mapped, or its end."""
    if failure or step is None:
        return f"{name} ended" if failure else f"{name} waits"
    x, y, heading = SIGMAS * np.sqrt(np.maximum(np.diag(step.covariance), 0.0))
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

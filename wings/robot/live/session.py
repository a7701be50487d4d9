"""Online estimators: each packet becomes a frame, which passes the front end of each.

The steps are those of a replay (`eval.replay.run.through`), so a replayed recording gives the same numbers. A failure
ends one estimator alone. Also here: estimates written to CSV at once; a rehearsal, so that nothing is compiled while
the robot moves (compiling a kernel takes seconds, loading one 40 ms; a frame has 250 ms). With a
lidar: graph SLAM by scan matching, by the front end of laser logs, a frame at a time, and its grid.
"""

import base64
import io
import json
import math
import time
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from data.errors import UsageError
from data.inputs import Frame, Increment, IntArray, Scanner
from data.result import DISCARD, MapState, Updated
from data.se2 import Array
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
from wings.laser.scans.occupancy import Grid, occupancy_grid
from wings.laser.slam.incremental import ScanSlam
from wings.laser.slam.parameters import LaserParameters
from wings.robot.driving import WallFollower
from wings.robot.log import PRIOR, SENSOR, USUAL, Framing, Noise
from wings.robot.packets import Scan
from wings.robot.simulated import Lidar, drive, room
from wings.robot.traffic import Packet
from wings.robot.walls import USUAL_FIT

ROBOT = Beginning(PRIOR, SENSOR)  # SLAM from the origin


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


Scanned = tuple[Array, Array, Scanner]  # poses (n, 3), scans (n, B), of one scanner


class ScanEstimating(Online):
    """The online estimator of scans, called as in a replay."""

    name, association, title, smooths = "isam2", "scan", "isam2 scan", True

    def __init__(self, setup: Setup, sigma: float) -> None:
        """`sigma` [m]: standard deviation of a range."""
        self.slam: ScanSlam | None = None  # from the first scan on, which tells what the scanner is
        self.pose: Array | None = None  # (3,), the newest, from then on
        self._newest: Array | None = None  # (B,) m, the scan from there
        self._parameters = LaserParameters(keyframe_distance=setup.keyframe_distance)
        self._sigma = sigma
        self._before: list[tuple[Increment | None, float]] = []  # frames until then
        self._time = 0.0

    def _take(self, frame: Frame, scan: Scan | None) -> Step | None:
        seconds = frame.time - self._time if frame.number else 0.0
        self._time = frame.time
        if self.slam is None:
            if scan is None:
                self._before.append((frame.increment, seconds))
                return None
            scanner, beams = scan.beams.scanner(self._sigma), scan.beams.number
            self.slam = ScanSlam(PRIOR, scanner, beams, self._parameters, with_covariance=True)
            for earlier, passed in self._before:
                self.slam.step(earlier, None, passed)
            self._before = []
        mean = self.slam.step(frame.increment, None if scan is None else scan.metres, seconds)
        self.pose, nothing = mean, len(frame.observations.z)
        self._newest = None if scan is None else scan.metres
        return Step(mean, self.slam.covariance, np.full(nothing, DISCARD), np.full(nothing, -1), np.nan)

    def map(self) -> MapState | None:
        """None: its map is a grid."""
        return None

    def scans(self) -> Scanned | None:
        """Poses (n, 3) and scans (n, B) [m] of the key poses and of the newest frame; None before the first scan."""
        if self.slam is None:
            return None
        poses, ranges = self.slam.poses, [self.slam.closer.ranges(k) for k in range(len(self.slam.poses))]
        if self._newest is not None and self.pose is not None:
            poses, ranges = np.vstack([poses, self.pose]), [*ranges, self._newest]
        return poses, np.array(ranges), self.slam.scanner

    def counted(self) -> str:
        """Its size in words."""
        return "" if self.slam is None else f"key poses {len(self.slam.frames)}"


EVERY = 5.0  # s of the robot's time from one grid to the next
SCANS = 200  # most key scans of it: 30 ms
RESOLUTION, MOST_CELLS = 0.05, 2_000_000  # m, 70 m a side
COLOUR, FREE = 112, 24  # grey of all cells, and opacity of free ones


class GridPainter:
    """Draws the page's occupancy grid anew every few seconds, of at most `SCANS` scans: a PNG of one colour, whose
    opacity is the probability of a wall, so it fits light and dark pages. Equal scans and poses: equal bytes.
    """

    def __init__(self, scans: Callable[[], Scanned | None], show: Callable[[bytes], None]) -> None:
        """`scans` gives the present ones or None, `show` gets grids in JSON: lower left corner, size [m], picture."""
        self._scans, self._show, self._drawn = scans, show, -EVERY

    def work(self, t: float, *, last: bool = False) -> None:
        """Draw where a grid is due at robot time t [s], or the `last` one."""
        found = self._scans() if last or t - self._drawn >= EVERY else None
        if found is None:
            return
        self._drawn = t
        poses, ranges, scanner = found
        some = slice(None, None, -(-len(poses) // SCANS))
        grid = occupancy_grid(poses[some], ranges[some], scanner, resolution=RESOLUTION, most_cells=MOST_CELLS)
        west, east, south, north = grid.extent
        place = {"west": west, "south": south, "wide": east - west, "high": north - south}
        self._show(json.dumps({**place, "png": base64.b64encode(picture(grid)).decode()}).encode())


def picture(grid: Grid) -> bytes:
    """A PNG of a grid, the northernmost row first."""
    p, file = grid.probability, io.BytesIO()
    opacity = np.where(grid.log_odds == 0.0, 0.0, FREE + (255 - FREE) * np.clip(2.0 * p - 1.0, 0.0, 1.0))
    alpha = np.round(opacity[::-1]).astype(np.uint8)
    Image.fromarray(np.dstack([np.full_like(alpha, COLOUR), alpha])).save(file, "PNG", compress_level=1)
    return file.getvalue()

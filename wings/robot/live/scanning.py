"""Graph SLAM by scan matching while the robot drives: the front end of laser logs, a frame at a time; its grid."""

import base64
import io
import json
from collections.abc import Callable

import numpy as np
from PIL import Image

from data.inputs import Frame, Increment, Scanner
from data.result import DISCARD, MapState
from data.se2 import Array
from eval.replay.settings import Setup
from wings.laser.scans.occupancy import Grid, occupancy_grid
from wings.laser.slam.incremental import ScanSlam
from wings.laser.slam.parameters import LaserParameters
from wings.robot.live.session import Online, Step
from wings.robot.log import prior
from wings.robot.packets import Scan

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
            self.slam = ScanSlam(prior(), scanner, beams, self._parameters, with_covariance=True)
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

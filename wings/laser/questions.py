"""Questions to the author of a laser log: units, missing odometry, and how the laser is mounted."""

import math
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import scipy

from data.inputs import Scans
from data.log import Log
from data.notice import Code, Notice, notice
from data.questions.readings import as_pose
from data.se2 import Array, between, dead_reckoned, inverse, transform_points
from wings.laser.scans.points import FEWEST_BEAMS, beams_of

K = TypeVar("K")
FEWEST = 20  # Least number of scans for a question


def no_odometry(log: Log, scans: Scans) -> list[Notice]:
    """Odometry that never moves and claims to be known, with a scanner whose view changes."""
    inputs = log.recorded  # unknown motion has the standard deviation of a speed
    exact = float(np.median(inputs.increments.covariance[1:, 0, 0])) < 1e-4
    if inputs.increments.mean.any() or not exact:
        return []
    ends = scans.ranges[:: max(len(scans.frame) // 50, 1)]
    changed = np.abs(np.diff(ends, axis=0)) > 0.1 * np.maximum(ends[1:], ends[:-1])
    seen = (ends[1:] > 0.0) | (ends[:-1] > 0.0)
    if not seen.any() or changed[seen].mean() < CHANGED:
        return []
    return [notice(Code.NO_ODOMETRY, scans=len(scans.frame), flags=("--no-odometry",))]


CHANGED = 0.1  # Least share of beams whose range changes by a tenth between distant scans of a robot that moves


STRIDE, SPEED = 3.0, 10.0  # m between two scans, m/s (90th percentiles of those that move) for another unit to be tried
SURELY = 20.0  # m between two scans, from which on no robot drives: its scans would not overlap
UNITS = {"cm": 0.01, "mm": 0.001}


def odometry_unit(log: Log, scans: Scans) -> list[Notice]:
    """Odometry that moves farther than a robot drives, where another unit makes scans overlap or nothing else could."""
    inputs = log.recorded
    at = _path(inputs.increments.mean, scans)
    step = np.hypot(*np.diff(at[:, :2], axis=0).T)
    moves = step > 0.0
    if not moves.any():
        return []
    seconds = float(np.median(np.diff(inputs.time[scans.frame]))) if not inputs.time_is_index else np.inf
    stride = float(np.quantile(step[moves], 0.9))
    if stride < STRIDE and stride < SPEED * seconds:
        return []
    more = dict[str, Array]()
    for unit, metres in UNITS.items():
        pairs = _pairs(at * [metres, metres, 1.0])[::3]
        if len(pairs) >= FEWEST // 4:
            as_stated = [(i, j, between(at[i], at[j])) for i, j, _ in pairs]
            more[unit] = _best_fits(scans, pairs) - _best_fits(scans, as_stated)
    best = _clearest(more)
    middle = float(np.median(step[moves]))
    if not best and stride < SURELY:
        return []
    best = best or ("mm" if middle > 50.0 else "cm")
    return [notice(Code.ODOMETRY_UNIT, stride=middle, unit=best, flags=(f"--odometry-unit {best}",))]


def _clearest(more: Mapping[K, Array]) -> K | None:
    """The key of the shares (n,) that are largest in the mean and clearly above 0; None: there is none."""
    sure = (k for k, m in more.items() if m.mean() > max(GAIN, CLEARLY * m.std(ddof=1) / math.sqrt(len(m))))
    return max(sure, key=lambda k: float(more[k].mean()), default=None)


def _best_fits(scans: Scans, pairs: list[tuple[int, int, Array]]) -> Array:
    """`_fits` by the mounting that fits best: it may be wrong, too."""
    fits = (_fits(scans, pairs, *way) for way in ((False, 0.0), *MOUNTINGS))
    return max(fits, key=lambda shares: float(shares.mean()))


def _path(increments: Array, scans: Scans) -> Array:
    """Poses (S, 3) of the scans by odometry alone."""
    return dead_reckoned(np.zeros(3), increments)[scans.frame]


NEAR = 0.1  # m within which two scans have a surface in common
FARTHEST = 12.0  # m of the points that are compared; farther ones lie too far apart
PAIRS = 60  # Most pairs of scans that are compared
MOVED, TURNED = (0.2, 1.0), (0.15, 0.8)
"""m and rad between the two scans of a pair: enough to tell mountings apart, little enough to overlap."""
WITHIN = 12  # Scans after the first, among which its partner is
CLEARLY, GAIN = 5.0, 0.1  # Standard errors, and least share of points, by which another mounting must fit better
MOUNTINGS = ((True, 0.0), (False, 180.0), (True, 180.0), (False, 90.0), (False, -90.0))
"""Whether beams run the other way, and by how many degrees the laser is turned."""


def mounting(log: Log, scans: Scans) -> list[Notice]:
    """A laser whose scans overlap clearly better if it is mounted in another way: by the true path where all of it is
    known, as the examination compares that with the odometry, else by odometry.
    """
    mean, true = log.recorded.increments.mean, log.truth.pose
    if not mean.any():
        return []
    known = true is not None and bool(np.isfinite(true[scans.frame]).all())
    pairs = _pairs(true[scans.frame] if true is not None and known else _path(mean, scans))
    if len(pairs) < FEWEST // 2:
        return []
    stated = _fits(scans, pairs)
    more = {way: _fits(scans, pairs, *way) - stated for way in MOUNTINGS}
    if (best := _clearest(more)) is None:
        return []
    (clockwise, turned), found = best, float(stated.mean())
    fits = found + float(more[best].mean())
    flags = ("--clockwise",) * clockwise + (f"--laser-turned {turned:g}",) * bool(turned)
    about = {"clockwise": clockwise, "alone": not known}
    if log.source.get("kind") == "table":
        s = scans.scanner.mounted(clockwise=clockwise, turned=math.radians(turned))
        beams = f"{math.degrees(s.angle_min) + 0.0:.6g}deg,{math.degrees(s.angle_step):.6g}deg,{s.max_range:.6g}m"
        place = as_pose(inverse(np.array([*s.translation, s.rotation])) + 0.0, "m")
        flags = (f"--scanner={beams}",) * clockwise + (f"--sensor-pose={place}",) * bool(turned)
    return [notice(Code.MOUNTING, turned=turned, stated=found, fits=fits, flags=flags, **about)]


def _pairs(pose: Array) -> list[tuple[int, int, Array]]:
    """Pairs of scans, and the odometry between them (3,), at odometry poses (S, 3): those that turn or move."""
    found: list[tuple[int, int, Array]] = []
    for kind in ("turned", "moved"):
        some: list[tuple[int, int, Array]] = []
        for i in range(0, len(pose) - 1, max(len(pose) // 2000, 1)):
            later = pose[i + 1 : i + 1 + WITHIN]
            relative = between(np.broadcast_to(pose[i], later.shape), later)
            moved, turned = np.hypot(relative[:, 0], relative[:, 1]), np.abs(relative[:, 2])
            turns = (turned > TURNED[0]) & (turned < TURNED[1]) & (moved < MOVED[1])
            moves = (moved > MOVED[0]) & (moved < MOVED[1]) & (turned < TURNED[0])
            fine = np.flatnonzero(turns if kind == "turned" else moves)
            if len(fine):
                j = int(fine[0])
                some.append((i, i + 1 + j, relative[j]))
        found += some[:: max(2 * len(some) // PAIRS, 1)][: PAIRS // 2]
    return found


def _fits(scans: Scans, pairs: list[tuple[int, int, Array]], clockwise: bool = False, turned: float = 0.0) -> Array:
    """Share of points of each pair's second scan on a surface of the first, by odometry, for another of `MOUNTINGS`."""
    scanner, ranges = scans.scanner.mounted(clockwise=clockwise, turned=math.radians(turned)), scans.ranges
    beams = beams_of(scanner, ranges.shape[1])

    def points(row: int) -> Array:
        r = ranges[row]
        seen = (r > 0.0) & (r < min(FARTHEST, scanner.max_range))
        return np.asarray(beams.origin + r[seen, None] * beams.direction[seen])

    shares = np.zeros(len(pairs))
    for k, (i, j, relative) in enumerate(pairs):
        first, second = points(i), points(j)
        if len(first) and len(second):
            moved = transform_points(relative, second)
            distance = np.asarray(scipy.spatial.cKDTree(first).query(moved, distance_upper_bound=NEAR)[0])
            shares[k] = float(np.mean(distance <= NEAR))
    return shares


FEW_RETURNS = 0.02  # Share of beams with a return below which nothing can be matched


def returns(_: Log, scans: Scans) -> list[Notice]:
    """Scans almost without returns: another unit, or a maximum that is too small."""
    share = float((scans.ranges > 0.0).mean())
    if 0 < (beams := int(scans.ranges.any(axis=0).sum())) < FEWEST_BEAMS:
        return [notice(Code.FEW_BEAMS, beams=beams, least=FEWEST_BEAMS)]
    return [] if share > FEW_RETURNS else [notice(Code.FEW_RETURNS, share=share, max_range=scans.scanner.max_range)]


CHECKS = (no_odometry, odometry_unit, returns, mounting)


def questions(log: Log) -> list[Notice]:
    """Questions about a laser log; none of another."""
    scans = log.recorded.scans
    if scans is None or len(scans.frame) < FEWEST:
        return []
    return [question for check in CHECKS for question in check(log, scans)]

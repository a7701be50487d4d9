"""Time of the laser front end against the number of scans: a town that is as large as the log is long.

`python -m tests.research.laser_time 1000 10000 40000 100000 [--profile]` prints, for each tenth of each log, the mean
processor time of a scan and that of the parts (`covariances` is part of `loops`); then that of all scans, and what the
profile says.

Streets 6 m wide run between blocks with notched fronts. The robot drives 1 m/s with 5 scans a second, and mostly turns
into the street that it has driven least, so that each is driven three times on average.
"""

from __future__ import annotations

import cProfile
import math
import pstats
import time
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from data.command import Parser
from data.log import Log
from data.se2 import Array
from tests.wings.laser.slam.field import BEAMS, SICK, recorded, through
from wings.laser.floorplan.world import scan_ranges
from wings.laser.poses.online import PoseGraph
from wings.laser.scans.uncertainty import PoseEdges
from wings.laser.slam import front_end
from wings.laser.slam.closures import LoopCloser
from wings.laser.slam.parameters import LaserParameters
from wings.laser.slam.tracker import Tracker

BLOCK, STREET = 20.0, 6.0  # m
PASSES = 3.0  # over each street, on average
STEP = 0.2  # m from scan to scan
AGAIN = 0.3  # probability that the next street is drawn from all
PARTS: dict[str, tuple[type, str]] = {
    "loops": (LoopCloser, "find"), "covariances": (PoseEdges, "project"), "graph": (PoseGraph, "update"),
    "poses": (PoseGraph, "poses"),
}  # fmt: skip


SCAN: tuple[type, str] = (Tracker, "correct")


def town(scans: int, seed: int = 0) -> Log:
    """A log of so many scans."""
    rng = np.random.default_rng(seed)
    pitch = BLOCK + STREET
    side = max(math.ceil(math.sqrt(STEP * scans / (2.0 * pitch * PASSES))), 2)
    blocks = {(i, j): _block(rng, pitch * i, pitch * j) for i in range(-1, side + 1) for j in range(-1, side + 1)}
    here, before, driven = (0, 0), (-1, 0), Counter[frozenset[tuple[int, int]]]()
    points = []
    while len(points) * pitch < STEP * scans + pitch:
        points.append(pitch * np.array(here) - 0.5 * STREET + rng.uniform(-0.3, 0.3, 2))
        ways = [(here[0] + i, here[1] + j) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        ways = [w for w in ways if min(w) >= 0 and max(w) <= side and w != before]
        times = [driven[frozenset((here, w))] for w in ways]
        some = ways if rng.random() < AGAIN else [w for w, t in zip(ways, times, strict=True) if t == min(times)]
        before, here = here, some[int(rng.integers(len(some)))]
        driven[frozenset((before, here))] += 1
    path = through(points, scans, step=STEP)
    ranges = []
    for part in np.array_split(path, max(len(path) // 50, 1)):
        i, j = np.floor(part[0, :2] / pitch).astype(int).tolist()
        near = [blocks[a, b] for a in range(i - 2, i + 3) for b in range(j - 2, j + 3) if (a, b) in blocks]
        ranges.append(scan_ranges(part, SICK, BEAMS, np.concatenate(near)))
    return recorded(path, np.zeros((0, 4)), rng, exact_ranges=np.concatenate(ranges))


def _block(rng: np.random.Generator, x: float, y: float) -> Array:
    """Walls (W, 4) of a block with its corner at x, y: fronts of 2 to 6 m, each up to 1.5 m behind the street."""
    corner = np.array([[0.0, 0.0], [BLOCK, 0.0], [BLOCK, BLOCK], [0.0, BLOCK]])
    outline = []
    for k in range(4):
        along = (corner[(k + 1) % 4] - corner[k]) / BLOCK
        inward = np.array([-along[1], along[0]])
        ends = np.cumsum(rng.uniform(2.0, 6.0, 10))
        ends = np.concatenate([[1.5], 1.5 + ends[1.5 + ends < BLOCK - 3.5], [BLOCK - 1.5]])
        for low, high in pairwise(ends.tolist()):
            back = inward * rng.uniform(0.0, 1.5)
            outline += [corner[k] + along * low + back, corner[k] + along * high + back]
    points = np.array(outline) + [x, y]
    return np.concatenate([points, np.roll(points, -1, axis=0)], axis=1)


def main() -> None:
    """Print the curve of one run as it goes."""
    p = Parser(prog="python -m tests.research.laser_time", description="Time of the laser front end.")
    p.add_argument("scans", type=int, nargs="+", help="of each log")
    p.add_argument("--profile", action="store_true")
    args = p.parse_args()
    front_end.run_front_end(town(1000).recorded, LaserParameters())  # compiles the kernels
    spent = dict.fromkeys(PARTS, 0.0)
    for part, (kind, name) in PARTS.items():
        setattr(kind, name, _timed(getattr(kind, name), spent, part))
    kind, name = SCAN
    plain = getattr(kind, name)
    for scans in args.scans:
        log = town(scans)
        print("scans, processor ms a scan:", ", ".join(("all", *PARTS)), flush=True)
        setattr(kind, name, _counted(plain, spent, max(scans // 10, 1)))
        _run(log, profile=args.profile)


def _run(log: Log, *, profile: bool) -> None:
    """Run and time the front end."""
    assert log.truth.pose is not None
    watched, began = cProfile.Profile(), time.process_time()
    if profile:
        watched.enable()
    found = front_end.run_front_end(log.recorded, LaserParameters())
    watched.disable()
    each = 1e3 * (time.process_time() - began) / len(log.recorded)
    off = found.online[found.chain.frame] - log.truth.pose[found.chain.frame]
    print(f"{len(log.recorded)} scans: {each:.2f} ms each, {len(off)} key poses, ", end="")
    print(f"{(found.loops.believed >= 0).sum()} of {len(found.loops)} loop closures believed, ", end="")
    print(f"{np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()):.3f} m RMSE of the online path", flush=True)
    if profile:
        pstats.Stats(watched).sort_stats("tottime").print_stats(25)


def _timed(plain: Callable[..., Any], spent: dict[str, float], part: str) -> Callable[..., Any]:
    def timed(*args: Any, **given: Any) -> Any:
        began = time.process_time()
        try:
            return plain(*args, **given)
        finally:
            spent[part] += time.process_time() - began

    return timed


def _counted(plain: Callable[..., Any], spent: dict[str, float], every: int) -> Callable[..., Any]:
    """The function, which prints a row and starts `spent` anew after each so many calls."""
    calls, began = 0, time.process_time()

    def counted(*args: Any, **given: Any) -> Any:
        nonlocal calls, began
        result = plain(*args, **given)
        calls += 1
        if calls % every == 0:
            now = time.process_time()
            print(calls, *(f"{1e3 * s / every:.2f}" for s in (now - began, *spent.values())), flush=True)
            began = now
            spent.update(dict.fromkeys(spent, 0.0))
        return result

    return counted


if __name__ == "__main__":
    main()

"""Key poses that leave while a robot drives: their number, the error of the online poses, NEES, and time on line.

`python -m tests.research.live_lidar SECONDS ROOM [ROOM ...]` drives along the walls of the simulator's rooms with a
lidar. For each room and share of `--least-information` it prints the key poses in the graph after each quarter, of how
many; the RMSE of the position; the mean NEES of the second half (expected 3); and the processor time of a frame.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from data.command import Parser
from data.inputs import Inputs
from data.se2 import Array, between, wrap_angle
from eval.replay.settings import Setup
from wings.laser.slam.incremental import ScanSlam
from wings.laser.slam.parameters import LaserParameters
from wings.robot.driving import WallFollower
from wings.robot.live.scanning import rehearse_scans
from wings.robot.log import Framing, inputs_of, scans_of
from wings.robot.simulated.physics import Lidar, drive
from wings.robot.simulated.room import room

SHARES = (None, 0.05, 0.1, 0.2)


class Driven(NamedTuple):
    """A front end over a log, frame by frame."""

    pose: Array  # (N, 3) online
    nees: Array  # (N,)
    size: Array  # (N,) key poses in the graph
    keys: int  # that were made
    seconds: Array  # (N,) of processor time


def log_of(place: int, seconds: float) -> tuple[Inputs, Array]:
    """The inputs of a drive, and its true poses (N, 3)."""
    walls, lidar = room(place), Lidar()
    driven = drive(walls, WallFollower(), seconds, np.random.default_rng(100 + place), lidar=lidar)
    framing = Framing()
    frames = [framing.frame(packet) for packet in driven.packets]
    scans = scans_of(driven.packets, lidar.sigma)
    return inputs_of(frames, framing.at_rest, scans=scans), between(walls.start, driven.poses)


def on_line(inputs: Inputs, truth: Array, least: float | None) -> Driven:
    """Graph SLAM by scan matching, as `slamref live` has it."""
    assert inputs.scans is not None
    scans, count = inputs.scans, len(inputs)
    slam = ScanSlam(
        inputs.prior, scans.scanner, scans.ranges.shape[1], LaserParameters(), least=least, with_covariance=True
    )
    pose, nees, size, seconds = np.zeros((count, 3)), np.full(count, np.nan), np.zeros(count), np.zeros(count)
    step = np.diff(inputs.time, prepend=inputs.time[0])
    for k in range(count):
        began = time.thread_time()
        pose[k] = slam.step(inputs.increment(k) if k else None, scans.of(k), float(step[k]))
        covariance = slam.covariance
        seconds[k], size[k] = time.thread_time() - began, slam.size
        if k:
            error = pose[k] - truth[k]
            error[2] = wrap_angle(float(error[2]))
            nees[k] = error @ np.linalg.solve(covariance, error)
    return Driven(pose, nees, size, len(slam.frames), seconds)


def main() -> None:
    """Print a line for each room and share, and one for each share over all rooms."""
    p = Parser(prog="python -m tests.research.live_lidar", description="Key poses that leave while a robot drives.")
    p.add_argument("seconds", type=float, help="of each drive")
    p.add_argument("rooms", type=int, nargs="+", help="of walls:ROOM")
    args = p.parse_args()
    rehearse_scans(Setup(least_information=0.1), 0.01)
    total: dict[float | None, list[tuple[float, float, float, float]]] = {}
    for place in args.rooms:
        inputs, truth = log_of(place, args.seconds)
        for least in SHARES:
            found = on_line(inputs, truth, least)
            error = np.hypot(*(found.pose - truth)[:, :2].T)
            half, ms = len(error) // 2, 1e3 * found.seconds
            at = found.size[[half // 2, half, half + half // 2, -1]].astype(int).tolist()
            row = (float((error**2).mean()), float(found.nees[half:].mean()), float(found.size[-1]), float(ms.max()))
            total.setdefault(least, []).append(row)
            times = f"{np.median(ms):.2f} {np.quantile(ms, 0.99):.1f} {ms.max():.1f}"
            print(
                f"room {place}, share {least}: key poses {at} of {found.keys}, RMSE {1e3 * np.sqrt(row[0]):.1f} mm, "
                f"NEES {row[1]:.2f}, ms (median, 99 %, longest) {times}",
                flush=True,
            )
    for least, rows in total.items():
        square, nees, size, longest = np.array(rows).T
        print(
            f"share {least}: key poses {size.mean():.0f}, RMSE {1e3 * np.sqrt(square.mean()):.1f} mm, "
            f"NEES {nees.mean():.2f}, longest {longest.max():.1f} ms"
        )


if __name__ == "__main__":
    main()

"""`python -m tests.research.exploring FLOOR ...`: `Explorer` in the buildings floorplan:FLOOR, at most 4000 s each."""

import sys
import time

import numpy as np

from tests.wings.robot.test_exploring import explored
from wings.robot.packets import SONARS, TIMEOUT_MM
from wings.robot.simulated.physics import Robot
from wings.robot.simulated.room import floor_of


class Deaf(Robot):
    """Its sonars hear nothing, which saves time: the lidar sees what they would hear."""

    def _distances(self):
        return [TIMEOUT_MM] * len(SONARS)


def progress(k, robot):
    """A line for every 1200 packets, on the error stream."""
    if k % 1200 == 0:
        print(k, np.round(robot.pose, 2), f"{time.process_time():.0f} s", file=sys.stderr, flush=True)


if __name__ == "__main__":
    print("| building | ended | mapped of what is reachable | driven [s] |\n|---|---|---:|---:|")
    for number in map(int, sys.argv[1:]):
        finished, share, seconds = explored(floor_of(number), 4000.0, Deaf, progress)
        ended = "yes" if finished else "no"
        print(f"| `floorplan:{number}` | {ended} | {100 * share:.1f} % | {seconds:.0f} |", flush=True)

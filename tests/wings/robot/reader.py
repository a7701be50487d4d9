"""Drives the robot, records, and says how many records are kept; it is there to be killed.

python -m tests.wings.robot.reader DEVICE LOG
"""

import os
import sys
from pathlib import Path

from wings.robot.link import Clock, Link
from wings.robot.packets import command_of
from wings.robot.traffic import Recording


class Telling(Recording):
    """Says after every record that it was kept."""

    kept = 0

    def append(self, record):
        super().append(record)
        self.kept += 1
        os.write(1, f"{self.kept}\n".encode())


if __name__ == "__main__":
    recording = Telling(Path(sys.argv[2]))
    link = Link(sys.argv[1], Clock(), recording)
    while True:
        link.step(command_of(0.25, 0.7))

"""A ROS bag of a laser robot as an open log: LaserScan and Odometry, ROS 1 (.bag) and 2 (folder, .mcap, .db3).

Needs `rosbags` (pip install 'slamref[ros]').
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data.convert.parsers import Add
    from data.log import Log

KINDS = ("rosbag",)
EXAMPLES = """\
examples:
  python -m data.convert rosbag robot.bag logs/robot                              one topic of each kind: it is found
  python -m data.convert rosbag robot_mcap/ logs/robot --scan /front/scan --odom /odom
"""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `rosbag`; `parameters` is unused."""
    sub = add(
        "rosbag",
        help="a ROS 1 or 2 bag with laser scans and odometry",
        description="LaserScan and Odometry messages of a bag: every scan is a frame, the odometry is interpolated.",
        epilog=EXAMPLES,
    )
    sub.add_argument("source", metavar="BAG", type=Path, help="a .bag file, a folder of ROS 2, or its .mcap or .db3")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--scan", metavar="TOPIC", help="of the scans (default: the only one)")
    sub.add_argument("--odom", metavar="TOPIC", help="of the odometry (default: the only one)")


def convert(args: argparse.Namespace) -> Log:
    """The log of the bag."""
    from data.formats.recordings.ros import log_of, read_bag

    return log_of(args.source, read_bag(args.source, args.scan, args.odom))

"""Recordings with few flags as open logs: CARMEN, ROS bags (with `rosbags`), Victoria Park, Plaza."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data.command import Add
    from data.formats.recordings.mending import Mending
    from data.log import Log

KINDS = ("victoria-park", "plaza", "carmen", "rosbag")
PLAZA = """\
examples:
  python -m data.convert plaza 1 logs/plaza-1
  python -m data.convert plaza 2 logs/plaza-2-raw --range-scale 1 --range-sigma 3
"""
CARMEN = """\
examples:
  python -m data.convert carmen intel.log.gz logs/intel                       relations: intel.relations.csv beside it
  python -m data.convert carmen intel.log.gz logs/intel --relations my_relations.csv
  python -m data.convert carmen intel.gfs.log logs/intel-raw --undo-correction
"""
ROSBAG = """\
examples:
  python -m data.convert rosbag robot.bag logs/robot                              one topic of each kind: it is found
  python -m data.convert rosbag robot_mcap/ logs/robot --scan /front/scan --odom /odom
"""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parsers of all kinds; `parameters` is unused."""
    park = add(
        "victoria-park",
        help="the Victoria Park log that gtsam bundles",
        description="Victoria Park: 6969 frames of a car among trees, from the installed gtsam wheel. No ground truth.",
        epilog="example:\n  python -m data.convert victoria-park logs/victoria",
    )
    plaza = add(
        "plaza",
        help="a Plaza range-only log that gtsam bundles",
        description="Ranges to four radio beacons at known places, wheel odometry with a gyro, and RTK GPS as ground "
        "truth, from the installed gtsam wheel.",
        epilog=PLAZA,
    )
    plaza.add_argument("set", metavar="SET", type=int, choices=(1, 2), help="1 or 2")
    text = "ranges are divided by it (default: 1.07, which the ground truth of both sets tells)"
    plaza.add_argument("--range-scale", metavar="S", type=float, default=1.07, help=text)
    plaza.add_argument("--range-sigma", metavar="M", type=float, default=0.5, help="noise of a range (default: 0.5)")
    carmen = add(
        "carmen",
        help="a CARMEN log with laser scans (.log, .clf, also .gz, .bz2)",
        description="Odometry and laser scans of a CARMEN log, with reference relations where there are some.",
        epilog=CARMEN,
    )
    carmen.add_argument("source", metavar="SOURCE", type=Path, help="log file: ODOM, FLASER or ROBOTLASER1 lines")
    rosbag = add(
        "rosbag",
        help="a ROS 1 or 2 bag with laser scans and odometry",
        description="LaserScan and Odometry messages of a bag: every scan is a frame, the odometry is interpolated.",
        epilog=ROSBAG,
    )
    rosbag.add_argument("source", metavar="BAG", type=Path, help="a .bag file, a folder of ROS 2, or its .mcap or .db3")
    for each in (park, plaza, carmen, rosbag):
        each.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    text = "poses are a particle filter's: recover the raw odometry"
    carmen.add_argument("--undo-correction", action="store_true", help=text)
    text = "reference relations by frame (default: NAME.relations.csv beside the log)"
    carmen.add_argument("--relations", metavar="FILE", type=Path, help=text)
    text = "angle=deg: headings of the odometry; time=ms, us or ns: stamps (default: rad and s)"
    carmen.add_argument("--unit", metavar="KEY=UNIT", type=_units, default={}, help=text)
    rosbag.add_argument("--scan", metavar="TOPIC", help="of the scans (default: the only one)")
    rosbag.add_argument("--odom", metavar="TOPIC", help="of the odometry (default: the only one)")
    _add_mending(carmen)
    _add_mending(rosbag)


def _add_mending(parser: argparse.ArgumentParser) -> None:
    """The flags of `data.formats.recordings.mending.Mending`."""
    units = ("m", "cm", "mm")
    parser.add_argument("--range-unit", choices=units, default="m", help="unit of the ranges (default: m)")
    parser.add_argument("--odometry-unit", choices=units, default="m", help="unit of the odometry (default: m)")
    parser.add_argument("--clockwise", action="store_true", help="beams run clockwise, or the laser is upside down")
    parser.add_argument("--laser-turned", metavar="DEG", type=float, default=0.0, help="laser's heading on the robot")
    parser.add_argument("--beam-step", metavar="DEG", type=float, help="angle between beams (default: as stated)")
    parser.add_argument("--max-range", metavar="M", type=float, help="longer readings are no return")
    parser.add_argument("--sort-stamps", action="store_true", help="in the order of the stamps, not of the file")
    parser.add_argument("--no-odometry", action="store_true", help="odometry is unknown: scans alone tell the motion")


def _units(text: str) -> dict[str, str]:
    """Units of `angle` and `time`."""
    from data.formats.recordings.mending import RADIANS, SECONDS

    known = {"angle": RADIANS, "time": SECONDS}
    found = dict(pair.strip().partition("=")[::2] for pair in text.split(","))
    for key, unit in found.items():
        if unit not in known.get(key, {}):
            right = f"{', '.join(known[key])}" if key in known else f"of {', '.join(known)}"
            raise argparse.ArgumentTypeError(f"{key}={unit} is unknown; {right} is needed, as in angle=deg,time=ms")
    return found


def _mending(args: argparse.Namespace) -> Mending:
    """The mending that the flags ask for."""
    from data.formats.recordings.mending import Mending

    return Mending(
        args.range_unit, args.odometry_unit, clockwise=args.clockwise, laser_turned=args.laser_turned,
        beam_step=args.beam_step, max_range=args.max_range, sort_stamps=args.sort_stamps,
        odometry=not args.no_odometry, **getattr(args, "unit", {}),
    )  # fmt: skip


def convert(args: argparse.Namespace) -> Log:
    """The log of the recording."""
    if args.kind == "victoria-park":
        from data.formats.recordings.victoria_park import load_victoria_park

        return load_victoria_park()
    if args.kind == "plaza":
        from data.errors import UsageError
        from data.formats.recordings.plaza import load_plaza

        for flag, value in (("--range-scale", args.range_scale), ("--range-sigma", args.range_sigma)):
            if not 0.0 < value < 1e3:
                raise UsageError(f"{flag} {value:g}: a number above 0 is needed")
        return load_plaza(args.set, args.range_scale, args.range_sigma)
    if args.kind == "carmen":
        from data.formats.recordings.carmen import load_carmen

        return load_carmen(args.source, args.relations, undo_correction=args.undo_correction, mending=_mending(args))
    from data.formats.recordings.ros import log_of, read_bag

    return log_of(args.source, read_bag(args.source, args.scan, args.odom, alone=args.no_odometry), _mending(args))

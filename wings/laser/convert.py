"""Laser logs as open logs: CARMEN logs, ROS bags (with `rosbags`), and key poses by scan matching."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from data.convert import TEXTS, said_of

if TYPE_CHECKING:
    from data.command import Add
    from data.formats.recordings.mending import Mending
    from data.log import Log

KINDS = ("carmen", "rosbag", "laser")
MOTIONS = ("scan-match", "odometry")
PARTS = ("loops", "corners")


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parsers of all kinds; `parameters` is unused."""
    says = TEXTS["laser"]["says"]
    carmen, rosbag, sub = (add(kind, **said_of(kind)) for kind in KINDS)
    carmen.add_argument("source", metavar="SOURCE", type=Path, help="lines ODOM, FLASER or ROBOTLASER1, or O, L")
    rosbag.add_argument("source", metavar="BAG", type=Path, help="a .bag file, a folder of ROS 2, or its .mcap or .db3")
    for each in (carmen, rosbag):
        each.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    carmen.add_argument("--undo-correction", action="store_true", help=says["carmen-undo-correction"])
    carmen.add_argument("--relations", metavar="FILE", type=Path, help=says["carmen-relations"])
    carmen.add_argument("--unit", metavar="KEY=UNIT", type=_units, default={}, help=says["carmen-unit"])
    rosbag.add_argument("--scan", metavar="TOPIC", help="of the scans (default: the only one)")
    rosbag.add_argument("--odom", metavar="TOPIC", help="of the odometry (default: the only one)")
    _add_mending(carmen)
    _add_mending(rosbag)
    sub.add_argument("source", metavar="LOG", help="a laser log by path or name (CARMEN, open log folder, floorplan:0)")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--motion", choices=MOTIONS, default=MOTIONS[0], help=f"of key poses (default: {MOTIONS[0]})")
    sub.add_argument(
        "--leave-out", metavar="PART", choices=PARTS, action="append", default=[], help=says["sub-leave-out"]
    )
    sub.add_argument("--keyframe-distance", metavar="M", type=float, default=0.4, help=says["sub-keyframe-distance"])
    sub.add_argument("--relations", metavar="FILE", type=Path, help=says["sub-relations"])
    sub.add_argument("--no-odometry", action="store_true", help="odometry is unknown: scans alone tell the motion")


def _add_mending(parser: argparse.ArgumentParser) -> None:
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
    from data.formats.recordings.mending import RADIANS, SECONDS

    known = {"angle": RADIANS, "time": SECONDS}
    found = dict(pair.strip().partition("=")[::2] for pair in text.split(","))
    for key, unit in found.items():
        if unit not in known.get(key, {}):
            right = f"{', '.join(known[key])}" if key in known else f"of {', '.join(known)}"
            raise argparse.ArgumentTypeError(f"{key}={unit} is unknown; {right} is needed, as in angle=deg,time=ms")
    return found


def _mending(args: argparse.Namespace) -> Mending:
    from data.formats.recordings.mending import Mending

    return Mending(
        args.range_unit, args.odometry_unit, clockwise=args.clockwise, laser_turned=args.laser_turned,
        beam_step=args.beam_step, max_range=args.max_range, sort_stamps=args.sort_stamps,
        odometry=not args.no_odometry, **getattr(args, "unit", {}),
    )  # fmt: skip


def convert(args: argparse.Namespace) -> Log:
    """The log of a recording, or of key poses."""
    if args.kind == "carmen":
        from wings.laser.carmen import load_carmen

        return load_carmen(args.source, args.relations, undo_correction=args.undo_correction, mending=_mending(args))
    if args.kind == "rosbag":
        from data.formats.bags import laser_log

        return laser_log(args.source, args.scan, args.odom, _mending(args))
    return _key_poses(args)


def _key_poses(args: argparse.Namespace) -> Log:
    """The log of key poses. UsageError for a log without scans, or where nothing would be left."""
    from data.errors import UsageError
    from data.logs import Reading, open_log
    from eval.plan.warming import compile_if_needed
    from eval.replay.settings import Setup
    from wings.laser.key_poses import frames_of_relations, log_of_keys
    from wings.laser.slam.front_end import is_unknown
    from wings.laser.slam.key_log import key_log

    if not 0.0 < args.keyframe_distance < 1e3:
        raise UsageError(f"--keyframe-distance {args.keyframe_distance:g}: a number above 0 is needed")
    if args.motion == MOTIONS[0] and set(args.leave_out) == set(PARTS):
        raise UsageError(f"--leave-out {' --leave-out '.join(PARTS)}: nothing beside the motion is left")
    log = open_log(args.source, Reading(relations=args.relations, no_odometry=args.no_odometry))
    if log.recorded.scans is None:
        raise UsageError(f"{args.source}: no laser scans; a log with scans is needed")
    if args.motion == "odometry" and is_unknown(log.recorded.increments):
        raise UsageError(f"--motion odometry: {log.name} has none; --motion scan-match is needed")
    compile_if_needed()
    made = key_log(
        log.recorded, Setup(keyframe_distance=args.keyframe_distance), motion=args.motion,
        also=frames_of_relations(log) if args.motion == "odometry" else None,
        loops="loops" not in args.leave_out, corners="corners" not in args.leave_out,
    )  # fmt: skip
    return log_of_keys(args.out.absolute().name, log, made, args.motion)

"""Laser logs as open logs: CARMEN logs, ROS bags (with `rosbags`), and key poses by scan matching.

Key poses of a laser log as an open log, with its truth: reference relations, true poses, and true inliers.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data.inputs import IntArray
from data.log import Log
from data.origin import Origin
from data.pose_measurements import Closures
from data.se2 import Array, compose, covariances_in_world, inverse
from data.terminal import counted
from data.truth import Relations, Truth
from wings.laser.scans.constraints import Chain
from wings.laser.score import right_relatives
from wings.laser.slam.front_end import is_unknown
from wings.laser.slam.key_log import ODOMETRY, SCAN_MATCH, KeyLog


def log_of_keys(name: str, log: Log, made: KeyLog, motion: str) -> Log:
    """The log of key poses under a name, with the truth that the laser log has."""
    inputs, truth = made.inputs, log.truth
    pose = None if truth.pose is None else truth.pose[made.frame]
    relations = None if truth.relations is None else relations_of(truth.relations, made)
    inlier = None if inputs.closures is None or pose is None else true_inliers(inputs.closures, pose)
    keys, of = counted(len(made.chain.frame), "key pose"), counted(len(log.recorded), "frame")
    more = len(made.frame) - len(made.chain.frame)
    beside = f", and {more} more that relations name" if more else ""
    learned = made.error is not None
    scale = f"{made.claimed:.3g} times what scan matching states, " + (
        f"learned from the log's own loops (+- {made.error:.1g}): their NIS is no test of it"
        if learned
        else "as too few loops tell it"
    )
    prior = "by scans alone" if is_unknown(log.recorded.increments) else "with the wheels as its prior"
    moved = f"scan matching, {prior}" if motion == SCAN_MATCH else "that of the wheels"
    notes = [
        f"{keys} of {of}{beside}; the motion is {moved}.",
        f"Variances of scan matches and loops are {scale}.",
        "A closure is there at its later frame, some key poses before the front end believed it.",
    ]
    if motion == ODOMETRY:
        notes.append("Where wheels slip, filters' gate refuses right matches; --gate-poses none switches it off.")
    label = made.label if len(made.label) else None
    if label is not None:
        notes.append("Labels of corners are by the front end's final path; --association jcbb decides without them.")
    if relations is not None and truth.relations is not None and len(relations) < len(truth.relations):
        notes.append(f"{len(relations)} of {len(truth.relations)} relations join two key poses, and are carried there.")
    source = {**log.source, "laser": log.name, "motion": motion, "variance_scale": made.claimed}
    return Log(
        name, inputs, Truth(pose, relations=relations, closure_inlier=inlier), label=label,
        labels_are_sensed=label is not None, source=source, notes=(*log.notes, *notes),
        origins={**log.origins, "closure_noise": Origin.INFERRED if learned else Origin.ASSUMED},
    )  # fmt: skip


def frames_of_relations(log: Log) -> IntArray | None:
    """The frames that reference relations name, ascending; None without relations."""
    r = log.truth.relations
    return None if r is None else np.union1d(r.row1, r.row2)


def true_inliers(closures: Closures, truth: Array) -> IntArray:
    """Which closures (C,) are right, given true poses (F, 3); -1: one of them is unknown."""
    first, second = truth[closures.frame1], truth[closures.frame2]
    right = right_relatives(closures.relative, closures.covariance, first, second)
    known = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    return np.where(known, right, -1).astype(np.int64)


def relations_of(relations: Relations, made: KeyLog) -> Relations:
    """The relations between frames of the log, as they are where it has both; else all of them between key poses."""
    rows = [np.searchsorted(made.frame, r) for r in (relations.row1, relations.row2)]
    there = [(row < len(made.frame)) & (made.frame[np.minimum(row, len(made.frame) - 1)] == r)
             for row, r in zip(rows, (relations.row1, relations.row2), strict=True)]  # fmt: skip
    if (there[0] & there[1]).all():
        return replace(relations, row1=rows[0], row2=rows[1], stamp=None, frame_stamp=None)
    return relations_at_keys(relations, made.chain)


def relations_at_keys(relations: Relations, chain: Chain) -> Relations:
    """Relations between frames as relations between their key poses, by the scan match that places each frame.

    The error of that match is in them, as it is in the path of a laser run. Those within one key pose are left out,
    and stamps: of frames.
    """
    key1, key2 = chain.key[relations.row1], chain.key[relations.row2]
    there = np.flatnonzero(key1 != key2)
    before, after = chain.since[relations.row1[there]], inverse(chain.since[relations.row2[there]])
    to = compose(before, relations.relative[there])
    relative, covariance = compose(to, after), None
    if relations.covariance is not None:
        F = np.tile(np.eye(3), (len(there), 1, 1))
        F[:, 0, 2], F[:, 1, 2] = to[:, 1] - relative[:, 1], relative[:, 0] - to[:, 0]
        covariance = F @ covariances_in_world(before[:, 2], relations.covariance[there]) @ F.transpose(0, 2, 1)
    exact = None if relations.exact is None else relations.exact[there]
    return Relations(key1[there], key2[there], relative, exact, covariance=covariance)


if TYPE_CHECKING:
    from data.command import Add
    from data.formats.recordings.mending import Mending
    from data.log import Log

KINDS = ("carmen", "rosbag", "laser")
MOTIONS = ("scan-match", "odometry")
PARTS = ("loops", "corners")
KEY_POSES = """\
Key poses of a laser log as frames of a log without scans, which every estimator replays:
  motion        scan-match (default): scan matching from key pose to key pose, with the wheels as its prior
                odometry: the wheels; each scan matched to those of key poses before is a closure, source scan-match
  closures.csv  loops that the front end believes, source loop
  observations  corners of walls in the scans of key poses, labelled by the front end's final path
  relations.csv reference relations of the laser log, whose frames are frames, too, with --motion odometry; else
                each end is carried to its key pose by the front end's own match
A pair of scans is never motion and closure at once, and wheels count once. Scans of neighbouring matches overlap, and
corners come from scans that are matched as well: their errors are taken as independent.
"""
LASER = """\
examples:
  python -m data.convert laser intel.log.gz logs/intel-keys
  python -m data.convert laser floorplan:0 logs/plan --motion odometry --leave-out corners
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
    for each in (carmen, rosbag):
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
    sub = add("laser", help="key poses, loops and corners of a laser log", description=KEY_POSES, epilog=LASER)
    sub.add_argument("source", metavar="LOG", help="a laser log by path or name (CARMEN, open log folder, floorplan:0)")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--motion", choices=MOTIONS, default=MOTIONS[0], help=f"of key poses (default: {MOTIONS[0]})")
    text = "a part that the log has not; repeatable"
    sub.add_argument("--leave-out", metavar="PART", choices=PARTS, action="append", default=[], help=text)
    text = "a key pose every M metres (default: 0.4)"
    sub.add_argument("--keyframe-distance", metavar="M", type=float, default=0.4, help=text)
    text = "reference relations by frame (default: NAME.relations.csv beside the log)"
    sub.add_argument("--relations", metavar="FILE", type=Path, help=text)
    sub.add_argument("--no-odometry", action="store_true", help="odometry is unknown: scans alone tell the motion")


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

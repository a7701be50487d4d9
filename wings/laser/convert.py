"""Laser logs as open logs: CARMEN logs, ROS bags (with `rosbags`), and key poses by scan matching."""

from __future__ import annotations

from typing import TYPE_CHECKING

from data.command import declare
from data.convert import TEXTS, parser_of

if TYPE_CHECKING:
    import argparse

    from data.command import Add
    from data.formats.recordings.mending import Mending
    from data.log import Log

KINDS = ("carmen", "rosbag", "laser")


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parsers of all kinds; `parameters` is unused."""
    for kind in KINDS:
        sub = parser_of(add, kind)
        if kind != "laser":
            declare(sub, TEXTS["mending"]["arguments"])


def _mending(args: argparse.Namespace) -> Mending:
    from data.formats.recordings.mending import Mending

    return Mending(
        args.range_unit, args.odometry_unit, clockwise=args.clockwise, laser_turned=args.laser_turned,
        beam_step=args.beam_step, max_range=args.max_range, sort_stamps=args.sort_stamps,
        odometry=not args.no_odometry, **(getattr(args, "unit", None) or {}),
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
    from wings.laser.slam.key_log import ODOMETRY, SCAN_MATCH, key_log

    loops, corners = ("loops" not in args.leave_out, "corners" not in args.leave_out)
    if args.motion == SCAN_MATCH and not (loops or corners):
        raise UsageError("--leave-out loops --leave-out corners: nothing beside the motion is left")
    log = open_log(args.source, Reading(relations=args.relations, no_odometry=args.no_odometry))
    if log.recorded.scans is None:
        raise UsageError(f"{args.source}: no laser scans; a log with scans is needed")
    if args.motion == ODOMETRY and is_unknown(log.recorded.increments):
        raise UsageError(f"--motion odometry: {log.name} has none; --motion scan-match is needed")
    compile_if_needed()
    made = key_log(
        log.recorded, Setup(keyframe_distance=args.keyframe_distance), motion=args.motion, loops=loops, corners=corners,
        also=frames_of_relations(log) if args.motion == ODOMETRY else None,
    )  # fmt: skip
    return log_of_keys(args.out.absolute().name, log, made, args.motion)

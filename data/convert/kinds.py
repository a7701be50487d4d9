"""The kinds of `convert` but for those of wings: files of other programs, and logs that have a name.

UTIAS MRCLAM datasets with flags for calibration and noise, ROS bags (with `rosbags`), CSV files of another program as
in `--columns t=stamp,v=speed --unit angle=deg,time=ns`, g2o graphs in the plane and logs and runs as such graphs,
simulated worlds with a flag for every parameter, and what gtsam bundles.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from data.command import declare
from data.convert import TEXTS, parser_of
from data.errors import DataError, UsageError, unknown
from data.worlds.registry import SIMULATORS, add_flags, parameters_of, simulate

if TYPE_CHECKING:
    from data.command import Add
    from data.formats.open_log import Recording
    from data.log import Log
    from data.motion.velocity import VelocityModel

CALIBRATION = tuple(flag[2:].replace("-", "_") for flag in TEXTS["mrclam"]["calibration"])
"""Fields of `data.formats.mrclam.Calibration` with a flag."""


def _mrclam(args: argparse.Namespace) -> Log:
    """The log of the robot asked for; corrected landmarks beside the dataset are taken unless others are given."""
    from data.formats.mrclam import FROZEN, Calibration, Treatment, corrected_landmarks, load_mrclam

    changes = {name: value for name in CALIBRATION if (value := getattr(args, name)) is not None}
    both = [name for name in changes if name.startswith("sigma_")]
    if args.sigma is not None and both:
        raise UsageError(f"--sigma and --{both[0].replace('_', '-')} contradict each other; give one of them")
    calibration = replace(Calibration() if args.uncalibrated else FROZEN, **changes)
    if args.sigma is not None:
        calibration = calibration.with_sigma(*args.sigma)
    calibration = replace(calibration, motion=_motion(args, calibration.motion))
    found = corrected_landmarks(args.source) if args.landmarks is None else None
    window = (args.start, args.stop, args.landmarks or found, args.exclude_truth)
    log = load_mrclam(args.source, args.robot, Treatment(*window, args.grid, calibration, tuple(args.prior_sigma)))
    if found is None:
        return log
    said = f"Landmarks are read from {found.name} beside the dataset; --landmarks names another file."
    return replace(log, notes=(*log.notes, said))


def _motion(args: argparse.Namespace, default: VelocityModel) -> VelocityModel:
    """The motion model with the flags' changes; a new noise convention needs its own numbers."""
    from data.motion.velocity import WITH_ALPHAS, VelocityModel, VelocityNoise

    kind = args.motion_noise or default.noise.kind
    if args.motion_noise is None and args.motion_alphas is not None:
        kind = "displacement"
    wanted, other = ("motion_alphas", "motion_sigma") if kind in WITH_ALPHAS else ("motion_sigma", "motion_alphas")
    numbers = getattr(args, wanted)
    flag = f"--{wanted.replace('_', '-')}"
    if getattr(args, other) is not None:
        raise UsageError(f"--{other.replace('_', '-')} does not go with {kind} noise, which takes {flag}")
    noise = default.noise
    if numbers is not None:
        if not all(0.0 <= n < math.inf for n in numbers):
            raise UsageError(f"{flag} {' '.join(f'{n:g}' for n in numbers)}: numbers from 0 up are needed")
        if kind in WITH_ALPHAS and len(numbers) not in WITH_ALPHAS[kind]:
            wanted_count = " or ".join(str(n) for n in WITH_ALPHAS[kind])
            raise UsageError(f"--motion-alphas: {kind} noise takes {wanted_count} numbers, not {len(numbers)}")
        noise = VelocityNoise(kind, **{"alphas" if kind in WITH_ALPHAS else "sigma": tuple(numbers)})
    elif kind != noise.kind:
        raise UsageError(f"--motion-noise {kind} needs {flag}")
    return VelocityModel(noise, args.motion_model or default.model)


def _bag(args: argparse.Namespace) -> Log | str:
    """The log of the bag; with --list a table of its topics."""
    from data.columns.named import LENGTH
    from data.formats.bags import POLAR, USUAL, Role, Wanted, chosen, collect, listed, log_of_bag, topics_of
    from data.formats.recordings.laser import TravelNoise
    from data.formats.tables.files import POSE, TRAVEL, numbers

    topics = chosen(
        args.source, topics_of(args.source), odometry=args.odom, scans=args.scan, truth=args.truth,
        second=args.second_odom, skip=args.skip, listing=args.list,
    )  # fmt: skip
    if args.list:
        return listed(topics)
    if args.out is None:
        raise UsageError("OUT, a log folder to write, is needed (or --list)")

    if args.second_odom_sigma is not None and args.second_odom is None:
        text = f"--second-odom-sigma {args.second_odom_sigma}"
        raise UsageError(f"{text}: there is none; --second-odom TOPIC names it")
    there = {role for t in topics for role in (POLAR if t.role is Role.POLAR else (t.role,))}
    for role, flag in (*((role, f"{usual[0]}_sigma") for role, usual in USUAL.items()), (Role.RANGES, "range_unit")):
        if (text := getattr(args, flag)) is not None and role not in there:
            raise UsageError(f"--{flag.replace('_', '-')} {text}: no topic of {role}; --list says what each becomes")
    travel = "of travel [m] per sqrt(m) and sqrt(rad), of the heading [rad] per sqrt(m) and sqrt(rad)"
    one, found = "a standard deviation", {}
    for flag, dimensions, what, zero in (
        ("prior", POSE, "x, y [m], heading [rad]", None), ("prior-sigma", POSE, "of x, y [m], heading", True),
        ("point-sigma", ("length",), one, False), ("bearing-sigma", ("angle",), one, False),
        ("position-sigma", ("length",), one, False), ("heading-sigma", ("angle",), one, False),
        ("range-sigma", ("length",), one, False),
        ("second-odom-sigma", TRAVEL, travel, True),
    ):  # fmt: skip
        text = getattr(args, flag.replace("-", "_"))
        found[flag] = None if text is None else numbers(text, dimensions, flag, what, zero=zero)
    prior, prior_sigma, *sigmas, second = found.values()
    alone = [None if sigma is None else float(sigma[0]) for sigma in sigmas]
    noise = None if second is None else TravelNoise(*second.tolist())
    if (unit := args.range_unit or "") not in ("", *LENGTH):
        raise UsageError(f"--range-unit {unit}: {unknown(unit, LENGTH)}")
    wanted = Wanted(prior, prior_sigma, alone[0], alone[1], alone[2], alone[3], noise, alone[4], unit)
    return log_of_bag(args.source, args.out.absolute().name, topics, collect(args.source, topics), wanted)


SENSED = "labels-sensed"
TABLES = ("columns", "unit", "time-offset")
REPEATED = (
    "sensor", "observation-sigma", "sensor-pose", "max-range", "view", "sees", "descriptor-sigma", "class-error",
)  # fmt: skip
KEYS_ALONE = ("odometry", SENSED)  # Keys of a mapping file besides the flags below
FLAGS: dict[str, tuple[str, str]] = TEXTS["table"]["flags"]


def _add_table(add: Add) -> None:
    """The parser of `table`."""
    sub = parser_of(add, "table")
    sub.argument_default = argparse.SUPPRESS
    for name, (metavar, text) in FLAGS.items():
        action = "append" if name in (*TABLES, *REPEATED) else "store"
        sub.add_argument(f"--{name}", dest=name, metavar=metavar, help=text, action=action)
    sub.add_argument(f"--{SENSED}", dest=SENSED, action="store_true", help=TEXTS["table"]["sensed"])


def _table(args: argparse.Namespace) -> Recording:
    """The log of the files, with velocities as recorded."""
    from data.formats.tables.log import read_log
    from data.formats.tables.request import settle, with_mapping

    given: dict[str, object] = {key: value for key, value in vars(args).items() if key in (*FLAGS, SENSED)}
    if args.source.suffix == ".toml":
        given = with_mapping(args.source, given, (*FLAGS, *KEYS_ALONE))
    else:
        given["odometry"] = str(args.source)
    return read_log(args.out.absolute().name, settle(given))


SUFFIX = ".g2o"
TORO = (".graph", ".toro")


def _g2o(args: argparse.Namespace) -> Log | str:
    """The log of the graph, or a sentence about the graph that was written."""
    from data.formats.recognize import edges_of

    if args.source.endswith((SUFFIX, *TORO)) or any(edges_of(Path(args.source))):
        from data.formats.g2o import log_of, read_graph

        if args.run is not None:
            raise UsageError("--run: SOURCE is a graph already; a log is needed")
        return log_of(args.out.absolute().name, read_graph(Path(args.source), args.noise), true=args.true)
    from data.formats.g2o import POSE_IDS, graph_text, labelled, of_result, pose_ids
    from data.logs import open_log
    from data.terminal import counted

    if args.out.suffix != SUFFIX:
        raise UsageError(f"{args.out}: a log is written as a file {SUFFIX}; only a graph (SOURCE{SUFFIX}) as a log")
    if args.true:
        raise UsageError("--true: SOURCE is a log; a graph is needed")
    log = open_log(args.source)
    estimate = labelled(log) if args.run is None else of_result(log, args.run)
    given, closures, fixes = log.source.get(POSE_IDS), log.recorded.closures, log.recorded.fixes
    kept = isinstance(given, list) and len(given) == len(log.recorded)
    ids = given if isinstance(given, list) and kept else pose_ids(len(log.recorded), estimate)
    text = graph_text(log.recorded, estimate, ids)
    try:
        args.out.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise DataError.at(args.out, f"cannot be written: {error.strerror}") from error
    paired = int((estimate.of >= 0).sum())
    left = len(estimate.of) - paired
    sentence = f"{args.out}: {len(log.recorded)} poses, {len(estimate.landmark)} landmarks, {paired} observations"
    if closures is not None:
        sentence += f", {counted(len(closures), 'closure')}"
    if fixes is not None:
        sentence += f", {counted(len(fixes), 'fix', 'fixes')}"
    if log.truth.relations is not None:
        sentence += f"; {counted(len(log.truth.relations), 'reference relation')} omitted"
    if not kept and ids[0]:
        sentence += f"; poses have the ids {ids[0]} to {ids[-1]}, as landmarks keep theirs"
    return sentence + (f"; {left} observations of no landmark omitted" if left else "")


NAMED = ("victoria-park", "plaza", "dlr", "course", *(world for world, w in SIMULATORS.items() if w.help))
"""Recordings, and worlds with logs; of others a recording is written."""
TURNS, SEEN = "0.005,0.01,0.005", "0.1,0.1"
"""rad, m, rad of a step and m, rad of a landmark: the noise of the exercises on particle filters and on EKF-SLAM."""


def _add_named(add: Add, *, parameters: bool) -> None:
    """The parsers of recordings with a name, and of worlds; `parameters`: with theirs."""
    for kind in NAMED[:4]:
        parser_of(add, kind)
    for world in NAMED[4:]:
        w = SIMULATORS[world]
        description = f"{w.help[0].upper()}{w.help[1:]}. The same seed gives the same log."
        example = f"example:\n  python -m data.convert {world} logs/{world}-0 --seed 0 --frames 200"
        sub = add(world, help=w.help, description=description, epilog=example)
        if parameters:
            add_flags(sub, world)


def _named(args: argparse.Namespace) -> Log:
    """The log of the recording, or of the flags; the source of a simulated one has every parameter."""
    if args.kind == "victoria-park":
        from data.formats.recordings.victoria_park import load_victoria_park

        return load_victoria_park()
    if args.kind == "dlr":
        from data.formats.recordings.tagged import load_dlr

        return load_dlr(args.file, args.out.absolute().name)
    if args.kind == "course":
        from data.formats.recordings.tagged import load_course
        from data.formats.tables.files import numbers
        from data.origin import Origin

        angle, what = ("angle", "length", "angle"), "of r1, t and r2, as in 0.3deg,0.01,0.3deg"
        turns = numbers(args.odometry_sigma or TURNS, angle, "odometry-sigma", what, zero=True)
        what = "of a range [m] and a bearing [rad], as in 0.1,5deg"
        seen = numbers(args.observation_sigma or SEEN, ("length", "angle"), "observation-sigma", what, zero=False)
        log = load_course(args.file, args.out.absolute().name, args.map, turns, seen)
        given = {"odometry_noise": args.odometry_sigma, "observation_noise": args.observation_sigma}
        noise = {of: Origin.ASSUMED if text is None else Origin.GIVEN for of, text in given.items()}
        return replace(log, origins={**log.origins, **noise})
    if args.kind == "plaza":
        from data.formats.recordings.plaza import load_plaza

        return load_plaza(args.set, args.range_scale, args.range_sigma)
    from data.worlds.parameters import described

    kind = parameters_of(args.kind)
    values = kind(**{f.name: getattr(args, f.name) for f in fields(kind)})
    log = simulate(args.kind, values, args.seed)
    return replace(log, source={**log.source, args.kind: described(values)})


CONVERSIONS = {"mrclam": _mrclam, "bag": _bag, "table": _table, "g2o": _g2o, **dict.fromkeys(NAMED, _named)}
KINDS = tuple(CONVERSIONS)


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parsers of all kinds; `parameters`: with those of worlds, which take the world to be loaded."""
    about = "defaults: the frozen numbers of data/formats/mrclam.py"
    group = parser_of(add, "mrclam").add_argument_group("calibration and noise", about)
    declare(group, TEXTS["mrclam"]["calibration"] | TEXTS["mrclam"]["noise"])
    parser_of(add, "bag")
    _add_table(add)
    parser_of(add, "g2o")
    _add_named(add, parameters=parameters)


def convert(args: argparse.Namespace) -> Log | Recording | str:
    """The log of the kind asked for, or a sentence on what was printed or written instead."""
    return CONVERSIONS[args.kind](args)

"""Logs that have a name as open logs: simulated worlds, with a flag for every parameter, and what gtsam bundles."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from data.convert import TEXTS, said_of
from data.worlds.registry import SIMULATORS, add_flags, parameters_of, simulate

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log

KINDS = ("victoria-park", "plaza", "dlr", "course", *(world for world, w in SIMULATORS.items() if w.help))
"""Recordings, and worlds with logs; of others a recording is written."""
TURNS, SEEN = "0.005,0.01,0.005", "0.1,0.1"
"""rad, m, rad of a step and m, rad of a landmark: the noise of the exercises on particle filters and on EKF-SLAM."""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parsers of all kinds; `parameters`: with those of worlds, which take the world to be loaded."""
    park, plaza, dlr, course = (add(kind, **said_of(kind)) for kind in KINDS[:4])
    plaza.add_argument("set", metavar="SET", type=int, choices=(1, 2), help="1 or 2")
    plaza.add_argument("--range-scale", metavar="S", type=float, default=1.07, help=TEXTS["plaza"]["says"]["scale"])
    plaza.add_argument("--range-sigma", metavar="M", type=float, default=0.5, help="noise of a range (default: 0.5)")
    dlr.add_argument("file", metavar="FILE", type=Path, help="map.circles")
    course.add_argument("file", metavar="FILE", type=Path, help="sensor_data.dat")
    course.add_argument("--map", metavar="FILE", type=Path, help="the known map, as world.dat: id x y a line")
    odometry = ("--odometry-sigma", "R1,T,R2", "turns and drive of a step", TURNS)
    for flag, metavar, of, usual in (odometry, ("--observation-sigma", "R,B", "range and bearing", SEEN)):
        text = f"standard deviations of {of} (default: {usual}, as in the exercises)"
        course.add_argument(flag, metavar=metavar, help=text)
    for each in (park, plaza, dlr, course):
        each.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    for world in KINDS[4:]:
        w = SIMULATORS[world]
        description = f"{w.help[0].upper()}{w.help[1:]}. The same seed gives the same log."
        example = f"example:\n  python -m data.convert {world} logs/{world}-0 --seed 0 --frames 200"
        sub = add(world, help=w.help, description=description, epilog=example)
        if parameters:
            add_flags(sub, world)


def convert(args: argparse.Namespace) -> Log:
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
        from data.errors import UsageError
        from data.formats.recordings.plaza import load_plaza

        for flag, value in (("--range-scale", args.range_scale), ("--range-sigma", args.range_sigma)):
            if not 0.0 < value < 1e3:
                raise UsageError(f"{flag} {value:g}: a number above 0 is needed")
        return load_plaza(args.set, args.range_scale, args.range_sigma)
    from data.worlds.parameters import described

    kind = parameters_of(args.kind)
    values = kind(**{f.name: getattr(args, f.name) for f in fields(kind)})
    log = simulate(args.kind, values, args.seed)
    return replace(log, source={**log.source, args.kind: described(values)})

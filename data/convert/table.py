"""CSV files of another program as an open log: `--columns t=stamp,v=speed --unit angle=deg,time=ns`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data.command import Add
    from data.formats.open_log import Recording

KINDS = ("table",)
EXAMPLES = """\
examples:
  python -m data.convert table robot.csv logs/robot --unit time=ns,angle=deg \\
      --columns t=stamp,v=speed,omega=yaw_rate,range=dist,bearing=angle \\
      --odometry-sigma 0.05,2deg --observation-sigma 0.1,2deg
  python -m data.convert table odo.csv logs/robot --observations cones.csv --map survey.csv --truth gps.csv \\
      --columns odometry.t=time_ms,observations.t=ms,truth.t=utc \\
      --unit odometry.t=ms,observations.t=ms,truth.t=iso \\
      --map-transform 12.5,-3,90deg --prior truth --prior-sigma 0.1,0.1,3deg \\
      --odometry-sigma 0.05,2deg --observation-sigma 0.1,2deg --max-range 12
  python -m data.convert table wheels.csv logs/robot --observations cones.csv --columns left=encL,right=encR \\
      --track-width 0.54 --metres-per-tick 0.00012 --tick-wrap 65536 \\
      --odometry-sigma 0.05,0.05,0.075,0.045 --observation-sigma 0.1,2deg
  python -m data.convert table odo.csv logs/robot --sensor lidar=cones.csv --sensor radio=beacons.csv \\
      --observation-sigma lidar=0.1,2deg --observation-sigma radio=0.3 --odometry-sigma 0.05,2deg
  python -m data.convert table robot.toml logs/robot      the same keys in a file: odometry = "odo.csv", ...
"""
TEXT = """\
CSV files of any program: comma, semicolon, tab or spaces, with or without a line of names, with decimal commas.
Or MATLAB files, whose vectors are columns: NAME, of a matrix NAME_1, NAME_2 (of a wide one its rows), of several
structs STRUCT.FIELD.

What a column may hold (keys of --columns; its name in the file, or its number from 1):
  odometry       t, and v, omega (velocities) | x, y, theta (poses) | dx, dy, dtheta (steps) | left, right (ticks);
                 for theta also a quaternion qx, qy, qz, qw
  observations   t (or frame: row of the odometry, from 0), and range, bearing (or one) | x, y in the sensor's frame;
                 true_id: true landmark, for the referee only; label: the sensor's landmark; -1: false alarm
  map            x, y, and id; sx, sy: sigma, where surveyed (blank or 0: exact); kind: a word, where not all sensors
                 see all landmarks
  truth          t, x, y, theta; blank where unknown
  fixes          t (or frame), x, y and theta, blank where not measured; sx, sy, stheta: sigma; source: a name
  second-odometry    as odometry, without ticks
  closures       t1, t2 (or frame1, frame2), dx, dy, dtheta: pose at t2 in the frame of t1; sx, sy, stheta; source
For x, y of map, truth and fixes also lat, lon [deg]: metres east and north of the first such place.
A key alone applies to every file, with a part before it (odometry.t, truth.x; with --sensor its NAME) to that part. A
column named as its key need not be stated.
"""
SENSED = "labels-sensed"
TABLES = ("columns", "unit", "time-offset")
REPEATED = (
    "sensor", "observation-sigma", "sensor-pose", "max-range", "view", "sees", "descriptor-sigma", "class-error",
)  # fmt: skip
KEYS_ALONE = ("odometry", SENSED)
"""Keys of a mapping file besides the flags below."""
FLAGS = {
    "observations": ("FILE", "file with the observations (default: SOURCE)"),
    "sensor": ("NAME=FILE", "instead of --observations: the file of one of several sensors; repeatable. NAME.range "
                            "and so on name its columns, NAME=VALUE its noise, pose, view and kind of landmark below "
                            "(VALUE: of all sensors)"),
    "map": ("FILE", "known landmarks"),
    "truth": ("FILE", "true poses"),
    "fixes": ("FILE", "positions (GPS, UWB), headings (compass) or poses, which estimators get; then --observations "
                      "is needed where there are some"),
    "closures": ("FILE", "relative poses of two frames (loop closures, scan matches), which estimators get; likewise"),
    "scans": ("FILE", "laser scans, a row each: columns range0, range1, ... and angle_min, angle_increment, range_max "
                      "(as rostopic echo -p writes them); --columns scans.range=N: all from the N-th on"),
    "scanner": ("LOW,STEP,MAX", "of scans without such columns: first angle, step, reach, as in -90deg,0.5deg,8m"),
    "second-odometry": ("FILE", "another odometry of the same robot, as of a camera beside the wheels: closures "
                                "between successive frames"),
    "second-odometry-sigma": ("S,...", "its noise, as of --odometry-sigma (velocities: density)"),
    "second-odometry-kind": ("KIND", "velocities, poses or steps (default: by the columns)"),
    "columns": ("KEY=NAME,...", "names of the columns"),
    "unit": ("KEY=UNIT,...", "units: time (s, ms, us, ns, min, h, iso: dates), length (m, mm, cm, km, ft, in; v then "
                             "in that per s, and lengths of flags without a unit in that), angle (rad, mrad, deg, "
                             "rev; omega then in that per s), or of one key: v=km/h, bearing=-deg (clockwise)"),
    "odometry-kind": ("KIND", "velocities, poses, steps or ticks (default: by the columns)"),
    "odometry-sigma": ("S,...", "noise: for velocities sigma of v and omega per sqrt(s); else of travel per sqrt(m) "
                                "and sqrt(rad) and of the heading per sqrt(m) and sqrt(rad); numbers may have units: "
                                "5cm, 2deg"),
    "odometry-noise": ("MODEL", "for velocities: density (default), velocity (per sample), displacement (4 numbers), "
                                "textbook (4 or 6); else travel (default), or step: sigma of dx, dy and dtheta, the "
                                "same for each row"),
    "integrate": ("ORDER", "of velocities: arc (default), midpoint, turn-first or drive-first, as the program that "
                           "recorded them drives"),
    "observation-sigma": ("[NAME=]S1,S2", "noise of range and bearing, or of x and y, as in 0.1,2deg; one number: of "
                                          "ranges or bearings alone"),
    "fix-sigma": ("S,...", "noise of fixes without columns sx, sy, stheta: of x and y, of the heading, or of all "
                           "three"),
    "fix-lever": ("X,Y", "place of the antenna in the body frame (default: 0,0)"),
    "fix-rotation": ("ANGLE", "direction of the compass in the body frame (default: 0)"),
    "descriptor-sigma": ("[NAME=]S", "noise of the column descriptor of observations, such as diameters"),
    "class-error": ("[NAME=]P", "probability that the column class of observations is wrong"),
    "closure-sigma": ("SX,SY,STHETA", "noise of closures without columns sx, sy, stheta"),
    "track-width": ("M", "of wheel ticks: distance between the wheels"),
    "metres-per-tick": ("M[,M]", "of wheel ticks: for both, or left and right"),
    "hold": ("WAY", "velocities: each holds forward, until the next row (default), or backward, since the row before"),
    "time-offset": ("PART=SECONDS,...", "added to the stamps of odometry, observations, truth, fixes, closures or "
                                        "second-odometry, as in observations=-0.05 for readings stamped 0.05 s late"),
    "ticks": ("WHICH", "total: counted from the start (default); each: since the row before"),
    "tick-wrap": ("N", "total ticks start again at N, as 65536"),
    "prior": ("X,Y,THETA|truth", "first pose in the frame of map and truth (default without these: 0,0,0, exactly)"),
    "prior-sigma": ("SX,SY,STHETA", "its standard deviations"),
    "map-transform": ("X,Y,THETA", "pose of the map's frame in the world: each point is turned by THETA "
                                   "(counter-clockwise), then shifted by X, Y"),
    "truth-transform": ("X,Y,THETA", "the same for the truth"),
    "sensor-pose": ("[NAME=]X,Y,THETA", "pose of the sensor in the body frame (default: 0,0,0)"),
    "max-range": ("[NAME=]M", "reach of the sensor (default: the farthest observation)"),
    "view": ("[NAME=]LOW,HIGH", "least and largest bearing of the sensor, as in -60deg,60deg (default: all around)"),
    "sees": ("[NAME=]KIND", "kind of landmark that the sensor observes, of column kind of the map (default: all)"),
    "frames": ("WHICH", "instants with a pose: observations (default; those of fixes and closures, and every 1 s), "
                        "or odometry: also every row"),
}  # fmt: skip


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `table`; `parameters` is unused."""
    sub = add("table", help="CSV files of another program", description=TEXT, epilog=EXAMPLES)
    sub.argument_default = argparse.SUPPRESS
    mapping = "these flags as keys, odometry = FILE, [columns] and [unit] as tables; paths relative to it; flags win"
    text = f"file with the odometry, and by default the observations; or .toml: {mapping}"
    sub.add_argument("source", metavar="SOURCE", type=Path, help=text)
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    for name, (metavar, text) in FLAGS.items():
        action = "append" if name in (*TABLES, *REPEATED) else "store"
        sub.add_argument(f"--{name}", dest=name, metavar=metavar, help=text, action=action)
    text = "a sensor read the labels (barcodes), so some may be wrong"
    sub.add_argument(f"--{SENSED}", dest=SENSED, action="store_true", help=text)


def convert(args: argparse.Namespace) -> Recording:
    """The log of the files, with velocities as recorded."""
    from data.formats.tables.log import read_log
    from data.formats.tables.request import settle, with_mapping

    given: dict[str, object] = {key: value for key, value in vars(args).items() if key in (*FLAGS, SENSED)}
    if args.source.suffix == ".toml":
        given = with_mapping(args.source, given, (*FLAGS, *KEYS_ALONE))
    else:
        given["odometry"] = str(args.source)
    # a log of odometry with fixes, closures or a second odometry needs no observations
    if not {"fixes", "closures", "sensor", "scans", "second-odometry"} & set(given):
        given.setdefault("observations", given.get("odometry"))
    return read_log(args.out.absolute().name, settle(given))

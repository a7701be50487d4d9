"""A log written down as another program would: its own names, units and separators, in several files."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from data import se2
from data.log import Log

START = 1_700_000_000
"""s. Stamps are nanoseconds since 1970."""
FLAGS = (
    "--columns", "odometry.t=time [ns],odometry.x=east [mm],odometry.y=north [mm],odometry.theta=yaw [deg]",
    "--columns", "t=stamp,range=distance,bearing=angle,true_id=cone,map.id=cone,x=e,y=n,truth.theta=yaw",
    "--unit", "angle=deg,time=ns,length=mm", "--odometry-sigma", "50,50,0.075,0.045",
    "--observation-sigma", "100,0.02", "--prior", "truth", "--prior-sigma", "10cm,0.1m,0.03", "--max-range", "8m",
    "--frames", "odometry",
)  # fmt: skip


def nanoseconds(t: float) -> int:
    return round((t + START) * 1e9 / 1e3) * 1000


def table(path: Path, names: str, rows: Iterable[Iterable[object]], separator: str = ";") -> Path:
    lines = [names, *(separator.join(str(v) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def millimetres(*metres: float) -> list[str]:
    return [f"{1000.0 * m:.3f}" for m in metres]


def degrees(angle: float) -> str:
    return f"{np.degrees(se2.wrap_angle(angle)):.6f}"


def export(log: Log, folder: Path) -> list[str]:
    """Write the log; gives the words of `data.convert table`, but for OUT: odometry as poses in a frame of its own."""
    r = log.recorded
    pose = se2.dead_reckoned(np.array([5.0, -3.0, 1.0]), r.increments.mean)
    stamp = [nanoseconds(t) for t in r.time]
    odometry = ([t, *millimetres(x, y), degrees(a), "ok"] for t, (x, y, a) in zip(stamp, pose, strict=True))
    o = r.observations
    cones = zip(o.frame, o.z, log.truth.landmark_of, strict=True)
    readings = ([stamp[k], *millimetres(z[0]), degrees(z[1]), i] for k, z, i in cones)
    survey = ([i, *millimetres(*p)] for i, p in zip(r.map.id, r.map.xy, strict=True))
    truth = ([t, *millimetres(*p[:2]), degrees(p[2])] for t, p in zip(stamp, log.truth.pose, strict=True))
    files = {
        "": table(folder / "odo.csv", "time [ns];east [mm];north [mm];yaw [deg];battery", odometry),
        "observations": table(folder / "cones.csv", "stamp;distance;angle;cone", readings),
        "map": table(folder / "survey.csv", "cone;e;n", survey),
        "truth": table(folder / "gps.csv", "stamp;e;n;yaw", truth),
    }
    return [word for role, path in files.items() for word in ([f"--{role}"] if role else []) + [str(path)]]

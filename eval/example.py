"""`slamref example DIR`: CSV files as a robot might have written them, and the commands that make a report of them."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from data import se2
from data.errors import UsageError
from data.terminal import ending
from data.whole import whole_folder
from eval.plan.flags import TEXTS, command_of

PROG = "python -m eval.example"
COMMANDS = (TEXTS / "example.sh").read_text(encoding="utf-8")


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    folder: Path = command_of(prog, PROG, "example").read(argv).folder
    if folder.exists():
        raise UsageError(f"{folder} exists; name a new folder")
    with whole_folder(folder) as made:
        write(made)
    sys.stdout.write(f"in {folder}: odometry.csv, cones.csv, map.csv, truth.csv; commands.sh has these commands:\n\n")
    sys.stdout.write(f"cd {folder}\n{COMMANDS}")


def write(folder: Path) -> None:
    """Write the files: a drive among cones (`arena:5`), poses by odometry, cones by distance and angle."""
    import pandas as pd  # slow to load

    from data.worlds.arena import Arena, simulate

    log = simulate(Arena(), 5)
    o, known = log.recorded.observations, log.recorded.map
    assert known is not None
    assert log.truth.pose is not None
    stamp = np.rint(1.7e12 + 1000 * log.recorded.time).astype(np.int64)
    driven = se2.dead_reckoned(np.zeros(3), log.recorded.increments.mean)
    poses, seen = ("stamp_ms", "pos_x", "pos_y", "yaw_deg"), ("stamp_ms", "dist_m", "angle_deg")
    tables = {
        "odometry": (poses, stamp, driven[:, :2], np.degrees(driven[:, 2])),
        "cones": (seen, stamp[o.frame], o.z[:, :1], np.degrees(o.z[:, 1])),
        "truth": (poses, stamp, log.truth.pose[:, :2], np.degrees(log.truth.pose[:, 2])),
        "map": (("cone", "east_m", "north_m"), known.id, known.xy, None),
    }
    for name, (head, first, metres, degrees) in tables.items():
        columns = [*np.round(metres, 4).T, *([] if degrees is None else [np.round(degrees, 3)])]
        made = pd.DataFrame(dict(zip(head, [first, *columns], strict=True)))
        made.to_csv(folder / f"{name}.csv", sep=";", index=False, lineterminator="\r\n")
    (folder / "commands.sh").write_text(COMMANDS, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())

"""Small CARMEN logs as text."""

from collections.abc import Sequence

TAIL = "host 7"


def odom(x: float, y: float, theta: float, stamp: float) -> str:
    return f"ODOM {x!r} {y!r} {theta!r} 0.1 0.2 0 {stamp!r} {TAIL}"


def flaser(ranges: Sequence[object], pose: tuple[float, float, float], stamp: float) -> str:
    place = " ".join(map(repr, pose))
    return f"FLASER {len(ranges)} {' '.join(map(str, ranges))} {place} {place} {stamp!r} {TAIL}"


def robotlaser(
    ranges: Sequence[object], laser: tuple[float, float, float], robot: tuple[float, float, float], stamp: float, *,
    head: str = "0 -2.0 4.0 0.5 5.6 0.03 0", remissions: Sequence[object] = (),
) -> str:  # fmt: skip
    intensities = " ".join(["", *map(str, remissions)])
    return (
        f"ROBOTLASER1 {head} {len(ranges)} {' '.join(map(str, ranges))} {len(remissions)}{intensities} "
        f"{' '.join(map(repr, laser))} {' '.join(map(repr, robot))} 0.1 0.2 0 0 0 {stamp!r} {TAIL}"
    )


SMALL = "\n".join(
    [
        "# made up",
        "PARAM robot_frontlaser_offset 0.25 host 0",
        "SYNC one",
        odom(1.0, 2.0, 0.5, 10.0),
        flaser([1.0, 2.5, 81.83], (1.0, 2.0, 0.5), 10.02),
        odom(1.1, 2.0, 0.6, 10.5),
        "NEFF 3",
        odom(1.1, 2.0, 0.6, 10.25),
        flaser([0.0, 3.0, 80.0], (1.1, 2.0, 0.6), 10.3),
        odom(1.2, 2.1, 0.7, 11.0),
        "",
    ]
)
"""Four frames, scans in the first and the third, a stamp that goes back."""

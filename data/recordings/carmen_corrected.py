"""Raw odometry out of a CARMEN log whose poses a particle filter has corrected.

Such a log states the corrected pose in each scan line that the filter used; the ODOM lines up to the next one are that
pose with the raw increments behind it. A scan line is stated at the instant of the ODOM line before it. Some programs
write the corrected pose once more, as an ODOM line without a stamp of its own, before the NEFF line.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data.recordings.carmen_lines import CarmenLines, OdometryLines
from data.se2 import between, dead_reckoned, wrap_angle


def without_corrections(lines: CarmenLines) -> tuple[CarmenLines, str]:
    """The same lines with raw odometry from the first ODOM pose on, and a sentence about it.

    The raw increment into an ODOM line leads from the newest pose stated before it, be it corrected or not. ODOM lines
    that state a corrected pose once more are left out. The poses of the scan lines stay as they are.
    """
    odometry, scans = lines.odometry, lines.scans
    again = _stated_again(lines)
    line = np.concatenate([odometry.line, scans.line])
    order = np.argsort(line, kind="stable")
    pose = np.concatenate([odometry.pose, scans.robot])[order]
    counts = np.concatenate([~again, np.zeros(len(scans.line), bool)])[order]
    counted = np.flatnonzero(counts)
    increments = between(pose[np.maximum(counted - 1, 0)], pose[counted])
    increments[0] = 0.0
    raw = dead_reckoned(pose[counted[0]], increments)
    raw[:, 2] = wrap_angle(raw[:, 2])
    kept = OdometryLines(raw, odometry.stamp[~again], odometry.line[~again])
    before = np.searchsorted(odometry.line, scans.line) - 1
    corrections = between(odometry.pose[before[before >= 0]], scans.robot[before >= 0])
    distance = np.hypot(corrections[:, 0], corrections[:, 1])
    moved = int(((distance > 0.0) | (corrections[:, 2] != 0.0)).sum())
    said = (
        f"Raw odometry recovered: {moved} corrections undone, the largest {distance.max(initial=0.0):.3g} m; "
        f"{int(again.sum())} ODOM lines that state a corrected pose once more were left out."
    )
    return replace(lines, odometry=kept, neff=lines.neff[:0]), said


def _stated_again(lines: CarmenLines) -> NDArray[np.bool_]:
    """Which ODOM lines (O,) state the pose of the scan line before them once more: no other line of a pose is between,
    the pose is the same, and a NEFF line follows at once or the stamp is 0.
    """
    odometry, scans = lines.odometry, lines.scans
    scan = np.searchsorted(scans.line, odometry.line) - 1
    first = np.append(True, scan[1:] != scan[:-1]) & (scan >= 0)
    same = (odometry.pose == scans.robot[np.maximum(scan, 0)]).all(axis=1)
    marked = np.isin(odometry.line + 1, lines.neff) | (odometry.stamp == 0.0)
    stated: NDArray[np.bool_] = first & same & marked
    return stated

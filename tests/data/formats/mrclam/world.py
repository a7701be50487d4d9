"""A small MRCLAM dataset in the published form, without noise, so that every number can be known beforehand.

Robot 1 drives a circle of radius 2 m about (0, 0), anticlockwise from (2, 0), at 0.4 m/s; the ground truth is at 20 Hz
(stamps of a millisecond), the odometry at 10 Hz starts 1 s later, an image with one or more readings comes every 0.4 s.
"""

import math
import zipfile
from pathlib import Path

from data.formats.mrclam import Calibration
from data.log import Log

HEADER = (
    "# UTIAS Multi-Robot Cooperative Localization and Mapping Dataset\n# made for a test\n# {} Data Format:\n# {}\n"
)
T0 = 1248272263.361
SPEED, RADIUS = 0.4, 2.0
TURN = SPEED / RADIUS
LASTS = 12.0
"""s of ground truth; odometry and readings end 1 s earlier."""
ODOMETRY_STARTS = 1.0
BARCODES = {**{n: 40 + n for n in range(1, 6)}, **{n: 100 - n for n in range(6, 21)}}
"""Barcode by subject."""
LANDMARKS = {n: (4.5 * math.cos(2 * math.pi * n / 15), 4.5 * math.sin(2 * math.pi * n / 15)) for n in range(6, 21)}

PLAIN = Calibration()
TRUTH, ODOMETRY, MEASURED = "Robot1_Groundtruth.dat", "Robot1_Odometry.dat", "Robot1_Measurement.dat"
Texts = dict[str, str]


def pose_at(t: float) -> tuple[float, float, float]:
    """True pose t seconds after the first ground-truth row."""
    a = TURN * t
    return RADIUS * math.cos(a), RADIUS * math.sin(a), math.remainder(a + math.pi / 2, math.tau)


def reading(t: float, place: tuple[float, float]) -> tuple[float, float]:
    x, y, heading = pose_at(t)
    dx, dy = place[0] - x, place[1] - y
    return math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - heading, math.tau)


def measurement_rows() -> list[tuple[float, int, float, float]]:
    """(t, subject, range, bearing): the two landmarks nearest ahead in each image, and robot 2 in every third."""
    rows = []
    for k in range(int((LASTS - 2.0) / 0.4)):
        t = 1.2 + 0.4 * k
        seen = sorted((abs(reading(t, place)[1]), n) for n, place in LANDMARKS.items())[:2]
        rows += [(t, n, *reading(t, LANDMARKS[n])) for _, n in sorted(seen)]
        if k % 3 == 0:
            rows.append((t, 2, 1.5, 0.1))
    return rows


def texts() -> Texts:
    steps = range(int(LASTS * 20) + 1)
    truth = [f"{T0 + k / 20:.3f} \t  {x:.8f} \t {y:.8f} \t {h:.8f} " for k in steps for x, y, h in [pose_at(k / 20)]]
    ticks = range(round(ODOMETRY_STARTS * 10), int((LASTS - 1.0) * 10) + 1)
    odometry = [f"{T0 + k / 10:.3f} \t  {SPEED:.3f} \t  {TURN:.3f} " for k in ticks]
    measured = [f"{T0 + t:.3f} \t  {BARCODES[n]} \t  {r:.6f} \t  {b:.6f} " for t, n, r, b in measurement_rows()]
    codes = [f" {n:2d} \t {b:3d} " for n, b in BARCODES.items()]
    survey = [f" {n:2d} \t {x:.8f} \t {y:.8f} \t 0.00002 \t 0.00004 " for n, (x, y) in LANDMARKS.items()]
    parts = {
        "Barcodes.dat": ("Barcode", "Subject #    Barcode #", codes),
        "Landmark_Groundtruth.dat": ("Landmark Groundtruth", "Subject #    x [m]    y [m]    std-devs", survey),
        "Robot1_Groundtruth.dat": ("Robot Groundtruth", "Time [s]    x [m]    y [m]    orientation [rad]", truth),
        "Robot1_Odometry.dat": ("Odometry", "Time [s]    forward velocity [m/s]    angular velocity [rad/s]", odometry),
        "Robot1_Measurement.dat": ("Measurement", "Time [s]    Subject #    range [m]    bearing [rad]", measured),
    }
    return {
        name: HEADER.format(what, columns) + "\n".join(rows) + "\n" for name, (what, columns, rows) in parts.items()
    }


def save_folder(folder: Path, files: Texts) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_bytes(text.encode())
    return folder


def save_zip(path: Path, files: Texts, top: str = "MRCLAM_Dataset77/") -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(top + name, text)
    return path


def replace_row(text: str, row: int, new: str | None) -> tuple[str, int]:
    """The text with data row `row` (0 the first, -1 the last) replaced, or removed; and the number of its line."""
    lines = text.splitlines()
    data = [i for i, line in enumerate(lines) if not line.startswith("#")]
    at = data[row]
    lines[at : at + 1] = [] if new is None else [new]
    return "\n".join(lines) + "\n", at + 1


def exchange(survey: str, one: int, other: int) -> str:
    return (
        survey.replace(f" {one:2d} \t", " AA \t")
        .replace(f" {other:2d} \t", f" {one:2d} \t")
        .replace(" AA \t", f" {other:2d} \t")
    )


def starts_at(log: Log) -> float:
    """First frame, in seconds after the first ground-truth row."""
    return float(log.source["first_stamp"]) - T0  # type: ignore[arg-type]


def noted(log: Log, *words: str) -> bool:
    return any(all(w in note for w in words) for note in log.notes)

"""Victoria Park: the car log bundled with gtsam (odometry and associated tree detections; no ground truth).

Space-separated text, two kinds of line in time order; a LANDMARK line belongs to the newest pose:

    ODOMETRY i j dx dy dtheta Cxx Cxy Cxt Cyy Cyt Ctt    pose j in the frame of pose i, covariance (upper triangle)
    LANDMARK i l x y Cxx Cxy Cyy                         landmark l in the frame of pose i [m], covariance [m^2]

Poses and landmarks share one counter in the file; frames are counted without its gaps. There are no stamps: time is the
frame number. Recorded by E. Nebot's group in Sydney; this form by M. Kaess (iSAM).
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
from pathlib import Path

import numpy as np

from data.csv_table import bytes_of, is_number, symmetric
from data.errors import LARGEST, DataError
from data.inputs import Increments, Inputs, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.origin import Origin
from data.se2 import Array
from data.sensors import RelativePoint
from data.truth import Truth

FILE = "victoria_park.txt"
SENSOR = RelativePoint(max_range=25.0, min_angle=-0.5 * math.pi, max_angle=0.5 * math.pi)
"""A forward laser. It reaches 80 m, but the trees of this log are 4.6 to 20.7 m away."""
FLOOR = 1e-10
"""Smallest eigenvalue of an increment's covariance; the file's are all larger."""
ODOMETRY, LANDMARK = "ODOMETRY", "LANDMARK"
COLUMNS = {
    ODOMETRY: ("i", "j", "dx", "dy", "dtheta", "Cxx", "Cxy", "Cxt", "Cyy", "Cyt", "Ctt"),
    LANDMARK: ("i", "l", "x", "y", "Cxx", "Cxy", "Cyy"),
}


def bundled_file(name: str = FILE) -> Path:
    """A file inside the installed gtsam wheel, found without importing gtsam; DataError if missing."""
    spec = importlib.util.find_spec("gtsam")
    if spec is None or not spec.submodule_search_locations:
        raise DataError(f"{name}: gtsam is not installed, and its wheel holds this file; pip install gtsam")
    for folder in spec.submodule_search_locations:
        path = Path(folder) / "Data" / name
        if path.is_file():
            return path
    raise DataError.at(Path(spec.submodule_search_locations[0]) / "Data" / name, "no such file in the installed gtsam")


def load_victoria_park(path: Path | None = None) -> Log:
    """The log; `path` is read instead of the bundled file.

    The first pose is the origin, exactly. True ids are the file's associations. DataError names line and column.
    """
    file = bundled_file() if path is None else Path(path)
    content = bytes_of(file)
    odometry, observations = _parse(file, content.decode("utf-8", "replace"))
    n = len(odometry) + 1
    mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    mean[1:] = odometry[:, :3]
    covariance[1:] = symmetric(odometry[:, 3:])
    covariance, floored = floor_covariances(covariance, FLOOR)
    recorded = Inputs(
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        time=np.arange(n, dtype=float),
        increments=Increments(mean, covariance),
        observations=Observations(
            observations[:, 0].astype(np.int64), observations[:, 2:4], symmetric(observations[:, 4:])
        ),
        sensor=SENSOR,
        time_is_index=True,
        covariance_floor=FLOOR,
        floored=floored,
    )
    return Log(
        name="victoria-park",
        recorded=recorded,
        truth=Truth(landmark_of=observations[:, 1].astype(np.int64)),
        source={"kind": "victoria-park", "file": file.name, "sha256": hashlib.sha256(content).hexdigest()},
        notes=("No ground truth: poses are compared with the batch smoother's.",),
        origins={"max_range": Origin.ASSUMED},
    )


def _parse(path: Path, text: str) -> tuple[Array, Array]:
    """Odometry (N - 1, 9): increment and covariance; observations (M, 7): frame, landmark, x, y, covariance."""
    odometry: list[list[float]] = []
    observations: list[list[float]] = []
    newest: float | None = None
    for number, line in enumerate(text.rstrip().split("\n"), start=1):
        kind, *fields = line.split() or [""]
        if kind not in COLUMNS:
            raise DataError.at(path, f"starts with {kind[:40]!r}; {ODOMETRY} or {LANDMARK} is needed", line=number)
        values = _numbers(path, number, kind, fields)
        if newest is not None and values[0] != newest:
            raise DataError.at(path, f"{values[0]:g} is not the newest pose, {newest:g}", line=number, column="i")
        if kind == ODOMETRY:
            if values[1] <= values[0]:
                what = f"{values[1]:g} does not come after pose {values[0]:g}"
                raise DataError.at(path, what, line=number, column="j")
            odometry.append(values[2:])
            newest = values[1]
        else:
            newest = values[0]
            observations.append([float(len(odometry)), *values[1:]])
        _require_covariance(path, number, values[5:] if kind == ODOMETRY else values[4:], 3 if kind == ODOMETRY else 2)
    if not odometry:
        raise DataError.at(path, f"no {ODOMETRY} line", line=1)
    return np.array(odometry), np.array(observations).reshape(-1, 7)


def _numbers(path: Path, line: int, kind: str, fields: list[str]) -> list[float]:
    """The fields of a line as finite numbers, the first two whole and not negative."""
    names = COLUMNS[kind]
    if len(fields) != len(names):
        right = f"{len(names)} are needed ({', '.join(names)})"
        raise DataError.at(path, f"{kind} with {len(fields)} numbers; {right}", line=line)
    values = []
    for name, field in zip(names, fields, strict=True):
        value = float(field) if is_number(field) else math.nan
        whole = name in ("i", "j", "l")
        if not abs(value) <= LARGEST or (whole and (value < 0 or not value.is_integer())):
            wanted = "a whole number from 0 up" if whole else "a number"
            raise DataError.at(path, f"{field[:40]!r} is not {wanted}", line=line, column=name)
        values.append(value)
    return values


def _require_covariance(path: Path, line: int, upper: list[float], d: int) -> None:
    """Raise unless positive definite for an observation (d = 2), or semidefinite for an increment (d = 3)."""
    if d == 2 or any(upper[k] for k in (1, 2, 4)):
        matrix = symmetric(np.array([upper]))[0]
        low, trace = float(np.linalg.eigvalsh(matrix)[0]), float(np.trace(matrix))
    else:  # diagonal, as every increment of the bundled file
        low, trace = min(upper[0], upper[3], upper[5]), upper[0] + upper[3] + upper[5]
    if low < -1e-12 * trace or trace < 0.0 or (d == 2 and low <= 1e-12 * trace):
        kind = "positive definite" if d == 2 else "positive semidefinite"
        raise DataError.at(path, f"the covariance is not {kind} (smallest eigenvalue {low:.3g})", line=line)

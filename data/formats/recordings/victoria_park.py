"""Victoria Park: the car log bundled with gtsam (odometry and associated tree detections; no ground truth).

Space-separated text, two kinds of line in time order; a LANDMARK line belongs to the newest pose:

    ODOMETRY i j dx dy dtheta Cxx Cxy Cxt Cyy Cyt Ctt    pose j in the frame of pose i, covariance (upper triangle)
    LANDMARK i l x y Cxx Cxy Cyy                         landmark l in the frame of pose i [m], covariance [m^2]

Poses and landmarks share one counter in the file; frames are counted without its gaps. There are no stamps: time is the
frame number. Recorded by E. Nebot's group in Sydney; this form by M. Kaess (iSAM).
"""

import importlib.util
import math
from pathlib import Path

import numpy as np

from data.csv_table import bytes_of, symmetric
from data.digest import source_file
from data.errors import DataError
from data.formats.recordings.laser import FLOOR
from data.inputs import Increments, Inputs, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.origin import Origin
from data.sensors import RelativePoint
from data.truth import Truth

FILE = "victoria_park.txt"
SENSOR = RelativePoint(max_range=25.0, min_angle=-0.5 * math.pi, max_angle=0.5 * math.pi)
"""A forward laser. It reaches 80 m, but the trees of this log are 4.6 to 20.7 m away."""


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


def load_victoria_park() -> Log:
    """The log. The first pose is the origin, exactly. True ids are the file's associations."""
    file = bundled_file()
    rows = [line.split() for line in bytes_of(file).decode().splitlines()]
    is_step = np.array([row[0] == "ODOMETRY" for row in rows])
    steps, seen = (np.array([row[1:] for row, own in zip(rows, is_step, strict=True) if own == of], float)
                   for of in (True, False))  # fmt: skip
    n = len(steps) + 1
    mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    mean[1:] = steps[:, 2:5]
    covariance[1:] = symmetric(steps[:, 5:])
    covariance, floored = floor_covariances(covariance, FLOOR)  # the file's are all larger
    recorded = Inputs(
        prior=Prior(np.zeros(3), np.zeros((3, 3))), time=np.arange(n, dtype=float),
        increments=Increments(mean, covariance),
        observations=Observations(np.cumsum(is_step)[~is_step], seen[:, 2:4], symmetric(seen[:, 4:])), sensor=SENSOR,
        time_is_index=True, covariance_floor=FLOOR, floored=floored,
    )  # fmt: skip
    return Log(
        name="victoria-park", recorded=recorded, truth=Truth(landmark_of=seen[:, 1].astype(np.int64)),
        source={"kind": "victoria-park", **source_file(file)},
        notes=("No ground truth: poses are compared with the batch smoother's.",),
        origins={"max_range": Origin.ASSUMED},
    )  # fmt: skip

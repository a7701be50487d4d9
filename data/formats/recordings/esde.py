"""A recorded EKF-SLAM run of a published study with the NEES of its filters: a `results.mat` as log and reference.

Source: M. Brossard, A. Barrau, S. Bonnabel, "Exploiting Symmetries to Design EKFs With Consistency Properties for
Navigation and SLAM", IEEE Sensors Journal 19(4), 2019; the file is `simulations/results.mat` of its public code. It
holds a workspace after two runs; inputs and measurements are those of the second.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.formats.matlab import load
from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.se2 import Array, wrap_angle
from data.sensors import RelativePoint
from data.truth import Truth

NAME = "results.mat"
LEAST = float(np.sqrt(np.finfo(float).tiny))
"""m; the variance of a smaller standard deviation underflows."""
RUN = 1
"""Row of the inputs' run in per-run arrays."""
STORED = {"ekf": "neesR_std", "ekf-invariant": "neesR_iekf"}
NEEDED = ("v_m", "omega_m", "z", "xR_true", "xL_true_fixed", "sigma_v", "sigma_w", "sigma_p", *STORED.values())


@dataclass(frozen=True)
class StoredRun:
    """The recording: speed and turn rate (N,), z (3, slots, N), truth (3, N), landmarks (2, L), sigmas, NEES (N,)."""

    v: Array
    omega: Array
    z: Array
    truth: Array
    landmarks: Array
    sigma_v: float
    sigma_omega: float
    sigma_point: float
    nees: Mapping[str, Array]
    sha256: str


def find_esde(folders: list[Path]) -> Path | None:
    """The recording in one of these folders, two levels deep, or None."""
    for folder in folders:
        for path in (folder / NAME, *sorted(folder.glob(f"*/{NAME}"))):
            if path.is_file():
                return path
    return None


def load_esde(path: Path) -> StoredRun:
    """Read the recording; DataError for any other file."""
    content = path.read_bytes()
    m = load(path, NEEDED)
    missing = [name for name in NEEDED if name not in m]
    if missing:
        raise DataError(f"{path}: variable {missing[0]} is missing; a stored run of the study has it")
    a = {name: _numbers(path, name, m[name]) for name in NEEDED}
    n, z, true, places = a["v_m"].size, a["z"], a["xR_true"], a["xL_true_fixed"]
    fits = {
        "xR_true": true.ndim == 3 and true.shape[:2] == (3, n) and true.shape[2] > RUN,
        "z": z.ndim == 3 and z.shape[0] == 3 and z.shape[2] == n,
        "xL_true_fixed": places.ndim == 2 and len(places) == 2,
        "omega_m": a["omega_m"].size == n,
        **{name: a[name].shape[-1] > RUN and a[name].size == n * a[name].shape[-1] for name in STORED.values()},
    }
    for name, fine in fits.items():
        if not fine:
            raise DataError(f"{path}: variable {name} is {a[name].shape}, which does not fit {n} steps")
    if not a["sigma_p"].flat[0] >= LEAST or a["sigma_v"].size != 1 or a["sigma_w"].size != 1:
        raise DataError(f"{path}: sigma_v and sigma_w are numbers, sigma_p is above 0")
    if not (z[2] == np.floor(z[2])).all():
        raise DataError(f"{path}: variable z has landmark ids that are no whole numbers")
    return StoredRun(
        v=a["v_m"].ravel(),
        omega=a["omega_m"].ravel(),
        z=z,
        truth=true[:, :, RUN],
        landmarks=places,
        sigma_v=float(a["sigma_v"].squeeze()),
        sigma_omega=float(a["sigma_w"].squeeze()),
        sigma_point=float(np.ravel(a["sigma_p"])[0]),
        nees={name: a[variable].reshape(-1, a[variable].shape[-1])[:, RUN] for name, variable in STORED.items()},
        sha256=hashlib.sha256(content).hexdigest(),
    )


def _numbers(path: Path, name: str, value: object) -> Array:
    """An array of numbers; all but those of the NEES are finite and at most `LARGEST`."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or not value.size:
        raise DataError(f"{path}: variable {name} does not hold numbers")
    if name not in STORED.values() and not (np.abs(value) <= LARGEST).all():
        raise DataError(f"{path}: variable {name} holds a value that is not finite or too large")
    return value


def log_of(run: StoredRun, name: str, *, speed_noise: str = "start", floor: float = 0.0) -> Log:
    """The recording as a log, without the measurement of the first step, which the study does not use.

    Args:
        run: the recording.
        name: of the log.
        speed_noise: whether speed noise acts along the heading at the `start` or `end` of a step (the study's invariant
            filter uses the end).
        floor: m^2, rad^2, floor of the increments' covariances, which are all singular; smoothers need one.
    """
    n = len(run.v)
    mean = np.zeros((n, 3))
    mean[1:, 0], mean[1:, 2] = run.v[:-1], run.omega[:-1]
    covariance = np.zeros((n, 3, 3))
    angle = mean[1:, 2] if speed_noise == "end" else np.zeros(n - 1)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    covariance[1:, :2, :2] = run.sigma_v**2 * direction[:, :, None] * direction[:, None, :]
    covariance[1:, 2, 2] = run.sigma_omega**2
    floored = 0
    if floor > 0.0:
        covariance, floored = floor_covariances(covariance, floor)
    step, slot = np.nonzero(run.z[2].T > 0)
    step, slot = step[step > 0], slot[step > 0]
    z = run.z[:2, slot, step].T
    true_id = run.z[2, slot, step].astype(np.int64)
    R = np.tile(run.sigma_point**2 * np.eye(2), (len(z), 1, 1))
    known = LandmarkMap(np.arange(1, run.landmarks.shape[1] + 1), run.landmarks.T)
    inputs = Inputs(
        Prior(np.zeros(3), np.zeros((3, 3))),
        np.arange(n, dtype=np.float64),
        Increments(mean, covariance),
        Observations(step.astype(np.int64), z, R),
        RelativePoint(max_range=5.0),
        known,
        covariance_floor=floor,
        floored=floored,
    )
    truth = run.truth.T.copy()
    truth[:, 2] = wrap_angle(truth[:, 2])
    source = {"kind": "esde", "file": NAME, "sha256": run.sha256}
    return Log(name, inputs, Truth(truth, known, true_id), source=source)

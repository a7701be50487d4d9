"""The configuration of a lab recording, a MATLAB file in cm and degrees, to and from a setup in SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError
from data.formats.matlab import kind_of
from data.inputs import Prior
from data.pictures import CORNERS, VisualSetup
from data.se2 import Array, rotation, wrap_angle
from wings.camera.lab.records import Place, size_of

REFERENCES = "landmark"  # folder of the reference images, one per row of the map
CM = 0.01  # m; the unit of map and prior, and T's default
TRANSLATION_UNITS = {"cm": CM, "mm": 0.001, "m": 1.0}
READINGS = ("to-camera", "to-body")
PARTS = {
    "camera_to_body": ("R", "T"),
    "landmark": ("xpos", "ypos"),
    "pose_init": ("x0", "y0", "theta0", "sigma_x", "sigma_y", "sigma_theta"),
}
"""Structs of the file and their fields."""
ORTHOGONAL = 1e-3  # largest deviation of R R' from the identity, for matrices typed with four digits


def read_configuration(path: Path, values: Mapping[str, object], *, translation_unit: str, reading: str) -> VisualSetup:
    """The setup from the structs of a file, or their fields alone; its corners have a row for each picture of the map.

    `reading`: "to-camera" if R and T are those of p_c = R p_b + T (the lab's formula); "to-body" if they are those of
    p_b = R p_c + T (as the name camera_to_body says).
    Raises DataError for missing or invalid fields, UsageError for an unknown unit or reading.
    """
    if translation_unit not in TRANSLATION_UNITS:
        raise UsageError(f"unit of T {translation_unit!r}; known: {', '.join(TRANSLATION_UNITS)}")
    if reading not in READINGS:
        raise UsageError(f"reading of camera_to_body {reading!r}; known: {', '.join(READINGS)}")
    fields = _fields(path, values)
    rotation_in_file = Place(path, "camera_to_body.R")
    R = rotation_in_file.finite(fields["R"])
    shown = str(R.tolist())
    if R.shape != (2, 2):
        raise rotation_in_file.error(f"size {size_of(R)}; a rotation matrix, 2x2, is needed")
    if np.abs(R @ R.T - np.eye(2)).max() > ORTHOGONAL:
        raise rotation_in_file.error(f"{shown} is no rotation; R R' = I is needed, as [[0, -1], [1, 0]]")
    if np.linalg.det(R) < 0:
        raise rotation_in_file.error(f"{shown} mirrors (det -1); a rotation as [[0, -1], [1, 0]] is needed")
    T = Place(path, "camera_to_body.T").finite(fields["T"], 2) * TRANSLATION_UNITS[translation_unit]
    if reading == "to-body":
        R, T = R.T, -R.T @ T
    # the nearest rotation of a rounded matrix
    angle, translation = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]), (float(T[0]), float(T[1]))
    pose = {n: float(Place(path, f"pose_init.{n}").finite(fields[n], 1)[0]) for n in PARTS["pose_init"]}
    sigma = np.array([pose["sigma_x"] * CM, pose["sigma_y"] * CM, math.radians(pose["sigma_theta"])])
    for name, value in zip(PARTS["pose_init"][3:], sigma, strict=True):
        if value < 0:
            raise DataError.at(path, f"pose_init.{name}: {pose[name]:g}; a standard deviation is not negative")
    mean = np.array([pose["x0"] * CM, pose["y0"] * CM, wrap_angle(math.radians(pose["theta0"]))])
    return VisualSetup(angle, translation, _corners(path, fields) * CM, Prior(mean, np.diag(sigma**2)))


def _fields(path: Path, values: Mapping[str, object]) -> dict[str, object]:
    """The fields of all structs, which have different names."""
    found: dict[str, object] = {}
    for part, needed in PARTS.items():
        inside = values.get(part, {field: values[field] for field in needed if field in values})
        if not isinstance(inside, Mapping):
            what = f"{kind_of(inside)} of size {size_of(np.asarray(inside))}"
            raise DataError.at(path, f"{part}: {what}; one struct is needed")
        if not inside:
            raise DataError.at(path, f"no struct {part}; {', '.join(PARTS)} are needed")
        for field in needed:
            if field not in inside:
                raise DataError.at(path, f"{part}: no field {field}; {', '.join(needed)} are needed")
        found |= {field: inside[field] for field in needed}
    return found


def _corners(path: Path, fields: Mapping[str, object]) -> Array:
    """Corners (L, 4, 2) of the map in the file's unit."""
    both: list[Array] = []
    for name in PARTS["landmark"]:
        place = Place(path, f"landmark.{name}")
        value = place.finite(fields[name])
        if value.ndim != 2 or value.shape[1] != CORNERS or not len(value):
            raise place.error(f"size {size_of(value)}; a row of 4 corners per picture is needed")
        if both and both[0].shape != value.shape:
            raise place.error(f"size {size_of(value)}, but xpos has size {size_of(both[0])}; the same is needed")
        both.append(value)
    corners = np.stack(both, axis=-1)
    for i, picture in enumerate(corners, start=1):
        if np.array_equal(picture[0], picture[1]):
            what = "a picture without width; corners run upper left, upper right, lower right, lower left"
            raise DataError.at(path, f"landmark.xpos({i},:), ypos({i},:): {what}")
    return corners


def configuration(setup: VisualSetup) -> dict[str, dict[str, Any]]:
    """The setup as the file's structs, p_c = R p_b + T with T in cm; DataError for a correlated prior."""
    P = setup.prior.covariance
    if np.any(P - np.diag(np.diag(P))):
        raise DataError("the prior's covariance is not diagonal; the lab's format has standard deviations only")
    sigma, mean = np.sqrt(np.diag(P)), setup.prior.mean
    return {
        "camera_to_body": {"R": rotation(setup.rotation), "T": np.array(setup.translation)[:, None] / CM},
        "landmark": {"xpos": setup.corners[..., 0] / CM, "ypos": setup.corners[..., 1] / CM},
        "pose_init": {
            "x0": mean[0] / CM,
            "y0": mean[1] / CM,
            "theta0": math.degrees(mean[2]),
            "sigma_x": sigma[0] / CM,
            "sigma_y": sigma[1] / CM,
            "sigma_theta": math.degrees(sigma[2]),
        },
    }

"""SQUARE files of samples (`ensemble_se3`): a particle a line, reduced to mean and covariance in the plane."""

from __future__ import annotations

import numpy as np

from data.errors import DataError
from data.results.lines import Text, lines_of, numbers, require_order
from data.results.path import WORLD, GivenPath, Manner, Outside
from data.results.space import Spatial, on_plane, rotations
from data.results.square import POSE, Header
from data.se2 import Array, wrap_angle

FEWEST = 4
"""Samples at an instant that a covariance of three numbers needs to have full rank."""


def read_samples(text: Text, header: Header, unit: float, manner: Manner) -> GivenPath:
    """Means and covariances of the particles at each stamp; heading by its circular mean, weights made to sum to 1."""
    weighted = header.one_of(text, "WEIGHTED", ("true", "false")) == "true"
    logarithmic = header.one_of(text, "WEIGHT_FORMAT", ("linear", "log")) == "log"
    columns = ("t", "particle", *(("weight",) if weighted else ()), *POSE[1:])
    rows = numbers(text, columns)
    time = rows[:, 0] * unit
    require_order(text, time)
    line, file = lines_of(text), str(text.path)

    def place(k: int) -> str:
        return f"line {line[k]}"

    first = 3 if weighted else 2
    R = rotations(rows[:, first + 3 :], file, place)
    stamps, start, count = np.unique(time, return_index=True, return_counts=True)
    # each particle on the plane by itself (the stamps of one instant made different), then their moments
    apart = Spatial(file, "", np.arange(len(rows), dtype=float), rows[:, first : first + 3], R, None, "", place)
    flat = on_plane(apart, Manner(axes=manner.axes))
    pose, covariance = np.empty((len(stamps), 3)), np.full((len(stamps), 3, 3), np.nan)
    for k, (i, n) in enumerate(zip(start.tolist(), count.tolist(), strict=True)):
        weight = np.full(n, 1.0 / n) if not weighted else rows[i : i + n, 2]
        if weighted and logarithmic:
            weight = np.exp(weight - weight.max())
        if weight.min() < 0.0 or not weight.sum() > 0.0:
            raise DataError.at(text.path, "weights of an instant must not be negative, nor all zero", line=line[i])
        pose[k], covariance[k] = _moments(flat.pose[i : i + n], weight / weight.sum())
    few = int((count < FEWEST).sum())
    covariance[count < FEWEST] = np.nan
    notes: tuple[str, ...] = (f"mean and covariance of {int(count.min())} to {int(count.max())} samples an instant",)
    if few:
        notes += (f"{few} instants have fewer than {FEWEST} samples, too few for a covariance",)
    outside: Outside | None = flat.outside
    return GivenPath(file, "SQUARE, ensemble_se3", stamps, pose, covariance, WORLD, outside, notes)


def _moments(pose: Array, weight: Array) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3), unbiased for weights that sum to 1."""
    heading = np.arctan2(weight @ np.sin(pose[:, 2]), weight @ np.cos(pose[:, 2]))
    mean = np.array([*(weight @ pose[:, :2]), heading])
    off = pose - mean
    off[:, 2] = wrap_angle(off[:, 2])
    spare = 1.0 - float(weight @ weight)
    return mean, (off * weight[:, None]).T @ off / spare if spare > 0.0 else np.full((3, 3), np.nan)

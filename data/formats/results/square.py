"""Headers and samples of SQUARE files of `smfeval`.

`#%KEY value` lines declare columns and tangent, in files of covariances, too; samples (`ensemble_se3`), a particle a
line, are reduced to mean and covariance in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data.errors import DataError
from data.formats.results.clock import STATED, Clock
from data.formats.results.path import LEFT, LOCAL, ROTATION, TRANSLATION, WORLD, GivenPath, Manner, Outside, Spatial
from data.formats.results.space import on_plane, rotations
from data.formats.results.text import Text, numbers, require_order
from data.se2 import Array, wrap_angle

POSE = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
CONVENTIONS = {"right_perturbation": LOCAL, "left_perturbation": LEFT}
ORDERS = {"translation_rotation": TRANSLATION, "rotation_translation": ROTATION}


@dataclass(frozen=True)
class Header:
    """Values of `#%KEY value` lines by key, each with its line."""

    values: dict[str, tuple[int, str]]

    def one_of(self, text: Text, key: str, allowed: tuple[str, ...]) -> str | None:
        """A value that must be one of a few; None if absent."""
        line, value = self.values.get(key, (0, ""))
        if key not in self.values:
            return None
        if value not in allowed:
            raise DataError.at(text.path, f"{key} {value!r}; one of {', '.join(allowed)} is needed", line=line)
        return value

    def text_of(self, key: str) -> str:
        """A value; empty if absent."""
        return self.values.get(key, (0, ""))[1]


def header_of(text: Text) -> Header:
    """The header, wherever its lines stand; empty where there is none."""
    found: dict[str, tuple[int, str]] = {}
    for line, comment in text.comments:
        if comment.startswith("#%"):
            key, _, value = comment[2:].strip().partition(" ")
            if key.upper() in found:
                raise DataError.at(text.path, f"{key} is stated twice; once is needed", line=line)
            found[key.upper()] = line, value.strip()
    return Header(found)


def tangent(text: Text, header: Header) -> tuple[str | None, str | None]:
    """Frame and order (`COV_ORDERS`) that a header declares."""
    convention = header.one_of(text, "TANGENT_CONVENTION", tuple(CONVENTIONS))
    order = header.one_of(text, "TANGENT_ORDER", tuple(ORDERS))
    return None if convention is None else CONVENTIONS[convention], None if order is None else ORDERS[order]


FEWEST = 4
"""Fewest samples at an instant for a covariance of full rank."""


def read_samples(text: Text, header: Header, unit: float, manner: Manner) -> GivenPath:
    """Means and covariances of the particles at each stamp; heading by circular mean, weights normalized."""
    weighted = header.one_of(text, "WEIGHTED", ("true", "false")) == "true"
    logarithmic = header.one_of(text, "WEIGHT_FORMAT", ("linear", "log")) == "log"
    columns = ("t", "particle", *(("weight",) if weighted else ()), *POSE[1:])
    rows = numbers(text, columns)
    sound = np.isfinite(rows).all(axis=1)
    dropped = int((~sound).sum())
    if not sound.any():
        raise DataError.at(text.path, "every sample has a NaN; at least one without is needed")
    time = rows[:, 0] * unit
    require_order(text, time)
    lines = np.array(text.line)[sound]
    rows, time = rows[sound], time[sound]
    file, first = str(text.path), 3 if weighted else 2

    def place(k: int) -> str:
        return f"{file}:{lines[k]}"

    R = rotations(rows[:, first + 3 :], place)
    stamps, start, count = np.unique(time, return_index=True, return_counts=True)
    # each particle is projected (with distinct stamps), then their moments are formed
    apart = Spatial(file, "", np.arange(len(rows), dtype=float), rows[:, first : first + 3], R, None, "", place)
    flat = on_plane(apart, Manner(axes=manner.axes))
    pose, covariance = np.empty((len(stamps), 3)), np.full((len(stamps), 3, 3), np.nan)
    for k, (i, n) in enumerate(zip(start.tolist(), count.tolist(), strict=True)):
        weight = np.full(n, 1.0 / n) if not weighted else rows[i : i + n, 2]
        if weighted and logarithmic:
            weight = np.exp(weight - weight.max())
        if weight.min() < 0.0 or not weight.sum() > 0.0:
            raise DataError(f"{place(i)}: weights of an instant must not be negative, nor all zero")
        pose[k], covariance[k] = _moments(flat.pose[i : i + n], weight / weight.sum())
    few = int((count < FEWEST).sum())
    covariance[count < FEWEST] = np.nan
    notes: tuple[str, ...] = (f"mean and covariance of {int(count.min())} to {int(count.max())} samples an instant",)
    if few:
        notes += (f"{few} instants have fewer than {FEWEST} samples, too few for a covariance",)
    if dropped:
        notes += (f"{dropped} samples with NaN are left out",)
    outside: Outside | None = flat.outside
    clock = Clock("s", STATED)
    return GivenPath(file, "SQUARE, ensemble_se3", stamps, pose, covariance, WORLD, outside, notes, clock)


def _moments(pose: Array, weight: Array) -> tuple[Array, Array]:
    """Mean (3,) and unbiased covariance (3, 3) for normalized weights."""
    heading = np.arctan2(weight @ np.sin(pose[:, 2]), weight @ np.cos(pose[:, 2]))
    mean = np.array([*(weight @ pose[:, :2]), heading])
    off = pose - mean
    off[:, 2] = wrap_angle(off[:, 2])
    spare = 1.0 - float(weight @ weight)
    return mean, (off * weight[:, None]).T @ off / spare if spare > 0.0 else np.full((3, 3), np.nan)

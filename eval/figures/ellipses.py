"""Ellipses that show a covariance: their outlines, how large they are, and those of a map or along a path, drawn."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from data.se2 import Array
from eval.figures.style import Series

SIGMAS = 3.0
"""Size of every ellipse; in the plane a 3 sigma ellipse holds 1 - exp(-9/2) = 98.89 % of a Gaussian."""
ELLIPSES_ALONG_PATH = 11
"""A number that shares no factor with a few laps, so that the ellipses of two laps do not fall on each other."""


def ellipses(mean: Array, covariance: Array, sigmas: float = SIGMAS, count: int = 48) -> Array:
    """Outlines (K, count, 2) of the ellipses (p - mean)' P^-1 (p - mean) = sigmas^2 for mean (K, 2), P (K, 2, 2).

    Negative eigenvalues (rounding) count as zero.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    axes = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    outline: Array = mean[:, None, :] + sigmas * circle @ np.swapaxes(axes, -1, -2)
    return outline


def longest_axis(covariance: Array) -> Array:
    """3 sigma semi-major axis [m] of covariances (K, 2, 2)."""
    largest = np.linalg.eigvalsh(covariance)[:, -1] if len(covariance) else np.empty(0)
    return np.asarray(SIGMAS * np.sqrt(np.maximum(largest, 0.0)))


def along_path(s: Series) -> tuple[Array, Array]:
    """Position (K, 2) and its covariance (K, 2, 2) at about ten places along the path."""
    t = s.trajectory
    usable = np.flatnonzero(np.isfinite(t.pose).all(axis=1) & np.isfinite(t.covariance).all(axis=(1, 2)))
    if len(usable) == 0:
        return np.empty((0, 2)), np.empty((0, 2, 2))
    steps = np.linspace(0, len(usable) - 1, ELLIPSES_ALONG_PATH + 1)[1:]
    places = usable[np.unique(np.round(steps).astype(int))]
    return t.pose[places, :2], t.covariance[places, :2, :2]


def draw_ellipses(ax: Axes, mean: Array, covariance: Array, colour: str, factor: float, order: float) -> None:
    """Ellipses of points (K, 2) with covariances (K, 2, 2), `factor` times as large, filled faintly."""
    if len(mean) == 0:
        return
    outline = ellipses(mean, covariance, SIGMAS * factor)
    ax.add_collection(PolyCollection(list(outline), facecolor=colour, edgecolor="none", alpha=0.16, zorder=order))
    ax.add_collection(PolyCollection(list(outline), facecolor="none", edgecolor=colour, linewidth=0.6, zorder=order))

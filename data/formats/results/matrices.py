"""Covariances of poses in space: full matrices or triangles, rows that are unknown, order of the tangent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from data.errors import DataError
from data.se2 import Array

ASYMMETRY = 1e-3
"""Largest difference of two mirrored entries, in products of the standard deviations; messages round to float32."""
SWAP = [3, 4, 5, 0, 1, 2]
"""From rotation first to translation first, and back."""


def full(entries: Array, place: Callable[[int], str]) -> tuple[Array, tuple[str, ...]]:
    """Symmetric matrices (n, d, d) from all d*d entries, row by row, and notes.

    A matrix with zeros in all of one triangle and not in the other is mirrored; DataError for any other asymmetric one.
    """
    n, d = len(entries), round(entries.shape[1] ** 0.5)
    M = entries.reshape(n, d, d).copy()
    i, j = np.triu_indices(d, 1)
    upper, lower = M[:, i, j], M[:, j, i]
    known = np.isfinite(upper).all(axis=1) & np.isfinite(lower).all(axis=1)
    only_upper = known & ~lower.any(axis=1) & upper.any(axis=1)
    only_lower = known & ~upper.any(axis=1) & lower.any(axis=1)
    M[only_upper] = np.triu(M[only_upper]) + np.triu(M[only_upper], 1).transpose(0, 2, 1)
    M[only_lower] = np.tril(M[only_lower]) + np.tril(M[only_lower], -1).transpose(0, 2, 1)
    sigma = np.sqrt(np.abs(np.einsum("nii->ni", M)))
    off = np.abs(M[:, i, j] - M[:, j, i]) > ASYMMETRY * sigma[:, i] * sigma[:, j] + 1e-15
    bad = np.flatnonzero(known & off.any(axis=1))
    if len(bad):
        k = int(bad[0])
        a, b = int(i[off[k]][0]), int(j[off[k]][0])
        pair = f"entries ({a + 1}, {b + 1}) = {M[k, a, b]:.4g} and ({b + 1}, {a + 1}) = {M[k, b, a]:.4g}"
        raise DataError(f"{place(k)}: covariance is not symmetric: {pair}; a symmetric one, or one triangle, is needed")
    notes = []
    for which, name in ((only_upper, "upper"), (only_lower, "lower")):
        if which.any():
            notes.append(f"{int(which.sum())} of {n} covariances have only their {name} triangle, which is mirrored")
    return 0.5 * (M + M.transpose(0, 2, 1)), tuple(notes)


VAGUE = {3: (1e8, 1e8, 1e2), 6: (1e8, 1e8, 1e8, 1e2, 1e2, 1e2)}
"""m² and rad², variances from which on an axis is unknown: drivers write 1e6 or 99999 for that."""


def known_only(C: Array) -> tuple[Array | None, tuple[str, ...]]:
    """Covariances (n, d, d), NaN where unknown: all NaN or zero, or -1 first (ROS); None if none is known; and notes.

    A single variance of NaN, -1, or as large as `VAGUE` is that of an unknown axis: its row and column become zero.
    """
    variance = np.einsum("nii->ni", C)
    lost = (variance[:, 0] == -1.0) | ~np.isfinite(variance).any(axis=1) | ~np.nan_to_num(C).any(axis=(1, 2))
    open_axes = ~np.isfinite(variance) | (variance == -1.0) | (variance >= VAGUE[C.shape[1]])
    found = np.where(open_axes[:, :, None] | open_axes[:, None, :], 0.0, C)
    lost |= ~np.isfinite(found).all(axis=(1, 2)) | ~found.any(axis=(1, 2))
    found[lost] = np.nan
    notes = []
    if lost.any():
        notes.append(f"{int(lost.sum())} of {len(C)} poses state no covariance (NaN, zeros or -1)")
    partly = int((open_axes.any(axis=1) & ~lost).sum())
    if partly:
        notes.append(f"{partly} of {len(C)} covariances have an axis of unknown variance (NaN, -1 or huge)")
    return (None if lost.all() else found), tuple(notes)


def translation_first(C: Array) -> Array:
    """Covariances (n, 6, 6) of rotation-first tangents with the translation first."""
    return np.asarray(C[:, SWAP][:, :, SWAP])

"""Fixes and closures as rows of a linearized smoothing problem, with the effect of hypothetical errors on them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.inputs import Inputs, IntArray
from data.pose_measurements import MEASURED, FixKind, expected_closure, expected_fix
from data.se2 import Array, BoolArray, wrap_angle


class OfPoses(NamedTuple):
    """Fixes (F,) and closures (K,) besides the observations: which are used, and their derivatives by each error."""

    fixes: BoolArray  # (F,) used
    by_fixes: Array  # (F, 3, p) of z, by entry of (x, y, theta)
    closures: BoolArray  # (K,) used
    by_closures: Array  # (K, 3, p) of the relative pose


class Blocks(NamedTuple):
    """Blocks of rows for an elimination, as of `Rows`."""

    variable: IntArray
    A: Array
    b: Array
    height: IntArray


def blocks_of_poses(inputs: Inputs, path: Array, of: OfPoses) -> Blocks:
    """Whitened rows of the used fixes and closures at a path (N, 3): residual, and minus the effect of each error."""
    fixes, closures = inputs.fixes, inputs.closures
    some = np.flatnonzero(of.fixes) if fixes is not None else np.empty(0, np.int64)
    pairs = np.flatnonzero(of.closures) if closures is not None else np.empty(0, np.int64)
    p = of.by_fixes.shape[2]
    count = len(some) + len(pairs)
    found = Blocks(
        np.full((count, 2), -1), np.zeros((count, 3, 6)), np.zeros((count, 3, 1 + p)), np.zeros(count, np.int64)
    )
    for at, i in enumerate(some.tolist()):
        assert fixes is not None
        kind, frame = FixKind(int(fixes.kind[i])), int(fixes.frame[i])
        entries = list(MEASURED[kind])
        z_hat, H = expected_fix(path[frame], kind, fixes.sources[int(fixes.source[i])])
        nu = fixes.z[i][entries] - z_hat
        if kind != FixKind.POSITION:
            nu[-1] = wrap_angle(float(nu[-1]))
        root, d = np.linalg.inv(np.linalg.cholesky(fixes.covariance[i][np.ix_(entries, entries)])), len(entries)
        found.variable[at, 0], found.height[at] = frame, d
        found.A[at, :d, :3], found.b[at, :d, 0] = root @ H, root @ nu
        found.b[at, :d, 1:] = -root @ of.by_fixes[i][entries]
    for at, i in enumerate(pairs.tolist(), len(some)):
        assert closures is not None
        a, b = int(closures.frame1[i]), int(closures.frame2[i])
        z_hat, H1, H2 = expected_closure(path[a], path[b])
        nu = closures.relative[i] - z_hat
        nu[2] = wrap_angle(float(nu[2]))
        root = np.linalg.inv(np.linalg.cholesky(closures.covariance[i]))
        found.variable[at], found.height[at] = (a, b), 3
        found.A[at, :, :3], found.A[at, :, 3:], found.b[at, :, 0] = root @ H1, root @ H2, root @ nu
        found.b[at, :, 1:] = -root @ of.by_closures[i]
    return found

"""Increments with systematic errors, linearized, and how far the linear residuals are from the exact ones.

As linear functions of logarithms of the poses since they were linearized they are exact for rigid motions of both: with
u how far the pose has moved (seen from the one after) and v by how much more the one after has, the exact residual is
R Log(Exp(-u) Exp(u + v)) = R (v + [v, u] / 2 + ...). What is left out is of second order, in v and u or in the errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from data.inputs import IntArray
from data.se2 import Array, compose, inverse
from graph.linear.increments import linearize_increments


class Linear(NamedTuple):
    """Whitened residuals of increments (n), linear in logarithms of both poses and in the errors.

    residual (n, 3) + before Log(pose[:, 0]^-1 X) + after Log(pose[:, 1]^-1 Y) + by_errors b; errors b count from zero.
    """

    pose: Array
    residual: Array
    before: Array
    after: Array
    by_errors: Array

    def at(self, pose: Array, errors: Array) -> Array:
        """Residuals (n, 3) for poses (n, 2, 3) and errors (n, p)."""
        moved = [log(compose(inverse(self.pose[:, i]), pose[:, i])) for i in range(2)]
        change = np.einsum("nij,nj->ni", self.before, moved[0]) + np.einsum("nij,nj->ni", self.after, moved[1])
        found: Array = self.residual + change + np.einsum("nip,np->ni", self.by_errors, errors)
        return found

    def rows(self, which: IntArray) -> Linear:
        """Some of them."""
        return Linear(*(each[which] for each in self))


def linearize(mean: Array, root: Array, errors: Array, path: Array, place: IntArray, mount: Array) -> Linear:
    """Consecutive increments (n, 3) at poses (n + 1, 3) and errors (n, p); root (n, 3, 3) of odometry's information."""
    n, p = errors.shape
    residual, before, after = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3))
    by_errors = np.empty((n, 3, p))
    # copies: for arrays that cannot be written to the kernel would be compiled once more
    poses, motion, roots, b = (np.array(a, float, order="C") for a in (path, mean, root, errors))
    linearize_increments(poses, motion, roots, b, place, np.array(mount, float), residual, before, after, by_errors)
    residual -= np.einsum("nip,np->ni", by_errors, errors)
    return Linear(np.stack([path[:-1], path[1:]], 1), residual, before, after, by_errors)


@numba.njit(cache=True)
def _log(pose, out):  # type: ignore[no-untyped-def]
    for k in range(len(pose)):
        half = 0.5 * pose[k, 2]
        a = 1.0 - half * half / 3.0 if abs(half) < 1e-4 else half / np.tan(half)
        out[k, 0] = a * pose[k, 0] + half * pose[k, 1]
        out[k, 1] = a * pose[k, 1] - half * pose[k, 0]
        out[k, 2] = pose[k, 2]


def log(pose: Array) -> Array:
    """Logarithms (n, 3) of poses (n, 3), body frame."""
    out = np.empty_like(pose)
    _log(pose, out)
    return out

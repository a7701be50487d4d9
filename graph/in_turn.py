"""Fixes and closures of a frame, tested one after another on the joint Gaussian of the poses that they measure.

Each one inside the gate updates the few poses, as in a filter, before the next one is tested. A smoother then adds the
accepted ones to its graph at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from association.expectation import gate_threshold
from data.inputs import IntArray
from data.pose_measurements import (
    MEASURED,
    FixKind,
    FixSource,
    FrameClosures,
    FrameFixes,
    PoseUpdated,
    expected_closure,
    expected_fix,
    not_used,
)
from data.se2 import Array, wrap_angle

Expected = Callable[[Array], tuple[Array, Array]]
"""Expected measurement (d,) of the poses (q,), and its Jacobian (d, q)."""


class Measured(NamedTuple):
    """One measurement of some poses."""

    entries: tuple[int, ...]  # measured ones (d,) of x, y, theta
    z: Array  # (d,)
    R: Array  # (d, d)
    expected: Expected


def in_turn(mean: Array, P: Array, measured: Sequence[Measured | None], gate: float | None) -> PoseUpdated:
    """Test measurements (f,) of poses with mean (q,) and covariance P (q, q), world frame; None: it cannot be used."""
    done = not_used([3 if m is None else len(m.entries) for m in measured])
    for i, m in enumerate(measured):
        if m is None:
            continue
        z_hat, H = m.expected(mean)
        nu = m.z - z_hat
        if m.entries[-1] == 2:
            nu[-1] = wrap_angle(float(nu[-1]))
        S = H @ P @ H.T + m.R
        L = np.linalg.cholesky(S)
        white = np.linalg.solve(L, nu)
        done.nis[i] = white @ white
        done.white[i, list(m.entries)] = white
        done.S[i][np.ix_(m.entries, m.entries)] = S
        done.used[i] = done.nis[i] < gate_threshold(gate, len(m.entries))
        if done.used[i]:
            W = np.linalg.solve(L, H @ P)
            mean, P = mean + W.T @ white, P - W.T @ W
    return done


def fixes_of(fixes: FrameFixes, sources: tuple[FixSource, ...]) -> list[Measured]:
    """The fixes (f) of a frame as measurements of its pose."""
    found = []
    for kind, source, z, C in zip(fixes.kind.tolist(), fixes.source.tolist(), fixes.z, fixes.covariance, strict=True):
        entries = MEASURED[FixKind(kind)]
        rows = list(entries)

        def expected(pose: Array, kind: int = kind, source: int = source) -> tuple[Array, Array]:
            return expected_fix(pose, kind, sources[source])

        found.append(Measured(entries, z[rows], C[np.ix_(rows, rows)], expected))
    return found


def closures_of(closures: FrameClosures, frames: IntArray) -> list[Measured | None]:
    """The closures (c) of a frame as measurements of the poses of `frames` (k,), stacked; None: a frame is missing."""
    place = {frame: 3 * i for i, frame in enumerate(frames.tolist())}
    found = list[Measured | None]()
    ends = zip(closures.frame1.tolist(), closures.frame2.tolist(), closures.relative, closures.covariance, strict=True)
    for first, second, relative, C in ends:
        if first not in place or second not in place:
            found.append(None)
            continue

        def expected(poses: Array, a: int = place[first], b: int = place[second]) -> tuple[Array, Array]:
            z_hat, H1, H2 = expected_closure(poses[a : a + 3], poses[b : b + 3])
            H = np.zeros((3, len(poses)))
            H[:, a : a + 3], H[:, b : b + 3] = H1, H2
            return z_hat, H

        found.append(Measured((0, 1, 2), relative, C, expected))
    return found

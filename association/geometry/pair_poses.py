"""Poses from pairs: two observations and two landmarks as far apart from each other give the pose of a frame.

They need no linearization, and no start. Each pose is judged by what else it pairs, as in
`association.geometry.relocalize`, but only where a motion allows it; poses that pair alike are one.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from association.evidence import constants
from association.expectation import Expectation, gate_threshold
from association.geometry.relocalize import distance_sigmas
from data.blocks import block_diagonal
from data.inputs import IntArray
from data.se2 import Array
from data.sensors import Sensor


def candidates(e: Expectation, sensor: Sensor, motion: Array) -> list[tuple[float, IntArray]]:
    """Different pairings (m,), candidate of each observation or -1, that poses allowed by the motion make.

    Each with its squared distance from the predicted motion; those with most pairs first, `FRAME_PAIRINGS` at most.
    """
    seen, R = sensor.body_points(e.z, e.R)
    there, _, G = sensor.inverse(np.zeros(3), e.z_hat)
    every = np.arange(len(there))
    variance = np.trace(R, axis1=1, axis2=2)
    surest = np.sort(np.argsort(variance, kind="stable")[: constants.FRAME_POINTS])
    pairings, d2, count = _poses(
        seen, np.sqrt(variance), distance_sigmas(seen, block_diagonal(R)), surest,
        there, distance_sigmas(there, block_diagonal(G) @ e.joint(every) @ block_diagonal(G).T),
        np.linalg.inv(motion), gate_threshold(constants.MOTION_GATE, 3),
        constants.DISTANCE_SIGMAS, constants.LONG_PAIR, constants.PLACE_PAIRINGS, constants.FRAME_POSES,
    )  # fmt: skip
    kept: list[tuple[float, IntArray]] = []
    for c in np.lexsort((d2[:count], -(pairings[:count] >= 0).sum(axis=1))).tolist():
        choice = pairings[c]
        paired = choice >= 0
        if all((k[paired] == choice[paired]).sum() <= constants.FRAME_ALIKE * paired.sum() for _, k in kept):
            kept.append((float(d2[c]), choice))
        if len(kept) == constants.FRAME_PAIRINGS:
            break
    return kept


@numba.njit(cache=True)
def _poses(  # type: ignore[no-untyped-def]
    seen, sigma, seen_sigma, surest, there, there_sigma, information, threshold, sigmas, long, fewest, kept
):  # fmt: skip
    """Poses (x, y, a) with there = R(a) seen + (x, y) that two pairs of points give, and what they pair.

    seen (m, 2) of standard deviations (m,), seen_sigma (m, m) those of their distances; there (n, 2), there_sigma
    (n, n). Of the observations `surest` pairs at least `long` times as far apart as the farthest. Returns the pairings
    (kept, m), nearest within `sigmas` or -1, the squared distance (kept,) of each pose by `information`
    (3, 3), which is below `threshold`, and how many there are, of at least `fewest` pairs each.
    """
    m, n = len(seen), len(there)
    pairings, distance, count = np.full((kept, m), -1, np.int64), np.empty(kept), 0
    longest, free = 0.0, np.ones(n, np.bool_)
    for i in surest:
        for j in surest:
            longest = max(longest, math.hypot(seen[i, 0] - seen[j, 0], seen[i, 1] - seen[j, 1]))
    for i in surest:
        for j in surest:
            dx, dy = seen[j, 0] - seen[i, 0], seen[j, 1] - seen[i, 1]
            d = math.hypot(dx, dy)
            if j <= i or d < long * longest or d == 0.0:
                continue
            for a in range(n):
                for b in range(n):
                    ex, ey = there[b, 0] - there[a, 0], there[b, 1] - there[a, 1]
                    tolerance = sigmas * math.sqrt(seen_sigma[i, j] ** 2 + there_sigma[a, b] ** 2)
                    if a == b or abs(math.hypot(ex, ey) - d) > tolerance:
                        continue
                    angle = math.atan2(dx * ey - dy * ex, dx * ex + dy * ey)
                    c, s = math.cos(angle), math.sin(angle)
                    mx, my = 0.5 * (seen[i, 0] + seen[j, 0]), 0.5 * (seen[i, 1] + seen[j, 1])
                    x = 0.5 * (there[a, 0] + there[b, 0]) - (c * mx - s * my)
                    y = 0.5 * (there[a, 1] + there[b, 1]) - (s * mx + c * my)
                    pose = np.array([x, y, angle])
                    d2 = pose @ information @ pose
                    if d2 > threshold:
                        continue
                    paired = 0
                    free[:] = True
                    for k in range(m):
                        px, py = c * seen[k, 0] - s * seen[k, 1] + x, s * seen[k, 0] + c * seen[k, 1] + y
                        # the heading is as uncertain as the two points are, across, at their distance
                        lever = math.hypot(seen[k, 0] - mx, seen[k, 1] - my) / d
                        own = there_sigma[a, b] ** 2 + sigma[i] ** 2 + sigma[j] ** 2
                        nearest = sigmas**2 * (sigma[k] ** 2 + own * (0.5 + lever * lever))
                        pairings[count, k] = -1
                        for o in range(n):
                            ox, oy = there[o, 0] - px, there[o, 1] - py
                            if free[o] and ox * ox + oy * oy < nearest:
                                nearest = ox * ox + oy * oy
                                pairings[count, k] = o
                        if pairings[count, k] >= 0:
                            free[pairings[count, k]] = False
                            paired += 1
                    if paired < fewest:
                        continue
                    distance[count] = d2
                    count += 1
                    if count == kept:
                        return pairings, distance, count
    return pairings, distance, count

"""Simulated pose graphs: a robot in a grid of corridors that closes loops, and false loop closures to add."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.se2 import between, compose

SIGMA_CHAIN = np.array([0.02, 0.02, 0.004])
SIGMA_LOOP = np.array([0.03, 0.03, 0.006])


class World(NamedTuple):
    """True key poses (K, 3); chain motion (K, 3), covariance (K, 3, 3), row 0 zero; loops as `Loops` has them."""

    truth: np.ndarray
    motion: np.ndarray
    covariance: np.ndarray
    key1: np.ndarray
    key2: np.ndarray
    relative: np.ndarray
    loop_covariance: np.ndarray

    def with_loops(self, key1, key2, relative) -> World:
        """More loops, with the first one's covariance; in the order of their later key."""
        key1, key2 = np.concatenate([self.key1, key1]), np.concatenate([self.key2, key2])
        relative = np.concatenate([self.relative, relative])
        C = np.concatenate(
            [self.loop_covariance, np.tile(self.loop_covariance[:1], (len(key1) - len(self.key1), 1, 1))]
        )
        order = np.argsort(key2, kind="stable")
        return self._replace(key1=key1[order], key2=key2[order], relative=relative[order], loop_covariance=C[order])


def corridors(seed, keys=300, *, loops=100, drift=1.0, side=6.0, step=0.5, blocks=5):
    """A walk on a grid of corridors `side` m apart, a key every `step` m; loops between keys near and alike in heading."""
    rng = np.random.default_rng(seed)
    at, facing = np.array([0, 0]), 0
    path, way = [], np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    while len(path) < keys:
        turns = [
            t
            for t in (0, 1, 3)
            if ((at + way[(facing + t) % 4]) >= 0).all() and ((at + way[(facing + t) % 4]) <= blocks).all()
        ]
        facing = (facing + int(rng.choice(turns))) % 4
        for i in range(round(side / step)):
            p = side * at + step * i * way[facing]
            path.append([p[0], p[1], np.pi / 2 * facing])
        at = at + way[facing]
    truth = np.array(path[:keys], float)
    truth[1:] += rng.normal(0, [0.1, 0.1, 0.05], (keys - 1, 3))
    truth[:, 2] = np.angle(np.exp(1j * truth[:, 2]))
    motion, covariance = np.zeros((keys, 3)), np.zeros((keys, 3, 3))
    covariance[1:] = np.diag((drift * SIGMA_CHAIN) ** 2)
    motion[1:] = between(truth[:-1], truth[1:]) + rng.normal(0, drift * SIGMA_CHAIN, (keys - 1, 3))
    gap = np.hypot(*(truth[:, None, :2] - truth[None, :, :2]).transpose(2, 0, 1))
    a, b = np.nonzero((gap < 1.0) & (np.arange(keys)[None] - np.arange(keys)[:, None] > 20))
    pick = np.sort(rng.choice(len(a), min(loops, len(a)), replace=False)) if len(a) else np.empty(0, int)
    order = pick[np.argsort(b[pick], kind="stable")]
    a, b = a[order], b[order]
    relative = between(truth[a], truth[b]) + rng.normal(0, SIGMA_LOOP, (len(a), 3))
    return World(truth, motion, covariance, a, b, relative, np.tile(np.diag(SIGMA_LOOP**2), (len(a), 1, 1)))


def random_false(world, rng, count):
    """Loops between keys anywhere, as if the two places were one."""
    keys = len(world.truth)
    a = rng.integers(0, keys - 30, count)
    b = np.array([rng.integers(i + 20, keys) for i in a])
    return a, b, rng.normal(0, [0.5, 0.5, 0.3], (count, 3))


def structured_false(world, rng, count, group=5, apart=8.0):
    """Groups of loops that agree with each other: a stretch of corridor taken for another like it, at most `apart` m off."""
    keys, a, b, relative = len(world.truth), [], [], []
    p = world.truth
    while len(a) < count:
        i, j = int(rng.integers(0, keys - group)), int(rng.integers(0, keys - group))
        gap, turn = np.hypot(*(p[i] - p[j])[:2]), np.cos(p[i, 2] - p[j, 2])
        if not (j > i + 20 and 2.0 < gap < apart and turn > 0.9):
            continue
        shift = rng.normal(0, [0.3, 0.3, 0.05])  # where the second stretch seems to begin, seen from the first one
        for k in range(min(group, count - len(a))):
            second = compose(shift, between(p[j], p[j + k]))
            first = between(p[i], p[i + k])
            a.append(i + k)
            b.append(j + k)
            relative.append(between(first, second) + rng.normal(0, SIGMA_LOOP))
    return np.array(a), np.array(b), np.array(relative)

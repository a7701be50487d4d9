"""Simulated pose graphs: a robot in a grid of corridors that closes loops, and false loop closures to add."""

from typing import NamedTuple

import numpy as np

from data.inputs import Increments, Inputs, Observations, Prior
from data.pose_measurements import Closures
from data.se2 import between, compose, wrap_angle
from data.sensors import RangeBearing
from graph.batch import gnc, smooth
from graph.problem import Start

SIGMA_CHAIN = np.array([0.02, 0.02, 0.004])
SIGMA_LOOP = np.array([0.03, 0.03, 0.006])
EXACT = np.zeros((3, 3))
NONE = np.empty(0, np.int64)
WAY = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


class World(NamedTuple):
    """True key poses (K, 3); chain motion (K, 3), covariance (K, 3, 3), row 0 zero; loops as `Loops` has them."""

    truth: np.ndarray
    motion: np.ndarray
    covariance: np.ndarray
    key1: np.ndarray
    key2: np.ndarray
    relative: np.ndarray
    loop_covariance: np.ndarray

    def prior(self, covariance=EXACT):
        return Prior(self.truth[0], covariance)

    def inputs(self, covariance=EXACT):
        """Key poses as frames without observations, loops as closures by their later key pose."""
        order = np.argsort(np.maximum(self.key1, self.key2), kind="stable")
        ends = self.key1[order].astype(np.int64), self.key2[order].astype(np.int64)
        loops = Closures(
            *ends, self.relative[order], self.loop_covariance[order], np.zeros(len(order), np.int64), ("loop",)
        )
        nothing = Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))
        steps = Increments(self.motion, self.covariance)
        time = np.arange(float(len(self.truth)))
        return Inputs(
            self.prior(covariance), time, steps, nothing, RangeBearing(), closures=loops if len(order) else None
        )

    def optimum(self, start, covariance=EXACT, loss="gaussian"):
        return smooth(self.inputs(covariance), NONE, NONE, Start(start, np.zeros((0, 2))), loss=loss)

    def graduated(self, start, covariance=EXACT):
        """The same by graduated non-convexity, and which loops it uses, in their order here."""
        found, _ = gnc(self.inputs(covariance), NONE, NONE, Start(start, np.zeros((0, 2))))
        used = np.empty(len(self.key1), bool)
        used[np.argsort(np.maximum(self.key1, self.key2), kind="stable")] = found.closures.used
        return found, used

    def of(self, key):
        rows = self.key2 == key
        return self.key1[rows], self.key2[rows], self.relative[rows], self.loop_covariance[rows]

    def with_loops(self, key1, key2, relative):
        """More loops behind these, with the first one's covariance."""
        more = zip(self[3:], (key1, key2, relative, np.tile(self.loop_covariance[:1], (len(key1), 1, 1))))
        return World(*self[:3], *(np.concatenate(both) for both in more))

    def rmse(self, pose):
        return float(np.sqrt(((pose - self.truth)[:, :2] ** 2).sum(1).mean()))


def corridors(seed, keys=300, *, loops=100, drift=1.0, side=6.0, step=0.5, blocks=5):
    """A walk on a grid of corridors `side` m apart, a key every `step` m; loops between keys less than 1 m apart."""
    rng = np.random.default_rng(seed)
    at, facing = np.array([0, 0]), 0
    path = []
    while len(path) < keys:
        ahead = [at + WAY[(facing + t) % 4] for t in (0, 1, 3)]
        turns = [t for t, to in zip((0, 1, 3), ahead) if (to >= 0).all() and (to <= blocks).all()]
        facing = (facing + int(rng.choice(turns))) % 4
        path += [[*(side * at + step * i * WAY[facing]), np.pi / 2 * facing] for i in range(round(side / step))]
        at = at + WAY[facing]
    truth = np.array(path[:keys], float)
    truth[1:] += rng.normal(0, [0.1, 0.1, 0.05], (keys - 1, 3))
    truth[:, 2] = wrap_angle(truth[:, 2])
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
    return a, np.array([rng.integers(i + 20, keys) for i in a]), rng.normal(0, [0.5, 0.5, 0.3], (count, 3))


def structured_false(world, rng, count, group=5, apart=8.0):
    """Groups of loops that agree with each other: a stretch of corridor taken for another like it, `apart` m off."""
    p, a, b, relative = world.truth, [], [], []
    while len(a) < count:
        i, j = rng.integers(0, len(p) - group, 2).tolist()
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

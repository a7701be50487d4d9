"""Observer of a replay for the player: landmarks over time, candidates, and decisions of all methods.

Only visible changes of a landmark are kept: the mean, or an end of the 3 sigma ellipse, moved by more than half a
quantum. A filter gives its map after each frame with observations. A smoother gives means only: its marginals take a
tenth of a second a frame in a corridor, and change its bookkeeping.
"""

import time
from dataclasses import dataclass

import numpy as np

from association.expectation import Expectation, SingularInnovationError, gate_threshold
from association.names import METHODS
from data.inputs import Frame, Inputs, IntArray
from data.locked import read_only
from data.result import MapState
from data.se2 import Array, dead_reckoned
from ekf.filter import Filter
from ekf.slam import EkfSlam
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.recorder import Writing
from graph.incremental import Isam2Smoother

SIGMAS = 3.0
FINEST, COARSEST = 1.0e-3, 1.0e-1  # m
SHARE = 1.0e-4  # Quantum over the path's extent, 1/5 pixel on a large screen: 1 mm in a corridor, 1 cm in a park
LOOKED_AT = 0.99999  # candidates inside this gate are kept, ...
MOST = 12  # ... at most this many; the nearest and the paired one always
LARGE, SELDOM = 300, 10  # a map with more landmarks is recorded only every few frames: recording costs as long as using
READ = 30_000  # positions taken from a smoother in all, each 10 to 20 microseconds
LONG = 2000  # frames; in a longer log with labels, other methods would take longer than the run
NOT_ASKED, SINGULAR = -3, -4  # in place of a decision: not computed, or the covariance is singular


def quantum_of(inputs: Inputs) -> float:
    """Visible size [m]: a power of ten, for the extent of the path by dead reckoning."""
    extent = float(np.ptp(dead_reckoned(inputs.prior.mean, inputs.increments.mean)[:, :2], axis=0).max(initial=0.0))
    return float(np.clip(10.0 ** np.floor(np.log10(max(SHARE * extent, FINEST))), FINEST, COARSEST))


@dataclass(frozen=True, eq=False)
class Watched:
    """The recording; rho is the correlation of x and y."""

    quantum: float  # m; smaller changes are left out
    every: int  # landmarks were recorded after this many frames with observations; 0: never
    covariances: bool  # with their covariances; else their sigmas are zero
    changes: Array  # (C, 8) of landmarks: frame, number, there (0: it left the map), x, y [m], sigmas, rho in the world
    seen: Array  # (K, 7) candidates of some observation: frame, number, x, y [m], sigmas, rho expected by the robot
    pairs: Array  # (P, 3) observation (row of the log), candidate, squared Mahalanobis distance
    methods: tuple[str, ...]  # W names
    method_decisions: IntArray  # (M, W) decisions from the same expectation

    def __post_init__(self) -> None:
        read_only(self)


class MapChanges:
    """Visible changes of a map since the last call."""

    def __init__(self, quantum: float) -> None:
        """Start with an empty map; `quantum` as in `Watched`."""
        self._quantum = quantum
        self._last = np.full((0, 5), np.nan)

    def since(self, frame: int, state: MapState, *, whole: bool = False) -> Array:
        """Changes (C, 8) up to a frame: frame, number, there, then x, y, sigma_x, sigma_y, rho. A landmark that left
        the map is not `there`, and keeps its last place. `whole`: all landmarks have changed.
        """
        now = np.column_stack([state.xy, spread(state.covariance)])
        sound = np.isfinite(now).all(axis=1)
        now, present = now[sound], state.number[sound]
        more = int(np.max(present, initial=-1)) + 1 - len(self._last)
        if more > 0:
            self._last = np.concatenate([self._last, np.full((more, 5), np.nan)])
        before = self._last[present]
        moved = np.abs(now[:, :2] - before[:, :2]).max(axis=1)
        widened = SIGMAS * np.abs(now[:, 2:4] - before[:, 2:4]).max(axis=1)
        turned = SIGMAS * now[:, 2:4].max(axis=1) * np.abs(now[:, 4] - before[:, 4])
        small = np.maximum(np.maximum(moved, widened), turned) <= 0.5 * self._quantum  # false with NaN: a new one
        small &= not whole
        changed, number = now[~small], present[~small]
        self._last[number] = changed
        absent = np.isfinite(self._last[:, 0])
        absent[present] = False
        left = np.flatnonzero(absent)
        here = np.column_stack([np.full(len(number), frame), number, np.ones(len(number)), changed])
        away = np.column_stack([np.full(len(left), frame), left, np.zeros(len(left)), self._last[left]])
        self._last[left] = np.nan
        return np.concatenate([here, away])


class Watch(Writing):
    """Observer of a replay with a `Watched`."""

    def __init__(self, inputs: Inputs) -> None:
        self.quantum, self.sensor, self.seconds = quantum_of(inputs), inputs.sensor, 0.0
        self._frames, self._seeing = len(inputs), int((np.diff(inputs.start) > 0).sum())
        self._every, self._since, self._looked, self._covariances = 0, 0, -1, True
        self._map = MapChanges(self.quantum)
        self._changes: list[Array] = []
        self._seen: list[Array] = []
        self._pairs: list[Array] = []
        self._methods = np.full((len(inputs.observations.frame), len(METHODS)), NOT_ASKED, np.int64)

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """Record candidates, distances and every method's decisions, where the expectation has no side effects."""
        begin = time.perf_counter()
        self._looked = front.k
        e = pairing.expectation
        # a filter's expectation has no side effects, except for parked landmarks
        parked = "park" in front.can and len(front.can["park"].parked) > 0
        if e is None and isinstance(front.estimator, Filter) and not parked:
            e = front.expect(frame.observations, frame.appearance)
        if e is not None and len(e.number):
            try:
                self._compare(front, frame, e.by_age(), pairing.decisions)
            except SingularInnovationError:
                self._methods[frame.first : frame.first + len(e.z)] = SINGULAR
        self.seconds += time.perf_counter() - begin

    def _compare(self, front: FrontEnd, frame: Frame, e: Expectation, decisions: IntArray) -> None:
        d2 = e.individual_distances()
        rank = d2.argsort(axis=1, kind="stable").argsort(axis=1, kind="stable")
        kept = (rank == 0) | ((d2 < gate_threshold(LOOKED_AT)) & (rank < MOST))
        kept |= e.number[None, :] == decisions[:, None]
        kept &= np.isfinite(d2)
        i, j = np.nonzero(kept)
        self._pairs.append(np.column_stack([frame.first + i, e.number[j], d2[i, j]]))
        some = np.flatnonzero(kept.any(axis=0))
        xy, P = self.sensor.body_points(e.z_hat[some], e.HPHt[some])
        self._seen.append(np.column_stack([np.full(len(some), frame.number), e.number[some], xy, spread(P)]))
        if front.known is not None and self._frames > LONG:
            return
        for w, name in enumerate(METHODS):
            rows = slice(frame.first, frame.first + len(decisions))
            try:
                self._methods[rows, w] = front.decide(e, name).decisions
            except SingularInnovationError:
                self._methods[rows, w] = SINGULAR

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """Record the landmarks after the frame."""
        begin, estimator = time.perf_counter(), front.estimator
        if isinstance(estimator, (EkfSlam, Isam2Smoother)) and front.slam:
            filters = isinstance(estimator, EkfSlam)
            size = estimator.created
            seldom = (SELDOM if size > LARGE else 1) if filters else 1 + size * self._seeing // READ
            self._every, self._covariances = max(self._every, seldom), filters
            self._since += self._looked == front.k
            if self._since >= seldom or front.k == self._frames - 1:
                self._since = 0
                state = map_now(estimator)
                state = state._replace(number=front.as_decided(state.number))
                self._changes.append(self._map.since(front.k, state))
        self.seconds += time.perf_counter() - begin

    def left(self) -> Watched:
        """The recording, after the last frame."""
        kept = ((self._changes, 8), (self._seen, 7), (self._pairs, 3))
        changes, seen, pairs = (np.concatenate([np.empty((0, columns)), *parts]) for parts, columns in kept)
        return Watched(self.quantum, self._every, self._covariances, changes, seen, pairs, METHODS, self._methods)


def spread(covariance: Array) -> Array:
    """(sigma_x, sigma_y, rho) (n, 3) of covariances whose first two coordinates are x and y."""
    sigma = np.sqrt(np.maximum(covariance[:, [0, 1], [0, 1]], 0.0))
    product = sigma[:, 0] * sigma[:, 1]
    rho = np.divide(covariance[:, 0, 1], product, out=np.zeros(len(sigma)), where=product > 0.0)
    return np.column_stack([sigma, np.clip(rho, -1.0, 1.0)])


def map_now(estimator: EkfSlam | Isam2Smoother) -> MapState:
    """The current landmarks without side effects; of a smoother without covariances."""
    if isinstance(estimator, EkfSlam):
        return estimator.landmarks()
    smoother, number = estimator, estimator.numbers
    return MapState(number, smoother.positions(number), np.zeros((len(number), 2, 2)))

"""gtsam's iSAM2 with recovery: QR where Cholesky fails, and the name of an undetermined variable; marginalization."""

import copy
import re
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L

from data.se2 import Array
from graph.factors import Factor, UnderConstrained, graph_of, name_of, pose_array
from graph.walls import lines_of, same_wall

Answer = TypeVar("Answer")
Thing = TypeVar("Thing")


def forked(thing: Thing) -> Thing:
    """A copy with lists, dictionaries, sets and arrays of its own, whose entries are shared."""
    other = copy.copy(thing)
    for name, value in vars(thing).items():
        if isinstance(value, (list, dict, set, array, np.ndarray)):
            setattr(other, name, copy.copy(value))
    return other


SIZES = {"x": 3, "l": 2}  # dimensions of poses and landmarks
WALL_SIZES = {"l": 3, "p": 2}  # dimensions of walls, and of the points of the robot that they are observed from

FURTHER = 4.0
"""In thresholds: relinearization threshold of variables with almost linear factors; a quarter or five times of it gives
the same accuracy and time on Victoria Park."""
WILDFIRE = 0.2  # in thresholds: a smaller change is not propagated further back into the past
JUMP = 10.0  # in thresholds: where an update moves the newest pose further (loop closure), another one follows, ...
EXTRA = 5  # ... at most this many times


class Engine:
    """An ISAM2 object with stable handles on its factors.

    An ISAM2 object is unusable after `Indeterminate linear system`. Cholesky elimination raises it for problems that QR
    solves (information that differs by 1e10: a robot at rest). So QR takes over on request, or then.
    """

    def __init__(
        self, threshold: float, skip: int, *, qr: bool, name: Callable[[int], str] = name_of,
        linear: Mapping[str, int] | None = None, walls: bool = False,
    ) -> None:  # fmt: skip
        """`threshold` [m, rad]: variables that moved further are relinearized, every `skip`-th update: with 1 all, else
        the newest and those connected to one that moved. `name` names a key. `linear`: sizes of further variables
        with almost linear factors, by the character of their keys. `walls`: the landmarks are estimated walls.
        """
        self.threshold, self.skip, self.qr, self.name = threshold, skip, qr, name
        self.linear, self.walls = dict(linear or {}), walls
        self._sizes = {**SIZES, **(WALL_SIZES if walls else {}), **self.linear}
        self.reuses_slots = False  # gtsam puts factors in free slots, for which it searches all
        self._factors: dict[int, Factor] = {}  # by handle
        self._slot: dict[int, int] = {}
        self._next = 0
        self.isam = self._fresh()

    def _fresh(self) -> gtsam.ISAM2:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(self._thresholds() if self.linear else self.threshold)
        parameters.relinearizeSkip = self.skip
        # search only where the newest part of the tree moved: half the time, but the past may be outdated
        parameters.enablePartialRelinearizationCheck = self.skip > 1
        parameters.setFactorization("QR" if self.qr else "CHOLESKY")
        steps = gtsam.ISAM2GaussNewtonParams()
        steps.setWildfireThreshold(WILDFIRE * self.threshold)
        parameters.setOptimizationParams(steps)
        parameters.findUnusedFactorSlots = self.reuses_slots
        isam = gtsam.ISAM2(parameters)
        # while this reference exists, gtsam gives it to factors in Python instead of copies
        self.point = isam.getLinearizationPoint()
        return isam

    def fork(self, name: Callable[[int], str]) -> "Engine":
        """An independent copy, with the same factors; `name` as of `Engine`."""
        other = forked(self)
        other.name, other.isam = name, gtsam.ISAM2(self.isam)
        other.point = other.isam.getLinearizationPoint()
        return other

    def _thresholds(self) -> gtsam.ISAM2ThresholdMap:
        found = gtsam.ISAM2ThresholdMap()
        for kind, size in self._sizes.items():
            found.insert((kind, np.full(size, (FURTHER if kind in self.linear else 1.0) * self.threshold)))
        return found

    def add(self, factors: Sequence[Factor], values: gtsam.Values, last: Sequence[int] = ()) -> list[int]:
        """Add factors and start values of their new variables; returns a handle for each factor. `last`: variables that
        are eliminated last, so that their joint covariance is at the root of the tree.
        """
        return self._update(factors, values, [], last, [key for key in last if not values.exists(key)])

    def drop(self, handles: Sequence[int]) -> None:
        """Remove factors, and variables that lose their last one."""
        self._update([], gtsam.Values(), handles)

    def _update(
        self, factors: Sequence[Factor], values: gtsam.Values, handles: Sequence[int], last: Sequence[int] = (),
        again: Sequence[int] = (), *, every: bool = False,
    ) -> list[int]:  # fmt: skip
        """Add factors, remove those with the handles; new handles. `again`: eliminated anew, `every`: relinearized."""
        new, old = [self._keep(f) for f in factors], self._release(handles)
        order, keys = None, None
        if last:
            order, keys = gtsam.KeyGroupMap(), _key_list(again)
            for key in last:  # after all others
                order.insert2(key, 1)
        try:
            found = self.isam.update(graph_of(factors), values, old, order, None, keys, every)
        except RuntimeError as fault:
            self._recover(fault)
        else:
            self._slot.update(zip(new, found.getNewFactorsIndices(), strict=True))
        return new

    def _keep(self, factor: Factor) -> int:
        """A new handle on a factor; none is used again."""
        self._factors[self._next] = factor
        self._next += 1
        return self._next - 1

    def _release(self, handles: Sequence[int]) -> list[int]:
        for h in handles:
            del self._factors[h]
        return [self._slot.pop(h) for h in handles]

    def exchange(self, handle: int, factor: Factor) -> None:
        """Replace a factor by another one of the same variables. It costs an update with all factors."""
        self._factors[handle] = factor
        self._rebuild()

    def add_from(self, factors: Sequence[Factor], values: gtsam.Values) -> list[int]:
        """As `add`, with everything linearized again, at `values` where they name a variable."""
        handles = [self._keep(f) for f in factors]
        start = self.isam.calculateEstimate()
        start.insert_or_assign(values)
        self._rebuild(start)
        return handles

    def settle(self, key: int, before: gtsam.Pose2) -> gtsam.Pose2:
        """Estimate of the newest pose, after more updates if it jumped away from `before`."""
        pose = self._ask(lambda: self.isam.calculateEstimatePose2(key))
        for _ in range(EXTRA):
            if not self.jumped(before, pose):
                break
            before = pose
            self.update(key)
            pose = self._ask(lambda: self.isam.calculateEstimatePose2(key))
        return pose

    def jumped(self, before: gtsam.Pose2, pose: gtsam.Pose2, far: float = JUMP) -> bool:
        """Whether the newest pose moved by `far` thresholds, as after a loop closure."""
        return bool(np.abs(before.localCoordinates(pose)).max() >= far * self.threshold)

    def update(self, root: int | None = None) -> None:
        """One more step towards the optimum: relinearize all that moved further than the threshold.

        `root`: eliminate this variable last. The search for moved variables begins at the root of the tree and stops
        where nothing moved, so a jump deep in the tree would not be found.
        """
        self._update([], gtsam.Values(), [], [] if root is None else [root], every=True)

    def linearize_all(self, root: int) -> None:
        """One more step, with everything relinearized; `root` as of `update`."""
        parameters = self.isam.params()
        kept = self._thresholds() if self.linear else self.threshold
        parameters.setRelinearizeThreshold(0.0)
        self.update(root)
        parameters.setRelinearizeThreshold(kept)

    def use_qr(self) -> None:
        """Switch to QR, slower and safe."""
        if not self.qr:
            self.qr = True
            self._rebuild()

    def pose(self, key: int, joining: gtsam.Values | None = None) -> Array:
        """Estimate of a pose (3,), or its start value in `joining`."""
        if joining is not None and joining.exists(key):
            return pose_array(joining.atPose2(key))
        return pose_array(self._ask(lambda: self.isam.calculateEstimatePose2(key)))

    def points(self, numbers: Sequence[int]) -> Array:
        """Landmarks (n, 2): positions, or (rho, alpha) of walls."""
        if self.walls:
            return lines_of(self._poses(numbers))[0]
        found = self._ask(lambda: [self.isam.calculateEstimatePoint2(L(n)) for n in numbers])
        return np.array(found, float).reshape(-1, 2)

    def _poses(self, numbers: Sequence[int]) -> list[gtsam.Pose2]:
        """Walls as poses in the graph."""
        return self._ask(lambda: [self.isam.calculateEstimatePose2(L(n)) for n in numbers])

    def with_landmarks(self, keys: Sequence[int], numbers: Sequence[int]) -> Array:
        """Joint covariance of variables, poses in their body frames, and landmarks as of `points`."""
        J = self.covariance([*keys, *(L(n) for n in numbers)])
        if not self.walls:
            return J
        first = len(J) - 3 * len(numbers)
        T = np.zeros((first + 2 * len(numbers), len(J)))
        T[:first, :first] = np.eye(first)
        for i, each in enumerate(lines_of(self._poses(numbers))[1]):
            T[first + 2 * i : first + 2 * i + 2, first + 3 * i : first + 3 * i + 3] = each
        return T @ J @ T.T

    def vector(self, key: int) -> Array:
        """Estimate of a vector."""
        return np.asarray(self._ask(lambda: self.isam.calculateEstimateVector(key)), float)

    def newest(self, keys: Sequence[int]) -> tuple[Array, Array]:
        """Offset of variables from their linearization point (n,), and their joint covariance (n, n). Poses in their
        body frames. Variables next to the root of the tree need no search of the rest.
        """

        def found() -> tuple[Array, Array]:
            R, d = self.isam.jointBayesNet(keys, gtsam.EliminateQR).matrix()
            inverse = np.asarray(np.linalg.inv(R), float)
            return inverse @ np.ravel(d), inverse @ inverse.T

        return self._ask(found)

    def covariance(self, keys: Sequence[int]) -> Array:
        """Joint covariance of variables in the order given, poses in their body frames."""
        if len(keys) == 1:
            return np.asarray(self._ask(lambda: self.isam.marginalCovariance(keys[0])), float)
        if len(keys) == 2:
            return np.asarray(self._ask(lambda: self.isam.jointMarginalCovariance(keys).fullMatrix()), float)
        try:
            return np.asarray(self.isam.jointMarginalCovariance(keys).fullMatrix(), float)
        except RuntimeError as fault:
            self._free(fault)
        return self._in_parts(keys)

    def _in_parts(self, keys: Sequence[int]) -> Array:
        """The joint covariance of three or more variables from those of two thirds of them each: gtsam takes pivots of
        very different size for an indeterminate system in large joint marginals, even with QR.
        """
        size = np.array([self._sizes[chr(gtsam.symbolChr(k))] for k in keys])
        end = np.cumsum(size)
        whole = np.zeros((end[-1], end[-1]))
        for left_out in range(3):
            part = [i for i in range(len(keys)) if i % 3 != left_out]
            at = np.concatenate([np.arange(end[i] - size[i], end[i]) for i in part])
            whole[np.ix_(at, at)] = self.covariance([keys[i] for i in part])
        return whole

    def values(self) -> gtsam.Values:
        """The estimate of everything."""
        return self.isam.calculateEstimate()

    def _ask(self, question: Callable[[], Answer]) -> Answer:
        """Result of a query that needs the elimination; once more with QR if it fails."""
        try:
            return question()
        except RuntimeError as fault:
            self._recover(fault)
            return question()

    def _recover(self, fault: RuntimeError) -> None:
        """After a failed elimination: start again with QR, or report the undetermined variable."""
        undetermined = self._free(fault)
        if self.qr:
            raise undetermined from None
        self.qr = True
        self._rebuild()

    def _rebuild(self, values: gtsam.Values | None = None) -> None:
        """The same problem in a new ISAM2 object, at the present estimate or others."""
        values = self.isam.calculateEstimate() if values is None else values
        self.isam = self._fresh()
        if not self._factors:
            return
        try:
            found = self.isam.update(graph_of(list(self._factors.values())), values)
        except RuntimeError as fault:
            raise self._free(fault) from None
        self._slot = dict(zip(self._factors, found.getNewFactorsIndices(), strict=True))

    def _free(self, fault: RuntimeError) -> UnderConstrained:
        """The error that names the undetermined variable; raises a fault that is of another kind."""
        if "Indeterminate linear system" not in str(fault):
            raise fault
        match = re.search(r"variable\s+(\d+)", str(fault))
        name = self.name(int(match.group(1))) if match else "a variable"
        return UnderConstrained(f"{name} is not determined by the data so far")


MANY = 1 << 17  # factors in logs of several hours, removed ones included: gtsam visits all their slots in a step
FIRST, MIDDLE, LAST = 0, 1, 2  # groups in the order of elimination


class Window(Engine):
    """An `Engine` whose variables can be marginalized.

    The means are those of gtsam's IncrementalFixedLagSmoother: an update that eliminates the leaving variables first,
    then ISAM2's `marginalizeLeaves`. Here this is done on the engine's own ISAM2 object, which keeps the recovery by
    QR, the handles and the joint covariances; landmarks need no time stamps, and a pose can be read before it is
    marginalized.
    """

    def __init__(self, like: Engine) -> None:
        """Empty, with the parameters of an engine."""
        super().__init__(like.threshold, like.skip, qr=like.qr, name=like.name, linear=like.linear, walls=like.walls)
        # slots of points are reused only beyond `MANY`, since reuse changes the last bits
        self.reuses_slots = self.isam.params().findUnusedFactorSlots = like.walls
        self._handle: dict[int, int] = {}
        # linear factors at the present linearization point, which a new ISAM2 object would not keep
        self._linear: list[int] = []

    def add(self, factors: Sequence[Factor], values: gtsam.Values, last: Sequence[int] = ()) -> list[int]:
        """As `Engine.add`."""
        handles = super().add(factors, values, last)
        if handles and not self.reuses_slots and self._slot[handles[-1]] > MANY:
            self.reuses_slots = self.isam.params().findUnusedFactorSlots = True
        self._handle.update((self._slot[h], h) for h in handles)
        return handles

    def drop(self, handles: Sequence[int]) -> None:
        """Remove those factors that were not marginalized, and variables that lose their last one."""
        super().drop([h for h in handles if self.alive(h)])

    def _release(self, handles: Sequence[int]) -> list[int]:
        slots = super()._release(handles)
        for slot in slots:
            self._handle.pop(slot, None)
        return slots

    def alive(self, handle: int) -> bool:
        """Whether a factor is there: it is marginalized with its variables."""
        return handle in self._factors

    def holds(self, key: int) -> bool:
        """Whether a variable is there."""
        return bool(self.isam.valueExists(key))

    def same(self, pairs: Mapping[int, int], sigma: float) -> list[Factor]:
        """Factors that equate pairs of landmarks, with a standard deviation [m] in each direction."""
        if self.walls:
            of = dict(zip([*pairs, *pairs.values()], self._poses([*pairs, *pairs.values()]), strict=True))
            return [same_wall(a, b, (of[a], of[b]), sigma) for a, b in pairs.items()]
        model = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
        return [gtsam.BetweenFactorPoint2(L(a), L(b), np.zeros(2), model) for a, b in pairs.items()]

    def marginalize(self, keys: Sequence[int], last: Sequence[int]) -> None:
        """Marginalize; `last` stay last. Neighbours, whose linearization point is kept, are relinearized first."""
        # gtsam 4.3 corrupts the rest of a clique with a hard constraint (it removes rows of the conditional, not of its
        # noise model); the factors are right, so it is eliminated once more
        hard = any(_is_hard(self._factors[h]) for h in self._handle.values())
        try:
            self._eliminate_first(keys, last)
        except RuntimeError as fault:
            self._recover(fault)
            self._eliminate_first(keys, last)
        added, deleted = self.isam.marginalizeLeavesWithIndices(_key_list(keys))
        self._release([self._handle[slot] for slot in deleted])
        factors = self.isam.getFactorsUnsafe()
        self._linear = [h for h in self._linear if self.alive(h)]
        for slot in added:
            h = self._handle[slot] = self._keep(factors.at(slot))
            self._slot[h] = slot
            self._linear.append(h)
        if hard:
            self._eliminate_first([], last)

    def _eliminate_first(self, keys: Sequence[int], last: Sequence[int]) -> None:
        """Eliminate everything again with these variables first, which makes leaves of them."""
        every = self.isam.getLinearizationPoint().keys()
        place = gtsam.KeyGroupMap()
        for key in last:
            place.insert2(key, min(LAST, len(every) - 1))  # CCOLAMD allows no group beyond the number of variables
        for key in keys:
            place.insert2(key, FIRST)
        for key in every:
            place.insert2(key, MIDDLE)  # keeps existing groups
        self.isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [], place, None, _key_list(every), True)

    def _rebuild(self, values: gtsam.Values | None = None) -> None:
        """The same problem in a new ISAM2 object; linear factors keep their linearization point."""
        point = self.isam.getLinearizationPoint()
        for h in self._linear:
            factor = self._factors.get(h)
            if isinstance(factor, gtsam.LinearContainerFactor):
                self._factors[h] = gtsam.LinearContainerFactor(factor.factor(), point)
        self._linear = []
        super()._rebuild(values)
        self._handle = {slot: h for h, slot in self._slot.items()}


def _is_hard(factor: Factor | None) -> bool:
    """Whether a factor is a hard constraint, or results from the marginalization of one."""
    if isinstance(factor, gtsam.LinearContainerFactor):
        linear = factor.factor()
        return isinstance(linear, gtsam.JacobianFactor) and isinstance(linear.get_model(), gtsam.noiseModel.Constrained)
    return isinstance(factor, gtsam.NoiseModelFactor) and isinstance(factor.noiseModel(), gtsam.noiseModel.Constrained)


def _key_list(keys: Iterable[int]) -> gtsam.KeyList:
    """Keys as gtsam takes them."""
    result = gtsam.KeyList()
    for key in keys:
        result.push_back(key)
    return result

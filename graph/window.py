"""iSAM2 that can let go of variables: what they said about the others stays, as a linear factor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L

from graph.engine import Engine
from graph.factors import Factor, name_of
from graph.walls.poses import same_wall

MANY = 1 << 17
"""Factors, gone ones included, of the longest logs: of several hours. gtsam looks through all their slots in a step."""
FIRST, MIDDLE, LAST = 0, 1, 2
"""Places in the order of elimination."""


class Window(Engine):
    """An `Engine` whose variables can be marginalized.

    The means are those of gtsam's IncrementalFixedLagSmoother: an update that eliminates the leaving variables first,
    then ISAM2's `marginalizeLeaves`. It is done here on the engine's own ISAM2 object, so that recovery by QR, handles
    on factors and joint covariances are those of the incremental smoother, a landmark stays without a new time stamp at
    every update, and a pose can be read before it goes.
    """

    def __init__(
        self,
        threshold: float,
        skip: int,
        *,
        qr: bool,
        name: Callable[[int], str] = name_of,
        linear: Mapping[str, int] | None = None,
        walls: bool = False,
    ) -> None:
        """As `Engine`."""
        # of points, numbers stay those of other slots to the bit as long as logs are: slots are used again when there
        # are more than that
        super().__init__(threshold, skip, qr=qr, name=name, linear=linear, walls=walls, reuses_slots=walls)
        self._handle: dict[int, int] = {}
        # linear factors that hold about the present linearization point, which is not theirs in a new ISAM2 object
        self._linear: list[int] = []

    def add(
        self,
        factors: Sequence[Factor],
        values: gtsam.Values,
        instead_of: Sequence[int] = (),
        last: Sequence[int] | None = None,
    ) -> list[int]:
        """As `Engine.add`."""
        handles = super().add(factors, values, instead_of, last)
        if handles and not self.reuses_slots and self._slot[handles[-1]] > MANY:
            self.reuses_slots = self.isam.params().findUnusedFactorSlots = True
        self._handle.update((self._slot[h], h) for h in handles)
        return handles

    def drop(self, handles: Sequence[int]) -> None:
        """Remove those factors that did not go with a variable; a variable that loses its last one goes with them."""
        super().drop([h for h in handles if self.alive(h)])

    def _let_go(self, handles: Sequence[int]) -> list[int]:
        slots = super()._let_go(handles)
        for slot in slots:
            self._handle.pop(slot, None)
        return slots

    def alive(self, handle: int) -> bool:
        """Whether a factor is there: it goes with its variables."""
        return handle in self._factors

    def holds(self, key: int) -> bool:
        """Whether a variable is there."""
        return bool(self.isam.valueExists(key))

    def same(self, pairs: Mapping[int, int], sigma: float) -> list[Factor]:
        """Landmarks are the others named here, but for a standard deviation [m] in each direction."""
        if self.walls:
            of = dict(zip([*pairs, *pairs.values()], self._poses([*pairs, *pairs.values()]), strict=True))
            return [same_wall(a, b, (of[a], of[b]), sigma) for a, b in pairs.items()]
        model = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
        return [gtsam.BetweenFactorPoint2(L(a), L(b), np.zeros(2), model) for a, b in pairs.items()]

    def marginalize(self, keys: Sequence[int], last: Sequence[int]) -> None:
        """Let go of variables; `last` stay the last ones in the order of elimination.

        What hangs on those that go keeps its linearization point from now on, so it gets the newest one before.
        """
        # gtsam 4.3 leaves garbage in what remains of a clique with a hard constraint (it takes rows out of the
        # conditional, not out of its noise model); the factors are right, so that is eliminated once more
        hard = any(_is_hard(self._factors[h]) for h in self._handle.values())
        try:
            self._eliminate_first(keys, last)
        except RuntimeError as fault:
            self._recover(fault)
            self._eliminate_first(keys, last)
        added, deleted = self.isam.marginalizeLeavesWithIndices(_key_list(keys))
        self._let_go([self._handle[slot] for slot in deleted])
        factors = self.isam.getFactorsUnsafe()
        self._linear = [h for h in self._linear if self.alive(h)]
        for slot in added:
            h = self._handle[slot] = self._keep(factors.at(slot))
            self._slot[h] = slot
            self._linear.append(h)
        if hard:
            self._eliminate_first([], last)

    def _eliminate_first(self, keys: Sequence[int], last: Sequence[int]) -> None:
        """Make leaves of these variables: eliminate everything anew, with them first."""
        every = self.isam.getLinearizationPoint().keys()
        place = gtsam.KeyGroupMap()
        for key in last:
            place.insert2(key, min(LAST, len(every) - 1))  # CCOLAMD takes no place beyond the number of variables
        for key in keys:
            place.insert2(key, FIRST)
        for key in every:
            place.insert2(key, MIDDLE)  # changes none that has its place
        self.isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [], place, None, _key_list(every), True)

    def _rebuild(self) -> None:
        """The same problem in a new ISAM2 object; linear factors take their linearization point along."""
        point = self.isam.getLinearizationPoint()
        for h in self._linear:
            factor = self._factors.get(h)
            if isinstance(factor, gtsam.LinearContainerFactor):
                self._factors[h] = gtsam.LinearContainerFactor(factor.factor(), point)
        self._linear = []
        super()._rebuild()
        self._handle = {slot: h for h, slot in self._slot.items()}


def _is_hard(factor: Factor | None) -> bool:
    """Whether a factor has a hard constraint, or is what marginalization made of one."""
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

"""The increments of a run as linear factors, and when they are linearized anew.

Let w be the exact residuals, whitened, less those of the linear factors, and g the gradient of the exact cost by the
errors less that of the linear one. To first order an estimate that solves the linear problem is off by no more than |w|
of its own standard deviations, whatever it is, for w alone; and for g, whose parts add up even where those of w are
small (each residual times what the errors change of its weight), the errors are off by sqrt(g' P g) of theirs. Factors
are linearized anew where one of these exceeds `OFF`: the fewest that leave no more than half of that to the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.errors import DataError
from data.inputs import Increment, IntArray
from data.se2 import Array
from graph.calibration.factors import motion_factors
from graph.calibration.increments import Linear, linearize
from graph.calibration.variables import Errors, constants_key
from graph.engine import Engine
from graph.factors import SINGULAR, Factor, pose2, root_information
from graph.problem import drift_key

OFF = 0.3
"""Standard deviations by which linear factors may put an estimate off, at most."""
OFF_CLOSELY = 0.0
"""The same where it is asked for: all of them, so that covariances are those at the present errors, too."""
LOOKED = 0.1
"""Of all updates so far: after so many it is looked again how far off they are; ..."""
MOVED = 1.0
"""... and at once where a constant error moved by so many of its standard deviations, or a loop was closed. With half
of it factors are linearized anew 1.4 times as often in 4000 frames of Victoria Park, and the newest pose is nearer by
0.02 sigma in the median to where all are at every look (0.06 of it away)."""


class Motion:
    """All increments so far, in the order of frames from 1 on.

    Attributes:
        knot: of the drift, the newest one.
        oldest: first frame in the graph: increments up to it are no factors any more.
    """

    def __init__(self, errors: Errors) -> None:
        """None."""
        self._errors = errors
        self.knot = 0
        self._mean, self._covariance, self._roots = [np.zeros(3)], [np.zeros((3, 3))], list[Array]()
        self._linear, self._knots, self._handles = list[Linear](), list[int](), list[int]()
        self._updates, self._looked, self._known = 0, 0, np.zeros(len(errors.place))
        self.oldest = 0
        self._first_knot = 0

    @property
    def raw(self) -> tuple[Array, Array]:
        """Increments (N, 3) and covariances (N, 3, 3) as odometry stated them."""
        return np.array(self._mean), np.array(self._covariance)

    def extend(
        self, first: int, increments: Sequence[Increment], knots: Sequence[int], path: Array, b: Array
    ) -> tuple[list[Factor], float]:
        """Factors of increments (n) into frames `first`, ..., linearized at poses (n + 1, 3) and errors (n, p).

        `knots` (n,): whose drift each has. Also returned: the smallest pivot of the covariances. Raises DataError for a
        singular one.
        """
        mean, covariance = (np.array(rows) for rows in zip(*increments, strict=True))
        roots, pivot = root_information(covariance)
        bad = np.flatnonzero(~(pivot > SINGULAR))
        if len(bad):
            raise DataError(
                f"increment into frame {first + bad[0]}: its covariance is singular (variance {pivot[bad[0]]:.3g} in "
                "some direction); a smoother needs a covariance_floor of 1e-10 or so"
            )
        self._mean += list(mean)
        self._covariance += list(covariance)
        self._roots += list(roots)
        self._knots += knots
        linear = self._linearized(mean, roots, b, path)
        self._linear.append(linear)
        point = _values(first - 1, path)
        return motion_factors(self._errors, first, linear, knots, np.arange(len(mean)), point), float(pivot.min())

    def _linearized(self, mean: Array, roots: Array, b: Array, path: Array) -> Linear:
        return linearize(mean, roots, b, path, self._errors.place, self._errors.frame.mount)

    def hold(self, handles: Sequence[int]) -> None:
        """The engine's handles on the factors of `extend`."""
        self._handles += handles

    def knot_of(self, frame: int) -> int:
        """Whose drift the increment into a frame of the graph has (0 of frame 0)."""
        return self._knots[max(frame - 1 - self.oldest, 0)] if self._knots else self.knot

    def forget(self, oldest: int) -> range:
        """Frame `oldest` is the first one in the graph now; knots that no increment in it has any more."""
        self._whole()
        gone, first = oldest - self.oldest, self._first_knot
        self._linear = [linear.rows(np.arange(gone, len(linear.residual))) for linear in self._linear]
        del self._knots[:gone], self._handles[:gone]
        self.oldest = oldest
        self._first_knot = self._knots[0] if self._knots else self.knot
        return range(first, self._first_knot)

    def _whole(self) -> None:
        """All that are linearized in one."""
        if len(self._linear) > 1:
            self._linear = [Linear(*(np.concatenate(rows) for rows in zip(*self._linear, strict=True)))]

    def renew(self, engine: Engine, b: Array, P: Array, now: bool, off: float = OFF) -> bool:
        """Linearize anew what puts estimates off; whether that was necessary.

        It is looked `now`, or else when it is time to; `off`: as `OFF`. `b` (p,), `P` (p, p): the errors as known now.
        """
        self._updates += 1
        if not self._handles or not (now or self._due(b, P)):
            return False
        self._looked, self._known = self._updates, b
        self._whole()
        path, errors = self._present(engine)
        rows = slice(self.oldest + 1, self.oldest + 1 + len(self._handles))
        mean, roots = np.array(self._mean[rows]), np.array(self._roots[self.oldest : rows.stop - 1])
        exact, linear = self._linearized(mean, roots, errors, path), self._linear[0]
        residuals, stated = exact.at(exact.pose, errors), linear.at(exact.pose, errors)
        w = ((residuals - stated) ** 2).sum(1)
        g = np.einsum("nip,ni->np", exact.by_errors, residuals) - np.einsum("nip,ni->np", linear.by_errors, stated)
        if max(np.sqrt(w.sum()), _sigmas(g.sum(0), P)) < off:
            return False
        which = np.union1d(_most(w, (0.5 * off) ** 2), _most(_sigmas(g, P), 0.5 * off))
        factors = motion_factors(self._errors, rows.start, exact, self._knots, which, _values(rows.start - 1, path))
        handles = engine.add(factors, gtsam.Values(), [self._handles[i] for i in which.tolist()], [X(rows.stop - 1)])
        for i, handle in zip(which.tolist(), handles, strict=True):
            self._handles[i] = handle
        for mine, new in zip(linear, exact, strict=True):
            mine[which] = new[which]
        return True

    def _due(self, b: Array, P: Array) -> bool:
        """Whether it is time to look."""
        c = self._errors.constant
        moved = np.abs(b - self._known)[c] > MOVED * np.sqrt(np.diag(P))[c]
        return bool(moved.any()) or self._updates - self._looked >= LOOKED * self._updates

    def _present(self, engine: Engine) -> tuple[Array, Array]:
        """Poses (n + 1, 3) and errors (n, p) as the graph has them."""
        e, values = self._errors, engine.values()
        path = gtsam.utilities.extractPose2(values)[-len(self._handles) - 1 :]
        units = np.empty((len(self._handles), len(e.place)))
        if len(e.constant):
            units[:, e.constant] = values.atVector(constants_key(self.oldest + len(self._handles)))
        if e.drift >= 0:
            first = self._knots[0]
            knots = range(first, self._knots[-1] + 1)
            drift = np.array([values.atVector(drift_key(j))[0] for j in knots])
            units[:, e.drift] = drift[np.array(self._knots) - first]
        return path, units * e.systematic.sigma


def _sigmas(g: Array, P: Array) -> Array:
    """By how many standard deviations gradients (..., p) put errors of this covariance (p, p) off."""
    found: Array = np.sqrt(np.einsum("...i,ij,...j->...", g, P, g))
    return found


def _most(part: Array, left: float) -> IntArray:
    """Which are the largest parts (n,) of a sum, so many that the sum of the others is no more than `left`."""
    order = np.argsort(part)
    kept = 0 if left <= 0.0 else int(np.searchsorted(np.cumsum(part[order]), left, side="right"))
    return np.sort(order[kept:])


def _values(first: int, path: Array) -> gtsam.Values:
    """Poses (n, 3) of frames `first`, ... as gtsam takes them."""
    values = gtsam.Values()
    for k, pose in enumerate(path, first):
        values.insert(X(k), pose2(pose))
    return values

"""Expected measurements and joint covariance, of an estimator or stated: the input of every association method."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np
import scipy
from scipy.special import chdtrc, gammaincinv

from association.appearance import Evidence, Unlike
from data.blocks import add_to_diagonal, diagonal_blocks, of_points
from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array

Residual = Callable[[Array, Array], Array]

SINGULAR = 1e-13  # A covariance whose Cholesky pivot is below this share of its diagonal entry is singular


class SingularInnovationError(ValueError):
    """An innovation covariance is not positive definite, or not finite."""


@lru_cache(maxsize=4096)
def gate_threshold(probability: float | None, dof: int = 2) -> float:
    """Squared distance that a chi-square variable of `dof` stays below with `probability`; None: infinite."""
    if probability is None:
        return float("inf")
    if not 0.0 < probability < 1.0:
        raise ValueError(f"gate {probability}: a probability between 0 and 1, or none")
    return float(2.0 * gammaincinv(0.5 * dof, probability))


@lru_cache(maxsize=4096)
def threshold_with(gate: float | None, dims: int, pairs: int, right: Evidence) -> float:
    """Squared distance below which right pairings of `dims` numbers stay together with probability `gate`."""
    dof = (dims + right.dims) * pairs
    if not right.error or gate is None or not 0.0 < gate < 1.0:
        return gate_threshold(gate, dof)
    wrong = np.arange(pairs + 1)  # the quantile of chi-square plus the cost of each misread class
    share = scipy.stats.binom.pmf(wrong, pairs, right.error)

    def outside(threshold: float) -> float:
        return float(share @ chdtrc(dof, np.maximum(threshold - right.cost * wrong, 0.0))) - (1.0 - gate)

    most = gate_threshold(gate, dof) + right.cost * pairs + 1.0
    return float(scipy.optimize.brentq(outside, 0.0, most, xtol=1e-9))


NOTHING = Evidence()


@njit
def _distances(nu: Array, HPHt: Array, R: Array, frame: IntArray, observed: IntArray, d2: Array, det: Array) -> int:
    """Fill d2 and det S (m, n), infinite where the frames differ; the index i * n + j of a singular pair, or -1."""
    m: int = d2.shape[0]
    n: int = d2.shape[1]
    for i in range(m):
        for j in range(n):
            if frame[j] != observed[i]:
                d2[i, j], det[i, j] = np.inf, np.inf
                continue
            a, c = HPHt[j, 0, 0] + R[i, 0, 0], HPHt[j, 1, 1] + R[i, 1, 1]
            b = 0.5 * (HPHt[j, 0, 1] + HPHt[j, 1, 0] + R[i, 0, 1] + R[i, 1, 0])
            # Schur complement instead of the determinant: no overflow, and the pivot is tested
            pivot = c - b * (b / a) if a > 0.0 else -1.0
            if not (pivot > SINGULAR * c and c > 0.0):
                return i * n + j
            x, y = nu[i, j, 0], nu[i, j, 1] - nu[i, j, 0] * (b / a)
            d2[i, j] = x * x / a + y * y / pivot
            det[i, j] = a * pivot
            if not math.isfinite(d2[i, j]):
                return i * n + j
    return -1


class Formed(NamedTuple):
    """What pairings gave before: by decisions, or by observations and candidates, as bytes."""

    paired: dict[bytes, tuple[IntArray, IntArray]]  # of `Expectation.paired`
    joint: dict[tuple[bytes, bytes], tuple[Array, Array]]  # of `Expectation.joint_innovation`
    conditional: dict[tuple[bytes, bytes], tuple[Array, Array]]  # innovations given the others, and their information


@dataclass(frozen=True)
class Expectation:
    """Candidates (n) and observations (m) of a frame or a window of frames: the input of every association method.

    Measurements have 2 components, for instance range [m] and bearing [rad]. Example: `Expectation.from_arrays`.

    Example:
        >>> e = slamref.Expectation.from_arrays([[1.0, 0.1]], [[1.0, 0.0]], 0.1 * np.eye(2), 0.1 * np.eye(2)[None])
        >>> e.individual_distances()  # (m, n) squared Mahalanobis distances, array([[0.05]])
    """

    number: IntArray  # (n,) landmark number of each candidate
    z_hat: Array  # (n, 2) expected measurement
    HPHt: Array  # (n, 2, 2) covariance of the expectation, measurement noise not included
    frame: IntArray  # (n,) frame in which the candidate is expected
    z: Array  # (m, 2)
    R: Array  # (m, 2, 2)
    observed_frame: IntArray  # (m,)
    residual: Residual  # the sensor's `residual(z, z_hat)`, broadcasting
    joint: Callable[[IntArray], Array]  # joint covariance (2k, 2k) of k candidates, in the order of their indices
    elsewhere: Callable[[Array], Expectation] | None = None  # linearized at a pose (3,): h(pose) + H (mean - pose)
    dims: int = 2  # numbers measured of each; 1: bearings or ranges alone (see `data.sensors`)
    unlike: Unlike | None = None  # (m, n) terms of appearance in the distances; None: there is none
    formed: Formed = field(default_factory=lambda: Formed({}, {}, {}), init=False, repr=False, compare=False)

    @classmethod
    def from_arrays(
        cls, z: Array, z_hat: Array, joint_HPHt: Array, R: Array, residual: Residual = np.subtract, *,
        number: IntArray | None = None, frame: IntArray | None = None, observed_frame: IntArray | None = None,
    ) -> Expectation:  # fmt: skip
        """A problem from plain arrays: z (m, 2), z_hat (n, 2), joint_HPHt (2n, 2n), R (m, 2, 2). `number` (n,)
        defaults to 0, 1, ...; `frame` (n,) and `observed_frame` (m,) to one frame. ValueError for a wrong shape.
        """
        z, z_hat = np.asarray(z, float).reshape(-1, 2), np.asarray(z_hat, float).reshape(-1, 2)
        full = np.asarray(joint_HPHt, float)
        n, m = len(z_hat), len(z)
        if full.shape != (2 * n, 2 * n):
            raise ValueError(f"joint covariance has shape {full.shape}; {n} candidates need {(2 * n, 2 * n)}")
        return cls(
            np.arange(n) if number is None else np.asarray(number, np.int64), z_hat, diagonal_blocks(full),
            np.zeros(n, np.int64) if frame is None else np.asarray(frame, np.int64), z,
            np.asarray(R, float).reshape(m, 2, 2),
            np.zeros(m, np.int64) if observed_frame is None else np.asarray(observed_frame, np.int64), residual,
            partial(of_points, full),
        )  # fmt: skip

    @property
    def dof(self) -> int:
        """Degrees of freedom of the squared distance of a pair."""
        return self.dims if self.unlike is None else self.dims + self.unlike.right.dims

    def threshold(self, gate: float | None, pairs: int = 1) -> float:
        """Squared distance that right pairings stay below together with probability `gate`; None: infinite."""
        return threshold_with(gate, self.dims, pairs, NOTHING if self.unlike is None else self.unlike.right)

    def with_appearance(self, unlike: Unlike | None) -> Expectation:
        """The same problem with terms of appearance."""
        elsewhere = self.elsewhere
        return self if unlike is None else replace(
            self, unlike=unlike,
            elsewhere=None if elsewhere is None else lambda pose: elsewhere(pose).with_appearance(unlike),
        )  # fmt: skip

    def by_age(self) -> Expectation:
        """The same problem with its candidates in ascending landmark number, then frame. Methods that break ties by
        order start with this, so that no decision depends on how a map is stored.
        """
        if (self.number[1:] > self.number[:-1]).all():
            return self
        order = np.lexsort((self.frame, self.number))
        return self if np.array_equal(order, np.arange(len(order))) else self.only(order)

    def only(self, which: IntArray) -> Expectation:
        """The same problem with these candidates alone, in this order."""
        elsewhere = self.elsewhere
        return replace(
            self, elsewhere=None if elsewhere is None else lambda pose: elsewhere(pose).only(which),
            number=self.number[which], z_hat=self.z_hat[which], HPHt=self.HPHt[which], frame=self.frame[which],
            joint=lambda indices: self.joint(which[np.asarray(indices, np.int64)]),
            unlike=None if self.unlike is None else self.unlike.only(which),
        )  # fmt: skip

    def innovations(self) -> Array:
        """z_i - z_hat_j for every observation i and candidate j, (m, n, 2)."""
        return self.residual(self.z[:, None, :], self.z_hat[None, :, :])

    @cached_property
    def _formed(self) -> tuple[Array, Array]:
        """Squared distances and determinants (m, n)."""
        m, n = len(self.z), len(self.number)
        d2, det = np.empty((m, n)), np.empty((m, n))
        # copies: to the compiler read-only arrays are another type
        nu, HPHt, R = (np.array(a, float) for a in (self.innovations(), self.HPHt, self.R))
        frame, observed_frame = (np.array(a, np.int64) for a in (self.frame, self.observed_frame))
        bad = _distances(nu, HPHt, R, frame, observed_frame, d2, det)
        if bad >= 0:
            i, j = divmod(int(bad), n)
            raise SingularInnovationError(
                f"observation {i} and landmark {self.number[j]}: the innovation covariance "
                f"{(self.HPHt[j] + self.R[i]).tolist()} is singular, or the innovation is not finite; "
                "a positive definite covariance is needed"
            )
        if self.unlike is not None:
            d2 += self.unlike.distance
        d2.setflags(write=False)
        det.setflags(write=False)
        return d2, det

    def individual_distances(self) -> Array:
        """Squared Mahalanobis distance (m, n) of every observation to every candidate, infinite in another frame, with
        the terms of appearance. Raises SingularInnovationError if a covariance is not positive definite, or a value not
        finite.
        """
        return self._formed[0]

    def scaled(self, distances: Array, share: float) -> Array:
        """Squared distances (m, n) if all covariances were `share` times these."""
        if share == 1.0:
            return distances
        if self.unlike is None:
            return distances / share
        return (distances - self.unlike.distance) / share + self.unlike.distance

    def log_determinants(self) -> Array:
        """Logarithm of det S (m, n) of every observation and candidate, infinite in another frame."""
        logs: Array = np.log(self._formed[1])
        return logs if self.unlike is None else logs + self.unlike.log_determinant

    def paired(self, decisions: IntArray) -> tuple[IntArray, IntArray]:
        """Rows (k,) of the paired observations, and the candidates (k,) they are paired with."""
        key = decisions.tobytes()
        found = self.formed.paired.get(key)
        if found is None:
            rows, order = np.flatnonzero(decisions >= 0), np.argsort(self.number, kind="stable")
            found = rows, order[np.searchsorted(self.number, decisions[rows], sorter=order)]
            self.formed.paired[key] = found
        return found

    def joint_innovation(self, rows: IntArray, chosen: IntArray) -> tuple[Array, Array]:
        """Innovation (2k,) of pairing observations `rows` with candidates `chosen`, and its covariance (2k, 2k)."""
        pairing = rows.tobytes(), chosen.tobytes()
        found = self.formed.joint.get(pairing)
        if found is None:
            S = self.joint(chosen)
            add_to_diagonal(S, self.R[rows])
            found = self.residual(self.z[rows], self.z_hat[chosen]).ravel(), S
            self.formed.joint[pairing] = found
        return found

    def singular(self, chosen: IntArray) -> SingularInnovationError:
        """The error where the joint covariance of candidates `chosen` (k,) is not positive definite."""
        which = self.number[chosen].tolist()
        return SingularInnovationError(f"the joint innovation covariance of landmarks {which} is singular")

    def innovation_statistics(self, rows: IntArray, chosen: IntArray) -> tuple[float, int, float]:
        """NIS, degrees of freedom and log-likelihood of pairing observations `rows` with candidates `chosen`, jointly.
        Raises SingularInnovationError if their joint covariance is not positive definite.
        """
        if not len(rows):
            return 0.0, 0, 0.0
        try:
            return statistics(*self.joint_innovation(rows, chosen), self.dims * len(rows))
        except SingularInnovationError:
            raise self.singular(chosen) from None


def statistics(nu: Array, S: Array, dof: int | None = None) -> tuple[float, int, float]:
    """NIS, degrees of freedom and log-likelihood of an innovation (d,) with covariance (d, d); `dof`: less than d where
    something is not measured (innovation 0, variance 1). Raises SingularInnovationError.
    """
    try:
        root = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        raise SingularInnovationError("the joint innovation covariance is singular") from None
    white, dof = np.linalg.solve(root, nu), len(nu) if dof is None else dof
    nis = float(white @ white)
    return nis, dof, -0.5 * (nis + 2.0 * float(np.log(np.diag(root)).sum()) + dof * math.log(2.0 * math.pi))

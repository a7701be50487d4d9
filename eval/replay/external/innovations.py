"""Innovation statistics of a foreign estimator, formed from its own expectation; what it states is only compared.

An estimator that states a convenient NIS would otherwise pass for consistent. The expectation is formed before the
update, where it is valid; the update tells which pairings were used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from association.expectation import Expectation, SingularInnovationError, statistics
from association.faces import aligned_with_observations
from data.blocks import diagonal_blocks
from data.inputs import FrameObservations, IntArray
from data.notice import Code, Notice, notice
from data.result import Updated
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.external.guard import ForeignError

DIFFERENT = 0.01  # of the NIS that its expectation gives; a sound filter linearizes its update as its expectation
ROUNDING = 1e-9  # relative; what it states so closely is kept, to the bit


class OwnInnovations:
    """NIS, likelihood and whitened innovations of a foreign estimator, frame by frame."""

    def __init__(self, expect: Callable[[FrameObservations], Expectation] | None, sensor: Sensor) -> None:
        """`expect` of the estimator; None: it has none."""
        self._expect, self._sensor = expect, sensor
        self._rows, self._nu, self._S = np.empty(0, np.int64), np.empty(0), np.empty((0, 0))
        self._why = "it has no `expect`" if expect is None else ""  # why nothing can be formed
        self._frames = self._differing = self._dof = 0
        self._stated = self._formed = 0.0
        self._unchecked = False  # whether it stated what could not be formed

    def before(
        self,
        observations: FrameObservations,
        decisions: IntArray,
        expected: Expectation | None,
        at: Array | None = None,
    ) -> None:
        """Form the innovations of the pairings by `expected` (None: by its expectation now, linearized at `at`).

        Observations, noise and residual are those of the log, whatever the expectation has.
        """
        self._rows = np.flatnonzero(decisions >= 0)
        if self._why or self._expect is None or not len(self._rows):
            return
        try:
            e = self._expect(observations) if expected is None else expected
            if expected is None and at is not None and e.elsewhere is not None:
                e = e.elsewhere(at)
            if expected is None:
                e = aligned_with_observations(e, self._sensor)
            absent = np.setdiff1d(decisions[self._rows], e.number)
            if len(absent):
                self._why = f"its `expect` leaves out landmark {absent[0]}, which was paired"
                return
            self._nu, self._S = replace(
                e, z=observations.z, R=observations.R, residual=self._sensor.residual
            ).joint_innovation(*e.paired(decisions))
        except ForeignError as stop:
            if expected is not None:  # the decisions needed it
                raise
            self._why = str(stop)

    def after(self, done: Updated) -> Updated:
        """The result of the update with the statistics of the pairings that it used."""
        stated = done.nis
        keep = done.used[self._rows]
        blank = done._replace(nis=math.nan, dof=0, log_likelihood=math.nan, white=None)
        if not len(self._rows):
            return blank if self._why else done._replace(nis=0.0, dof=0, log_likelihood=0.0)
        if not self._why:
            both = np.repeat(keep, 2)
            nu, S = self._nu[both], self._S[np.ix_(both, both)]
            try:
                nis, dof, likelihood = statistics(nu, S)
            except SingularInnovationError:
                self._why = "the joint covariance of its expectation and R is not positive definite"
        if self._why:
            self._unchecked |= math.isfinite(stated)
            return blank
        if math.isfinite(stated):
            self._frames += 1
            self._stated, self._formed, self._dof = self._stated + stated, self._formed + nis, self._dof + dof
            self._differing += abs(stated - nis) > DIFFERENT * max(nis, 1.0)
        white = np.full((len(done.used), 2), np.nan)
        white[self._rows[keep]] = whitened(nu.reshape(-1, 2), diagonal_blocks(S))
        if done.dof == dof and _close(done, nis, likelihood, white):
            return done
        return done._replace(nis=nis, dof=dof, log_likelihood=likelihood, white=white)

    def notes(self) -> list[Notice]:
        """Messages about what it states otherwise, or what cannot be compared."""
        found = []
        if self._differing:
            per_dof = max(self._dof, 1)
            found.append(
                notice(
                    Code.NIS_STATED, frames=self._differing, of=self._frames,
                    stated=self._stated / per_dof, formed=self._formed / per_dof,
                )
            )  # fmt: skip
        if self._unchecked or (self._why and self._expect is not None):
            found.append(notice(Code.NIS_UNCHECKED, why=self._why, stated=self._unchecked))
        return found


def _close(done: Updated, nis: float, likelihood: float, white: Array) -> bool:
    """Whether all that it states is right but for rounding."""
    stated, formed = np.array([done.nis, done.log_likelihood]), np.array([nis, likelihood])
    if done.white is None or not np.allclose(stated, formed, rtol=ROUNDING, atol=ROUNDING):
        return False
    return bool(np.allclose(done.white, white, rtol=ROUNDING, atol=ROUNDING, equal_nan=True))


def whitened(nu: Array, S: Array) -> Array:
    """Innovations (k, 2) over their standard deviations, by the Cholesky factors of their covariances (k, 2, 2)."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(S), nu[:, :, None])[:, :, 0])

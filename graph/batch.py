"""Batch smoothing: all poses and landmarks of a log from all its data, for decisions made beforehand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np

from data.errors import UsageError
from data.inputs import Inputs, IntArray
from data.motion.systematic import sensor_frame
from data.result import MapState, Systematics, Trajectory
from data.se2 import Array
from graph.factors import LOSSES, between_factors, sight_known, sight_landmarks
from graph.optimum import optimize, suspect
from graph.problem import Problem
from graph.systematic import Calibrated
from graph.walls import refuse, sight_lines


class Start(NamedTuple):
    """Where the search starts: poses (N, 3) and landmarks (L, 2), points or walls, row = landmark number.

    errors (N, p): systematic errors by frame, where some are estimated; None: from zero.
    """

    pose: Array
    landmark: Array
    errors: Array | None = None


@dataclass(frozen=True)
class Smoothed:
    """What all data say together.

    Attributes:
        trajectory: poses and world-frame covariances. Under a robust loss the covariances follow from the information
            as reweighted at the optimum.
        map: landmarks, or None in localization.
        chi_square: minimum of the squared whitened residuals; NaN under a robust loss, whose cost is no chi-square.
        dof: its degrees of freedom.
        iterations: of the optimizer.
        last_step: sigmas, largest component of the Newton step that was left: near zero at an optimum.
        cost: twice the sum of all losses; without a robust loss the chi-square.
        suspect: the cost is so high that there may be a lower minimum elsewhere.
        systematic: the systematic errors, where `inputs.systematic` says that they are estimated along.
    """

    trajectory: Trajectory
    map: MapState | None
    chi_square: float
    dof: int
    iterations: int
    last_step: float
    cost: float
    suspect: bool
    systematic: Systematics | None = None

    @property
    def total_nis(self) -> tuple[float, int] | None:
        """(chi-square, degrees of freedom), or None under a robust loss."""
        return None if np.isnan(self.chi_square) else (self.chi_square, self.dof)


def smooth(inputs: Inputs, decisions: IntArray, created: IntArray, start: Start, *, loss: str = "gaussian") -> Smoothed:
    """Maximum a posteriori path (and map): a minimum reached from `start`.

    Inputs with a map: localization, decisions (M,) are map ids or `DISCARD`. Without: SLAM, decisions are landmark
    numbers, `NEW` or `DISCARD`, and `created` (M,) is the number of the landmark an observation initialized (-1: none).
    `loss`: gaussian, huber or cauchy, on measurements only. Raises `UnderConstrained` (`NotConvergedError` where no
    minimum was reached), and DataError for a singular increment or measurement covariance.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss {loss!r}; known: {', '.join(LOSSES)}")
    problem = build(inputs, decisions, created, loss)
    values = start_values(problem, start)
    found = optimize(problem, values)
    chi_square = 2.0 * found.error if loss == "gaussian" else float("nan")
    effort = found.iterations, found.last_step, 2.0 * found.error, suspect(found.error, problem)
    return Smoothed(found.trajectory, found.map, chi_square, problem.dof, *effort, found.systematic)


def start_values(problem: Problem, start: Start) -> gtsam.Values:
    """The start as gtsam takes it; raises ValueError if a variable of the problem has none, or none that is finite."""
    missing = [n for n in problem.numbers if n >= len(start.landmark) or not np.isfinite(start.landmark[n]).all()]
    if missing or start.pose.shape != (len(problem.motion) + 1, 3) or not np.isfinite(start.pose).all():
        what = f"no position for landmark {missing[0]}" if missing else "not a finite pose for every frame"
        raise ValueError(f"start: {what}")
    return problem.values(start.pose, {int(n): start.landmark[n] for n in problem.numbers}, start.errors)


def build(inputs: Inputs, decisions: IntArray, created: IntArray, loss: str = "gaussian") -> Problem:
    """The factors of a log under given decisions."""
    calibrated, sensor = None, inputs.sensor
    refuse(inputs.systematic, sensor)
    if inputs.systematic is None:
        motion, _ = between_factors(1, inputs.increments.mean[1:], inputs.increments.covariance[1:])
    else:
        frame = sensor_frame(inputs.systematic, inputs.sensor, inputs.prior)
        calibrated, sensor = Calibrated(inputs.systematic, frame, inputs.increments), frame.sensor(inputs.sensor)
        motion = calibrated.motion()
    number = np.where(created >= 0, created, decisions)
    used = np.flatnonzero(number >= 0)
    o = inputs.observations
    seen = (sensor, o.z[used], o.R[used], o.frame[used], number[used])
    if not sensor.sees_points:
        about = inputs.prior.mean[:2]
        known = None if inputs.map is None else inputs.map.xy[_rows_of(inputs, number[used])]
        sighted = sight_lines(*seen, about, loss, known)
        return Problem(inputs.prior, motion, sighted, inputs.map is not None, calibrated, about)
    if inputs.map is None:
        return Problem(inputs.prior, motion, sight_landmarks(*seen, loss), False, calibrated)
    xy = inputs.map.xy[_rows_of(inputs, number[used])]
    return Problem(inputs.prior, motion, sight_known(*seen, xy, 0, loss), True, calibrated)


def _rows_of(inputs: Inputs, ids: IntArray) -> IntArray:
    """Row of the map for each id; raises UsageError for one the map does not have."""
    assert inputs.map is not None
    rows = inputs.map.rows(ids)
    bad = np.flatnonzero(rows < 0)
    if len(bad):
        raise UsageError(f"decision {ids[bad[0]]}: the map has no landmark of this id")
    return rows

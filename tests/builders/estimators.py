"""Estimators driven frame by frame with given decisions, and front ends that decide themselves."""

from typing import Any, NamedTuple

import numpy as np

from data.inputs import Frame, Inputs, IntArray
from data.result import Updated
from data.se2 import Array, BoolArray
from ekf.filter import FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.replay.frontend import FrontEnd
from eval.replay.run import through


class Driven(NamedTuple):
    """The estimates of the newest pose (N, 3), (N, 3, 3), and what each update returned."""

    pose: Array
    covariance: Array
    updates: list[Updated]


def ekf_of(inputs: Inputs, options: FilterOptions | None = None) -> EkfLocalizer | EkfSlam:
    options = options or FilterOptions()
    if inputs.map is None:
        return EkfSlam(inputs.prior, inputs.sensor, options, systematic=inputs.systematic)
    return EkfLocalizer(inputs.prior, inputs.sensor, inputs.map, options, systematic=inputs.systematic)


def drive(
    estimator: Any, inputs: Inputs, decisions: IntArray, *, threshold: float = np.inf, until: int | None = None
) -> Driven:
    """Predict, update and estimate through frames [0, until); an update in frames with observations only."""
    poses, covariances, done = [], [], []
    for k in range(len(inputs) if until is None else until):
        if k:
            estimator.predict(inputs.increment(k))
        if hasattr(estimator, "stamp"):
            estimator.stamp(inputs.time[k])
        rows = slice(inputs.start[k], inputs.start[k + 1])
        if rows.stop > rows.start:
            done.append(estimator.update(inputs.frame_observations(k), decisions[rows], threshold=threshold))
        pose, covariance = estimator.estimate()
        poses.append(pose)
        covariances.append(covariance)
    return Driven(np.array(poses), np.array(covariances), done)


def followed(front: FrontEnd, inputs: Inputs) -> tuple[Array, Array, IntArray, BoolArray]:
    """Poses (N, 3), covariances (N, 3, 3), decisions (M,) and which were used (M,), of a front end to its end."""
    decisions, used = np.full(len(inputs.observations.frame), -2), np.zeros(len(inputs.observations.frame), np.bool_)

    def keep(part: Frame, decided: IntArray, done: Updated) -> None:
        rows = slice(part.first, part.first + len(decided))
        decisions[rows], used[rows] = decided, done.used

    found = []
    for k in range(len(inputs)):
        through(front, inputs.frame(k), keep)
        found.append(front.estimator.estimate())
    front.close()
    return np.array([mean for mean, _ in found]), np.array([P for _, P in found]), decisions, used


def assert_close(run: Any, plain: Any) -> None:
    """Within 1e-9: poses in standard deviations, covariances and NIS relative to themselves; alike in all decisions."""
    (a, b), (s, t) = ([getattr(r, name, r) for r in (run, plain)] for name in ("online", "innovations"))
    sigma, scale = np.sqrt(np.diagonal(b.covariance, axis1=1, axis2=2)), np.abs(b.covariance).max(axis=(1, 2))
    assert np.nanmax(np.abs(a.pose - b.pose) / (sigma + 1e-9)) < 1e-9
    assert np.nanmax(np.abs(a.covariance - b.covariance).max(axis=(1, 2)) / (scale + 1e-15)) < 1e-9
    np.testing.assert_allclose(s.nis, t.nis, rtol=1e-9, atol=1e-9)
    for one, two in ((s.dof, t.dof), *((getattr(run, k), getattr(plain, k)) for k in ("state_size", "decisions"))):
        np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(run.map.number, plain.map.number)
    np.testing.assert_allclose(run.map.xy, plain.map.xy, atol=1e-9)
    atol = 1e-9 * max(plain.map.covariance.max(), 1.0)
    np.testing.assert_allclose(run.map.covariance, plain.map.covariance, rtol=1e-9, atol=atol)

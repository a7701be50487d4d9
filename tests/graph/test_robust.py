"""Graduated non-convexity: wrong associations go, right ones stay, and the rest is the plain smoother's."""

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.errors import DataError
from data.inputs import Increments
from data.result import DISCARD
from data.worlds.arena import Arena, simulate
from ekf.whole_run import run_filter
from graph.batch import gnc, smooth
from graph.problem import Start
from tests.graph.worlds import SENSORS, both_tasks, circle, for_task
from tests.quick import slow


def filtered(inputs, decisions):
    run = run_filter(inputs, decisions)
    return Start(run.pose, np.empty((0, 2)) if run.map is None else run.map.xy)


def confused(inputs, decisions, created, rate, seed=0):
    """Decisions with a share of the pairings given to another landmark that was there at the time."""
    rng = np.random.default_rng(seed)
    wrong, frame = decisions.copy(), inputs.observations.frame
    for i in np.flatnonzero((rng.random(len(decisions)) < rate) & (created < 0) & (decisions >= 0)):
        n = len(inputs.map.id) if inputs.map is not None else int((created[: inputs.start[frame[i]]] >= 0).sum())
        if n > 1:
            wrong[i] = (decisions[i] + rng.integers(1, n)) % n
    return wrong


def rms(pose, other):
    return np.sqrt(np.mean(np.sum(se2.pose_error(pose, other)[:, :2] ** 2, 1)))


@pytest.mark.parametrize("kind", ["range_bearing", slow("relative_point")])
@pytest.mark.parametrize("task", ["slam", slow("localization")])
def test_a_fifth_of_wrong_associations_does_no_harm(kind, task):
    """From the path of a filter that believed them all, where the plain smoother is off by a metre and more."""
    log = simulate(Arena(sensor=kind, frames=70), 1)
    inputs = log.inputs(labels=True)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    wrong = confused(inputs, decisions, created, 0.2)
    clean = smooth(inputs, decisions, created, filtered(inputs, decisions)).trajectory.pose
    start = filtered(inputs, wrong)
    result, accepted = gnc(inputs, wrong, created, start)
    truth = log.truth.pose
    assert rms(result.trajectory.pose, truth) < 1.25 * rms(clean, truth)
    assert rms(result.trajectory.pose, clean) < 0.06
    assert rms(smooth(inputs, wrong, created, start).trajectory.pose, truth) > 4.0 * rms(clean, truth)
    bad = wrong != decisions
    assert bad.sum() > 70
    assert (accepted & bad).sum() <= 3
    assert (~accepted & ~bad).sum() < 0.05 * len(bad)


@pytest.mark.parametrize("sensor", [*SENSORS.values()][1:3], ids=[*SENSORS][1:3])
@both_tasks
def test_the_result_is_the_optimum_over_what_it_accepted_and_judges_each_observation_by_two_dof(sensor, task):
    inputs, _, _ = circle(sensor)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    wrong = confused(inputs, decisions, created, 0.1, seed=3)
    result, accepted = gnc(inputs, wrong, created, filtered(inputs, decisions))
    assert 0 < (~accepted).sum() < 0.2 * len(accepted)
    kept = np.where(accepted, wrong, DISCARD), np.where(accepted, created, -1)
    landmark = np.empty((0, 2)) if result.map is None else filtered(inputs, decisions).landmark.copy()
    if result.map is not None:
        landmark[result.map.number] = result.map.xy
    again = smooth(inputs, *kept, Start(result.trajectory.pose, landmark))
    np.testing.assert_allclose(result.trajectory.pose, again.trajectory.pose, atol=1e-5)
    assert result.total_nis == (pytest.approx(again.cost, rel=1e-6), again.dof)
    o, pose = inputs.observations, result.trajectory.pose  # by the sensor model itself, not by factors
    xy = inputs.map.xy if task == "localization" else landmark
    number = np.where(created >= 0, created, wrong)
    nu = inputs.sensor.residual(o.z, inputs.sensor.predict(pose[o.frame], xy[number]))
    square = np.einsum("mi,mi->m", nu, np.linalg.solve(o.R, nu[..., None])[..., 0])
    clear = np.abs(square - 9.21034) > 0.3  # range and bearing off centre are converted to first order
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(accepted[clear], square[clear] < 9.21034)


@pytest.mark.parametrize("kind", ["range-bearing", "relative point"])
@both_tasks
@pytest.mark.parametrize("P0", [np.zeros((3, 3)), 0.01 * np.ones((3, 3))], ids=["zero", "rank one"])
def test_a_first_pose_known_exactly_stays_where_it_is(kind, task, P0):
    inputs, truth, _ = circle(SENSORS[kind], P0=P0, frames=25)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    wrong = confused(inputs, decisions, created, 0.15)
    result, accepted = gnc(inputs, wrong, created, filtered(inputs, decisions))
    clean = smooth(inputs, decisions, created, filtered(inputs, decisions))
    assert rms(result.trajectory.pose, clean.trajectory.pose) < 0.05
    assert (accepted & (wrong != decisions)).sum() <= 2
    if not P0.any():
        np.testing.assert_allclose(result.trajectory.pose[0], truth[0], atol=1e-12)
        np.testing.assert_allclose(result.trajectory.covariance[0], 0.0, atol=1e-15)


def test_senseless_requests_are_refused():
    inputs, _, _ = circle(SENSORS["range-bearing"])
    decisions, created = known_decisions(inputs)
    start = filtered(inputs, decisions)
    for probability in (0.0, 1.0, -3.0, np.nan):
        with pytest.raises(ValueError, match="a probability between 0 and 1"):
            gnc(inputs, decisions, created, start, probability=probability)
    with pytest.raises(ValueError, match="finite pose"):
        gnc(inputs, decisions, created, Start(start.pose * np.nan, start.landmark))
    singular = replace(inputs, increments=Increments(inputs.increments.mean, 0.0 * inputs.increments.covariance))
    with pytest.raises(DataError, match="covariance is singular"):
        gnc(singular, decisions, created, start)


@pytest.mark.slow
@pytest.mark.parametrize(("task", "rate", "runs"), [("localization", 0.1, 20), ("slam", 0.0, 20)])
def test_its_chi_square_is_that_of_truncated_measurements(task, rate, runs):
    """Without the truncation at the gate, 1 would be expected, and every log with outliers would look conservative."""
    found = []
    for seed in range(runs):
        inputs = for_task(simulate(Arena(frames=100), seed).inputs(labels=True), task)
        decisions, created = known_decisions(inputs)
        wrong = confused(inputs, decisions, created, rate, seed)
        result, _ = gnc(inputs, wrong, created, filtered(inputs, decisions))
        found.append((result.cost, result.dof, result.gated[0]))
    cost, dof, expected = np.array(found).T
    error = np.sqrt(2.0 / dof.sum())
    assert cost.sum() / dof.sum() == pytest.approx(expected.mean(), abs=3.3 * error)
    assert expected.mean() == pytest.approx(0.9535, abs=1e-4)
    assert cost.sum() / dof.sum() < 1.0 - 3.3 * error  # what a chi-square without truncation contradicts

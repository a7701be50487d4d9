"""The optimum, its marginals, what is near, and the shares of residuals: against dense least squares."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from association.decide import known_decisions
from data.inputs import LandmarkMap
from data.sensors import RelativePoint
from data.worlds.registry import named_log
from ekf.whole_run import run_filter
from graph import optimum
from graph.batch import build, smooth
from graph.optimum import NotConvergedError, in_world
from graph.problem import Start
from tests.builders import logs
from tests.graph.worlds import circle, every_sensor, solved
from tests.quick import slow


def labelled(name):
    log = named_log(name)
    inputs = log.inputs(labels=True).without_map()
    return log, inputs, *known_decisions(inputs)


def filtered(inputs, decisions):
    run = run_filter(inputs, decisions)
    return Start(run.pose, run.map.xy)


HARD = "park:0:frames=500+spacing=12+sigma_v=.1+sigma_omega=.03"
"""One (v, omega) sample a frame, few trees: increments are stiff across the way, and the filter is far off."""


@pytest.mark.parametrize("name", [slow("park:1:frames=535"), slow("park:2:frames=500+spacing=8+sigma_range=.5"), HARD])
def test_a_stiff_path_is_smoothed_to_the_same_optimum_from_the_filters_path_and_from_the_truth(name):
    log, inputs, decisions, created = labelled(name)
    number = np.where(created >= 0, created, decisions)
    landmark = np.empty((created.max() + 1, 2))
    landmark[number] = log.truth.landmarks.xy[log.truth.landmark_of]
    a = smooth(inputs, decisions, created, filtered(inputs, decisions))
    b = smooth(inputs, decisions, created, Start(log.truth.pose, landmark))
    sigma = np.sqrt(np.diagonal(b.trajectory.covariance, axis1=1, axis2=2))
    assert np.abs((a.trajectory.pose - b.trajectory.pose) / sigma).max() < 1e-3
    assert max(a.last_step, b.last_step) < 1e-3
    assert a.cost == pytest.approx(b.cost, rel=1e-7)
    assert 0.9 < a.cost / a.dof < 1.1


def test_a_search_that_is_cut_short_says_how_far_it_came_and_a_likely_reason(monkeypatch):
    _, inputs, decisions, created = labelled("park:1:frames=300")
    monkeypatch.setattr(optimum, "MOST", 0)
    monkeypatch.setattr(optimum, "FURTHER", 0)
    with pytest.raises(
        NotConvergedError, match=r"did not converge: after \d+ steps .* sigma are left at .* weakest is"
    ):
        smooth(inputs, decisions, created, filtered(inputs, decisions))
    # a landmark on the robot is a likely reason, as no bearing has a slope there: here all nearer than 5 m
    monkeypatch.setattr(optimum, "ON_THE_ROBOT", 5.0)
    with pytest.raises(NotConvergedError, match=r"; landmark \d+ is only .* m from the robot at frame \d+"):
        smooth(inputs, decisions, created, filtered(inputs, decisions))


@pytest.mark.parametrize("search", optimum.SEARCHES, ids=["damped", "dog leg"])
def test_before_it_gives_up_damped_steps_and_the_dog_leg_are_tried(search, monkeypatch):
    """Own searches of one step each fail here; either of the others reaches the optimum alone."""
    _, inputs, decisions, created = labelled("park:1:frames=300")
    start = filtered(inputs, decisions)
    whole = smooth(inputs, decisions, created, start)
    monkeypatch.setattr(optimum, "MOST", 1)
    monkeypatch.setattr(optimum, "SEARCHES", (search,))
    helped = smooth(inputs, decisions, created, start)
    assert helped.cost == pytest.approx(whole.cost, rel=1e-7)
    assert helped.last_step < 1e-2


@every_sensor
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("loss", ["gaussian", "cauchy"])
def test_all_marginals_equal_gtsams(sensor, task, loss):
    inputs, _, _ = circle(sensor)
    if task == "slam":
        inputs = inputs.without_map()
    result, plan = solved(inputs, loss)
    problem = build(inputs, *plan, loss)
    landmark = np.zeros((0, 2)) if result.map is None else result.map.xy
    marginals = gtsam.Marginals(problem.graph(), problem.values(Start(result.trajectory.pose, landmark)))
    body = np.array([marginals.marginalCovariance(X(k)) for k in range(len(inputs))])
    expected = in_world(result.trajectory.pose, body)
    np.testing.assert_allclose(result.trajectory.covariance, expected, atol=1e-7 * np.abs(expected).max())
    if result.map is not None:
        expected = np.array([marginals.marginalCovariance(L(n)) for n in result.map.number.tolist()])
        np.testing.assert_allclose(result.map.covariance, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("P0", [
    np.zeros((3, 3)), np.diag([0.01, 0.01, 0.0]), 0.01 * np.ones((3, 3)), np.diag([0.0, 0.02, 0.01]),
    1e-9 * np.eye(3),
], ids=["zero", "heading exact", "rank one", "x exact", "tiny"])  # fmt: skip
def test_without_sightings_the_first_pose_keeps_its_prior_covariance_however_singular(P0):
    inputs, _, _ = circle(RelativePoint(), P0=P0, heading=2.2, noise=0.0)
    nothing = np.full(len(inputs.observations.frame), -2)
    run = run_filter(inputs, nothing)
    result = smooth(inputs, nothing, np.full(len(nothing), -1), Start(run.pose, np.empty((0, 2))))
    np.testing.assert_allclose(result.trajectory.pose, run.pose, atol=1e-9)
    np.testing.assert_allclose(result.trajectory.covariance, run.covariance, atol=1e-11)


POINTS = np.array([[2.0, 1.0], [3.0, -1.0], [1.0, -2.0]])


def still(frames, motion, prior, known=None):
    """A robot at rest that observes every point once in each frame; all is where it is."""
    frame, number = np.repeat(np.arange(frames), len(POINTS)), np.tile(np.arange(len(POINTS)), frames)
    inputs = logs.inputs_of(
        logs.still(frames, motion), logs.observations_of(frame, POINTS[number]), known=known, spread=prior
    )
    found = smooth(inputs, number, np.full(len(number), -1), Start(np.zeros((frames, 3)), POINTS), with_shares=True)
    return found.residual_share.reshape(frames, -1, 2), found.dof


def test_a_point_seen_n_times_from_known_poses_leaves_all_but_an_nth_and_seen_once_nothing():
    np.testing.assert_allclose(still(4, 1e-12, 1e-12)[0], 0.75, atol=1e-6)
    np.testing.assert_allclose(still(1, 1.0, 1e-12)[0], 0.0, atol=1e-6)


def test_a_pose_known_by_its_observations_alone_takes_three_of_them():
    share, dof = still(5, 1e6, 1e6, LandmarkMap(np.arange(3), POINTS))
    np.testing.assert_allclose(share.sum(axis=(1, 2)), 3.0, atol=1e-4)
    assert dof == 30  # as many as numbers observed: prior and motion have the others


@pytest.mark.parametrize("name", ["arena:0:frames=20", "corridor:0:people"])
def test_residuals_of_drawn_noise_are_as_large(name):
    log = named_log(name)
    inputs = log.inputs(labels=True).without_map()
    number, seen = log.truth.landmark_of, log.recorded.observations
    places = np.zeros((int(log.truth.landmarks.id.max()) + 1, 2))
    places[log.truth.landmarks.id] = log.truth.landmarks.xy
    start = Start(log.truth.pose, places)
    found = smooth(inputs, np.where(number < 0, -2, number), np.full(len(number), -1), start, with_shares=True)
    used = number >= 0
    residual = inputs.sensor.residual(
        seen.z[used], inputs.sensor.predict(
            found.trajectory.pose[seen.frame[used]],
            found.map.xy[np.searchsorted(found.map.number, number[used])],
        ),
    )  # fmt: skip
    squares = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(seen.R[used]), residual)
    expected = found.residual_share.sum(axis=1)
    assert squares.sum() == pytest.approx(expected.sum(), abs=4.0 * np.sqrt(2.0 * expected.sum()))
    assert ((found.residual_share >= 0.0) & (found.residual_share <= 1.0)).all()

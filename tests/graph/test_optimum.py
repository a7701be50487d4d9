"""The optimum: reached from bad starts, the same whoever looks for it, and said not to be one where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from association.decide import known_decisions
from data.worlds.registry import named_log
from ekf.whole_run import run_filter
from graph import optimum
from graph.batch import build, smooth
from graph.optimum import NotConvergedError
from graph.problem import Start
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


@pytest.mark.parametrize(
    "name",
    [slow("park:1:frames=535"), slow("park:2:frames=500+spacing=8+sigma_range=.5"), HARD],
)
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


def test_a_search_that_is_cut_short_says_how_far_it_came(monkeypatch):
    _, inputs, decisions, created = labelled("park:1:frames=300")
    monkeypatch.setattr(optimum, "MOST", 0)
    monkeypatch.setattr(optimum, "FURTHER", 0)
    with pytest.raises(
        NotConvergedError, match=r"did not converge: after \d+ steps .* sigma are left at .* weakest is"
    ):
        smooth(inputs, decisions, created, filtered(inputs, decisions))


def test_a_landmark_that_has_come_to_lie_on_the_robot_is_named_as_a_likely_reason(monkeypatch):
    """Where it was seen from no bearing has a slope; here whatever is nearer than five metres counts as there."""
    _, inputs, decisions, created = labelled("park:1:frames=300")
    monkeypatch.setattr(optimum, "MOST", 0)
    monkeypatch.setattr(optimum, "FURTHER", 0)
    monkeypatch.setattr(optimum, "ON_THE_ROBOT", 5.0)
    with pytest.raises(NotConvergedError, match=r"; landmark \d+ is only .* m from the robot at frame \d+"):
        smooth(inputs, decisions, created, filtered(inputs, decisions))


def test_loosened_increments_are_nowhere_better_known_than_a_share_of_their_worst():
    _, inputs, decisions, created = labelled("park:1:frames=50")
    loose = build(inputs, decisions, created).loosened(0.3)
    for factor, stated in zip(loose.motion.factors(), inputs.increments.covariance[1:], strict=True):
        covariance = np.linalg.inv(factor.noiseModel().R().T @ factor.noiseModel().R())[:2, :2]
        best, worst = np.linalg.eigvalsh(stated[:2, :2])
        np.testing.assert_allclose(np.linalg.eigvalsh(covariance), [best + 0.09 * worst, 1.09 * worst], rtol=1e-6)


@pytest.mark.parametrize("search", ["_damped", "_dog_leg"])
def test_before_it_gives_up_damped_steps_and_the_dog_leg_are_tried(search, monkeypatch):
    """Own searches of one step each fail here; either of the others reaches the optimum alone."""
    _, inputs, decisions, created = labelled("park:1:frames=300")
    start = filtered(inputs, decisions)
    whole = smooth(inputs, decisions, created, start)
    monkeypatch.setattr(optimum, "MOST", 1)
    (other,) = {"_damped", "_dog_leg"} - {search}
    monkeypatch.setattr(optimum, other, lambda problem, values: values)
    helped = smooth(inputs, decisions, created, start)
    assert helped.cost == pytest.approx(whole.cost, rel=1e-7)
    assert helped.last_step < 1e-2

"""A large map is parked without being asked: every decision, estimate and size is that of the filter that does not."""

from __future__ import annotations

import numpy as np
import pytest

from data.worlds.registry import named_log
from ekf import whole_run as epochs
from eval.replay import map_management
from eval.replay.frontend import FrontEnd
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from tests.eval.replay.worlds import slam

PLAIN = Setup()


@pytest.fixture(scope="module")
def park():
    """250 frames through few crossings, so that many landmarks are seen again after a loop."""
    return named_log("park:5:frames=250+spacing=4+block=25+revisits=3")


@pytest.fixture
def eager(monkeypatch):
    """Maps of ten landmarks are parked, and again at every chance."""

    def switch(on):
        monkeypatch.setattr(map_management, "LEAST", 10 if on else 10**9)
        monkeypatch.setattr(map_management, "KEPT", 3)
        monkeypatch.setattr(map_management, "PRODUCT", 1e-13)
        monkeypatch.setattr(map_management, "MOVED", 1e-12)
        monkeypatch.setattr(epochs, "LEAST", 10 if on else 10**9)
        monkeypatch.setattr(epochs, "WORTH", np.inf)

    return switch


def assert_same_run(run, plain):
    np.testing.assert_array_equal(run.decisions, plain.decisions)
    np.testing.assert_array_equal(run.created, plain.created)
    np.testing.assert_array_equal(run.state_size, plain.state_size)
    sigma = np.sqrt(np.diagonal(plain.online.covariance, axis1=1, axis2=2))
    assert np.max(np.abs(run.online.pose - plain.online.pose) / (sigma + 1e-9)) < 1e-9
    scale = np.abs(plain.online.covariance).max(axis=(1, 2))
    assert np.max(np.abs(run.online.covariance - plain.online.covariance).max(axis=(1, 2)) / (scale + 1e-15)) < 1e-9
    np.testing.assert_allclose(run.innovations.nis, plain.innovations.nis, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(run.innovations.dof, plain.innovations.dof)
    np.testing.assert_allclose(run.gated, plain.gated, rtol=1e-9)
    np.testing.assert_array_equal(run.map.number, plain.map.number)
    np.testing.assert_allclose(run.map.xy, plain.map.xy, atol=1e-9)
    np.testing.assert_allclose(run.map.covariance, plain.map.covariance, rtol=1e-9, atol=1e-9)
    assert run.notes == plain.notes


def watched(monkeypatch):
    """Lengths of the state at every update, and how often landmarks came back."""
    sizes, back = [], []
    see, restore = map_management.AutomaticParking.see, map_management.AutomaticParking._restore

    def seen(self, observations, numbers):
        sizes.append(self.slam.size)
        see(self, observations, numbers)

    def restored(self, numbers):
        back.append(len(numbers))
        restore(self, numbers)

    monkeypatch.setattr(map_management.AutomaticParking, "see", seen)
    monkeypatch.setattr(map_management.AutomaticParking, "_restore", restored)
    return sizes, back


@pytest.mark.parametrize(
    ("method", "setup"),
    [
        ("jcbb", PLAIN),
        ("jcbb", Setup(forget_after=120, maintain=True)),
        pytest.param("nn", Setup(gate=0.9, new_gate=0.99), marks=pytest.mark.slow),
        pytest.param("ml-ratio", Setup(new_gate=None), marks=pytest.mark.slow),
        pytest.param("gnn", PLAIN, marks=pytest.mark.slow),
        ("known", Setup(maintain=True, gate_known=0.99)),
    ],
)
def test_no_decision_and_no_estimate_changes(park, eager, monkeypatch, method, setup):
    inputs = slam(park, labels=method == "known")
    eager(False)
    plain = step_by_step("ekf", inputs, "slam", method, setup)
    eager(True)
    sizes, back = watched(monkeypatch)
    assert_same_run(step_by_step("ekf", inputs, "slam", method, setup), plain)
    assert np.mean(np.array(sizes) < 0.7 * plain.state_size.max()) > 0.3
    assert sum(back) > 10


def test_who_cannot_park_or_needs_every_landmark_is_left_alone(lab):
    def parks(name, method="jcbb", setup=PLAIN, given=None):
        return isinstance(FrontEnd(name, method, given or slam(lab), setup).parking, map_management.AutomaticParking)

    assert parks("ekf")
    assert parks("ekf", "ml-ratio", Setup(new_gate=None))
    assert not parks("ekf", setup=Setup(new_gate=None))
    assert not parks("ekf", setup=Setup(gate=None))
    assert not parks("ekf", setup=Setup(deactivate_after=5))
    assert not any(parks(name) for name in ("ekf-iterated", "ekf-fej", "ekf-invariant", "isam2"))
    assert not parks("ekf", given=lab.inputs())

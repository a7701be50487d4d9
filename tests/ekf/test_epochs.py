"""A whole log in epochs, most of the map parked, is the filter that never parks: same numbers, less work."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data.inputs import Systematic
from data.result import DISCARD
from data.worlds.registry import named_log
from ekf import whole_run as epochs
from ekf.filter import FilterOptions
from ekf.whole_run import plan, run_filter, run_in_epochs, worthwhile


@pytest.fixture(scope="module")
def park():
    """800 frames, some 80 landmarks, with loops; some readings are of nothing."""
    inputs = named_log("park:1:frames=800+spacing=2.5").inputs(labels=True).without_map()
    decisions, _ = known_decisions(inputs)
    return inputs, np.where((decisions >= 0) & (np.arange(len(decisions)) % 97 == 0), DISCARD, decisions)


def assert_same_run(run, plain):
    """Within 1e-9: poses in standard deviations, covariances and NIS relative to themselves."""
    sigma = np.sqrt(np.diagonal(plain.covariance, axis1=1, axis2=2))
    assert np.nanmax(np.abs(run.pose - plain.pose) / sigma) < 1e-9
    scale = np.abs(plain.covariance).max(axis=(1, 2))
    assert np.nanmax(np.abs(run.covariance - plain.covariance).max(axis=(1, 2)) / scale) < 1e-9
    np.testing.assert_allclose(run.nis, plain.nis, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run.log_likelihood, plain.log_likelihood, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(run.white, plain.white, rtol=1e-9, atol=1e-8)
    np.testing.assert_array_equal(run.dof, plain.dof)
    np.testing.assert_array_equal(run.state_size, plain.state_size)
    np.testing.assert_array_equal(run.decisions, plain.decisions)
    np.testing.assert_array_equal(run.map.number, plain.map.number)
    np.testing.assert_allclose(run.map.xy, plain.map.xy, atol=1e-9)
    np.testing.assert_allclose(
        run.map.covariance, plain.map.covariance, rtol=1e-9, atol=1e-9 * plain.map.covariance.max()
    )
    assert run.failure == plain.failure


@pytest.mark.parametrize(
    ("options", "threshold"),
    [
        (FilterOptions(), np.inf),
        (FilterOptions(), 3.0),
        (FilterOptions(first_estimates=True), np.inf),
        (FilterOptions(new_variance=4.0), np.inf),
    ],
)
def test_epochs_change_nothing(park, options, threshold):
    inputs, decisions = park
    found = plan(decisions, inputs.start).epochs
    run = run_in_epochs(inputs, decisions, found, threshold=threshold, options=options)
    assert_same_run(run, run_filter(inputs, decisions, threshold=threshold, options=options))
    if np.isfinite(threshold):
        assert (run.decisions != decisions).sum() > 20, "gated while landmarks were parked"
    active = np.array([len(e.active) for e in found])
    assert np.sum(active < 0.3 * len(run.map.number)) > 10, "most of the map is parked most of the time"


@pytest.mark.parametrize("options", [FilterOptions(), FilterOptions(first_estimates=True)], ids=["plain", "fej"])
def test_epochs_change_nothing_where_systematic_errors_are_estimated(park, options):
    inputs, decisions = park
    of = Systematic(("left", "drift", "range", "bearing"), np.full(4, 0.01), 20.0)
    inputs = replace(inputs, systematic=of, sensor=replace(inputs.sensor, translation=(0.1, -0.05)))
    run = run_in_epochs(inputs, decisions, plan(decisions, inputs.start).epochs, options=options)
    plain = run_filter(inputs, decisions, options=options)
    assert_same_run(run, plain)
    np.testing.assert_allclose(run.errors.mean, plain.errors.mean, atol=1e-11)
    np.testing.assert_allclose(run.errors.sigma, plain.errors.sigma, rtol=1e-9)


def test_epochs_of_any_length_give_the_same(park, monkeypatch):
    inputs, decisions = park
    plain = run_filter(inputs, decisions)
    lengths = []
    for share in (0.01, 30.0):
        monkeypatch.setattr(epochs, "PRODUCT", share * 1e-10)
        monkeypatch.setattr(epochs, "MOVED", share * 1e-8)
        found = plan(decisions, inputs.start).epochs
        lengths.append(len(found))
        assert [e.end for e in found[:-1]] == [e.begin for e in found[1:]]
        assert_same_run(run_in_epochs(inputs, decisions, found), plain)
    assert lengths[0] > 2 * lengths[1]


def test_a_failure_is_that_of_the_plain_filter(park):
    """Half way the covariance of an increment is negative: written into the inputs, which are checked when made."""
    given, decisions = park
    inputs, at = copy.deepcopy(given), len(given) // 2
    covariance = inputs.increments.covariance
    covariance.setflags(write=True)
    covariance[at] = -1e3 * np.eye(3)
    run = run_in_epochs(inputs, decisions, plan(decisions, inputs.start).epochs)
    plain = run_filter(inputs, decisions)
    assert run.failure == plain.failure
    assert plain.failure[0] == at
    np.testing.assert_array_equal(run.state_size, plain.state_size)
    assert len(run.map.number) == len(plain.map.number)
    np.testing.assert_array_equal(np.isnan(run.pose), np.isnan(plain.pose))


def test_a_small_map_and_filters_that_move_everything_are_left_alone(park, monkeypatch):
    inputs, decisions = park
    assert worthwhile(inputs, decisions) is None, "too few landmarks"
    monkeypatch.setattr(epochs, "LEAST", 50)
    assert worthwhile(inputs, decisions) is not None
    assert worthwhile(inputs, decisions, FilterOptions(first_estimates=True)) is not None
    assert worthwhile(inputs, decisions, FilterOptions(invariant=True)) is None
    assert worthwhile(inputs, decisions, FilterOptions(iterations=3)) is None

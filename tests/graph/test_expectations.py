"""What iSAM2 expects to see, which landmarks may be in view, and its gate: those of the filter."""

from dataclasses import replace

import numpy as np
import pytest

from association.candidates import UncertaintyBounds, in_view, may_be_in_view
from association.decide import known_decisions
from data.inputs import LabelledObservations, Prior
from ekf.slam import EkfSlam
from graph import incremental as expected
from graph.incremental import Isam2Smoother
from tests.builders.estimators import ekf_of
from tests.graph.worlds import TIGHT, both_tasks, circle, drive, every_sensor, for_task, lagged


@every_sensor
@both_tasks
@pytest.mark.parametrize("lag", [None, 3.0], ids=["isam2", "fixed lag"])
def test_it_expects_what_the_filter_expects(sensor, task, lag):
    """Noise-free, so that both linearize at the truth; two frames after the last update."""
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = for_task(inputs, task)
    decisions, _ = known_decisions(inputs)
    twin = ekf_of(inputs)
    s, *_ = drive(inputs, decisions, until=20, smoother=None if lag is None else lagged(inputs, lag, **TIGHT), **TIGHT)
    drive(inputs, decisions, until=20, smoother=twin)
    for k in (20, 21):
        s.predict(inputs.increment(k))
        twin.predict(inputs.increment(k))
    ours, filters = s.expect(inputs.frame_observations(21)), twin.expect(inputs.frame_observations(21))
    assert 0 < len(ours.number) < len(filters.number)
    rows = np.searchsorted(filters.number, ours.number)
    np.testing.assert_array_equal(filters.number[rows], ours.number)
    np.testing.assert_allclose(ours.z_hat, filters.z_hat[rows], atol=1e-6)
    np.testing.assert_allclose(ours.HPHt, filters.HPHt[rows], atol=1e-7)
    pick = np.array([2, 0, 1])
    np.testing.assert_allclose(ours.joint(pick), filters.joint(rows[pick]), atol=1e-7)
    np.testing.assert_array_equal(ours.frame, 0)
    assert (ours.z == inputs.frame_observations(21).z).all()


@every_sensor
def test_the_quick_cut_keeps_everything_the_exact_one_keeps(sensor):
    """Against the filter's covariance over all landmarks, with a narrow view and a lot of uncertainty."""
    narrow = replace(sensor, max_range=4.0, min_angle=-0.6, max_angle=0.9)
    inputs, _, _ = circle(sensor, noise=0.0, landmarks=25)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    drift, kept = UncertaintyBounds(), 0
    for k in range(20):
        drive(inputs, decisions, until=k, smoother=(twin := EkfSlam(inputs.prior, inputs.sensor)))
        n = (twin.size - 3) // 2
        xy, P = twin.mean[3:].reshape(n, 2), twin.covariance
        if k:
            drift.move(inputs.increment(k))
        everything = expected.form(narrow, twin.mean[:3], P, np.arange(n), xy, inputs.frame_observations(k))
        exact = in_view(narrow, everything.z_hat, everything.HPHt)
        rows = slice(inputs.start[k], inputs.start[k + 1])
        number = np.where(created[rows] >= 0, created[rows], decisions[rows])
        drift.see(sensor, inputs.frame_observations(k), number, P[:3, :3])
        quick = may_be_in_view(narrow, twin.mean[:3], xy, *drift.sigmas(np.arange(n), P[:3, :3]))
        assert not (exact & ~quick).any()
        kept += quick.sum() < n
    assert kept > 10  # and it does cut


@every_sensor
@both_tasks
def test_the_gate_and_its_statistics_are_the_filters(sensor, task):
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = for_task(inputs, task)
    o = inputs.observations
    decisions, created = known_decisions(inputs)
    z = o.z.copy()
    # in the last frame only, so that all that went before is noise-free: one outlier, two small errors
    last = np.flatnonzero((o.frame == o.frame[-1]) & (created < 0))
    z[last[:3]] += [[1.5, 0.4], [0.05, -0.03], [-0.02, 0.04]]
    inputs = replace(inputs, observations=LabelledObservations(o.frame, z, o.R, o.label))
    twin = ekf_of(inputs)
    ours = drive(inputs, decisions, gate=11.0, until=int(o.frame[-1]) + 1, **TIGHT)[3]
    filters = drive(inputs, decisions, gate=11.0, until=int(o.frame[-1]) + 1, smoother=twin)[3]
    for a, b in zip(ours, filters, strict=True):
        np.testing.assert_array_equal(a.used, b.used)
        np.testing.assert_array_equal(a.created, b.created)
        assert a.dof == b.dof
        if b.dof:
            assert a.nis == pytest.approx(b.nis, abs=1e-5)
            assert a.log_likelihood == pytest.approx(b.log_likelihood, abs=1e-5)
    assert not ours[-1].used[0]
    assert ours[-1].nis > 1e-3
    ungated = drive(inputs, decisions)[3][-1]
    assert ungated.dof == 0
    assert np.isnan(ungated.nis)
    assert np.isnan(ungated.log_likelihood)


@pytest.mark.parametrize("variance", [(0.0, 0.0, 0.0), (1e-4, 1e-4, 0.0), (0.0, 0.0, 1e-4), (0.01, 0.02, 0.001)])
@every_sensor
def test_the_first_expectations_are_the_filters_whatever_the_prior(sensor, variance):
    """While the first pose is the only one in the graph: an exact prior is a hard constraint there."""
    inputs, _, _ = circle(sensor, noise=0.0, landmarks=25)
    inputs = replace(inputs.without_map(), prior=Prior(inputs.prior.mean, np.diag(variance)))
    decisions, _ = known_decisions(inputs)
    ours, twin = Isam2Smoother(inputs.prior, inputs.sensor), EkfSlam(inputs.prior, inputs.sensor)
    for k in range(3):
        rows = slice(inputs.start[k], inputs.start[k + 1])
        observations = inputs.frame_observations(k)
        if k:
            a, b = (e.predict(inputs.increment(k)) or e.expect(observations).by_age() for e in (ours, twin))
            both = np.intersect1d(a.number, b.number)
            assert len(both) > 2
            A, B = (e.joint(np.searchsorted(e.number, both)) for e in (a, b))
            np.testing.assert_allclose(A, B, atol=1e-4 * np.abs(B).max())
        for e in (ours, twin):
            e.update(observations, decisions[rows])

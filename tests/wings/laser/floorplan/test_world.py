"""Logs of the floor plan: stated noise is the noise, the path comes back to where it was, switches do what they say."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import UsageError
from data.se2 import between, dead_reckoned, pose_error
from data.worlds.registry import named_log
from wings.laser.floorplan.world import Floorplan, plan_of, scan_ranges, simulate

SHORT = 400


@pytest.fixture(scope="module")
def log():
    return named_log(f"floorplan:3:frames={SHORT}")


def test_ranges_have_the_noise_that_the_scanner_states(log):
    scans = log.inputs().scans
    exact = scan_ranges(log.truth.pose, scans.scanner, 180, plan_of(3).walls)
    error = (scans.ranges - exact)[scans.ranges > 0]
    np.testing.assert_allclose(error.std(), scans.scanner.sigma, rtol=0.02)
    assert abs(error.mean()) < 4.0 * scans.scanner.sigma / np.sqrt(error.size)


@pytest.mark.parametrize("slip", [0.0, 0.05])
def test_increments_have_the_covariance_that_they_state(slip):
    nees = []
    for seed in range(2):
        log = simulate(Floorplan(frames=4000, thin=4000, slip=slip), seed)
        p, increments = log.truth.pose, log.inputs().increments
        e = pose_error(increments.mean[1:], between(p[:-1], p[1:]))
        nees.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(increments.covariance[1:]), e))
    # standard error of the mean: of the sample, for slips are rare and large
    pooled = np.concatenate(nees)
    assert abs(pooled.mean() - 3.0) < 4.0 * pooled.std() / np.sqrt(pooled.size)
    assert (pooled.max() > 60.0) == (slip > 0.0)


@pytest.mark.slow
def test_odometry_drifts_by_metres_and_the_robot_comes_back_by_both_directions():
    log = simulate(Floorplan(thin=3000), 0)
    p = log.truth.pose
    reckoned = dead_reckoned(log.inputs().prior.mean, log.inputs().increments.mean)
    assert 1.0 < np.hypot(*(reckoned - p)[:, :2].T).mean() < 10.0
    near = np.hypot(*(p[:, None, :2] - p[None, :, :2])[::10, ::10].transpose(2, 0, 1)) < 0.4
    later = np.subtract.outer(np.arange(300), np.arange(300)) > 30  # one minute
    turned = np.cos(p[::10, None, 2] - p[None, ::10, 2])
    assert (near & later & (turned > 0.9)).sum() > 20
    assert (near & later & (turned < -0.9)).sum() > 20


def test_same_seed_same_log_and_a_switch_reshuffles_nothing(log):
    again = named_log(f"floorplan:3:frames={SHORT}").inputs()
    assert again.scans.ranges.tobytes() == log.inputs().scans.ranges.tobytes()
    assert again.increments.mean.tobytes() == log.inputs().increments.mean.tobytes()
    plain, seen = log.inputs().scans.ranges, named_log(f"floorplan:3:frames={SHORT}+people").inputs()
    nearer = seen.scans.ranges < plain
    assert (seen.scans.ranges == plain)[~nearer].all()
    assert 0.001 < nearer.mean() < 0.5
    glass = named_log(f"floorplan:3:frames={SHORT}+glass").inputs().scans.ranges
    lost = glass == 0.0
    assert 0.02 < lost.mean() < 0.5
    np.testing.assert_allclose(glass[~lost], plain[~lost], atol=1e-9)


def test_thin_logs_have_fewer_scans_and_the_same_ones(log):
    thin = named_log(f"floorplan:3:frames={SHORT}+thin=5").inputs()
    assert len(thin.time) == SHORT
    np.testing.assert_array_equal(thin.scans.frame, np.arange(0, SHORT, 5))
    assert thin.scans.of(1) is None


@pytest.mark.parametrize("key", ["frames=0", "beams=0", "slip=1.5", "panes=2", "field_of_view=361", "glass=maybe"])
def test_parameters_out_of_range_are_refused(key):
    with pytest.raises(UsageError, match=key.partition("=")[0]):
        named_log(f"floorplan:0:{key}")

"""The filters do what the textbook says, step by step and in one loop, and give the same bytes either way."""

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.inputs import FrameObservations, Inputs, LandmarkMap, Prior
from data.result import NEW
from data.sensors import RangeBearing, RelativePoint
from data.worlds.arena import Arena, simulate
from ekf.filter import FilterDivergedError, FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.parking import ROWS, Triangle, root
from ekf.slam import EkfSlam
from ekf.updates import subtract
from ekf.whole_run import run_filter
from tests.builders.estimators import drive, ekf_of
from tests.builders.logs import map_of, observations_of
from tests.oracle import reference_ekf as reference

SMALL = Arena(landmarks=8, side=14.0, frames=25)


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_point"])
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("threshold", [np.inf, 5.0])
def test_whole_run_agrees_with_the_textbook_and_bit_for_bit_with_the_steps(sensor, task, threshold):
    inputs = simulate(Arena(**{**vars(SMALL), "sensor": sensor}), 3).inputs(labels=True)
    if task == "slam":
        inputs = inputs.without_map()
    decisions, _ = known_decisions(inputs)
    run = run_filter(inputs, decisions, threshold=threshold)
    pose, covariance, _ = drive(ekf_of(inputs), inputs, decisions, threshold=threshold)
    assert np.array_equal(run.pose, pose)
    assert np.array_equal(run.covariance, covariance)
    o = inputs.observations
    x, P, nis, *_ = reference.run(
        inputs.sensor.kind, inputs.sensor.extrinsic, inputs.prior.mean, inputs.prior.covariance,
        inputs.increments.mean, inputs.increments.covariance, o.frame, o.z, o.R, decisions,
        None if inputs.map is None else inputs.map.xy, threshold,
    )  # fmt: skip
    assert np.abs(se2.pose_error(run.pose, x)).max() < 1e-8
    assert np.abs(run.covariance - P).max() < 1e-9
    assert np.allclose(run.nis, nis, rtol=1e-6, atol=1e-6)
    if threshold < np.inf:
        assert (run.decisions != decisions).any(), "the gate rejects something in this world"


@pytest.mark.parametrize("heading", [0.3, np.pi - 1e-9, -np.pi + 1e-9])
def test_bearing_innovation_is_wrapped_at_the_seam(heading):
    prior = Prior(np.array([0.0, 0.0, heading]), np.diag([1e-4, 1e-4, 1e-4]))
    behind = LandmarkMap(np.array([0]), np.array([[-5.0 * np.cos(heading), -5.0 * np.sin(heading)]]))
    f = EkfLocalizer(prior, RangeBearing(), behind)
    f.update(FrameObservations(np.array([[5.0, -np.pi + 0.001]]), np.diag([0.01, 1e-4])[None]), np.array([0]))
    assert abs(se2.wrap_angle(f.estimate().mean[2] - heading)) < 0.01


def test_tutorial_options_add_uncorrelated_landmarks():
    prior = Prior(np.zeros(3), 0.1 * np.eye(3))
    z, R = np.array([[3.0, 0.3], [2.9, -0.7]]), np.tile(np.diag([0.04, 0.01]), (2, 1, 1))
    slam = EkfSlam(prior, RangeBearing(), FilterOptions(new_variance=10.0))
    slam.update(FrameObservations(z[:1], R[:1]), np.array([NEW]))
    assert np.array_equal(slam.covariance[3:, 3:], 10.0 * np.eye(2))
    assert not slam.covariance[3:, :3].any()
    slam = EkfSlam(prior, RangeBearing(), FilterOptions(new_variance_per_square=1 / 130))
    slam.update(FrameObservations(z[:1], R[:1]), np.array([NEW]))
    np.testing.assert_allclose(slam.covariance[3:, 3:], z[0, 0] ** 2 / 130 * np.eye(2), rtol=1e-15)
    assert not slam.covariance[3:, :3].any()


def driven(seed: int) -> tuple[EkfSlam, Inputs]:
    inputs = simulate(SMALL, seed).inputs(labels=True).without_map()
    f = EkfSlam(inputs.prior, inputs.sensor)
    drive(f, inputs, known_decisions(inputs)[0])
    return f, inputs


def test_removing_a_landmark_marginalizes_it_out_and_its_number_is_not_reused():
    f, _ = driven(5)
    before, P = f.mean, f.covariance
    f.remove(np.array([1]))
    stay = np.r_[0:5, 7 : len(before)]
    assert np.array_equal(f.mean, before[stay])
    assert np.array_equal(f.covariance, P[np.ix_(stay, stay)])
    last = f.created
    f.update(FrameObservations(np.array([[2.0, 0.0]]), 0.01 * np.eye(2)[None]), np.array([NEW]))
    assert f.finish().map.number[-1] == last
    with pytest.raises(ValueError, match="not all are in the map"):
        f.remove(np.array([1]))
    with pytest.raises(ValueError, match="no landmark has number 1"):
        f.update(FrameObservations(np.array([[2.0, 0.0]]), 0.01 * np.eye(2)[None]), np.array([1]))


def test_expectation_blocks_are_those_of_the_joint_and_go_stale():
    f, inputs = driven(2)
    e = f.expect(inputs.frame_observations(0))
    joint = e.joint(np.arange(len(e.number)))
    for i in range(len(e.number)):
        assert np.allclose(joint[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], e.HPHt[i], atol=1e-14)
    picked = np.array([3, 1])
    assert np.allclose(e.joint(picked)[:2, 2:], joint[6:8, 2:4], atol=1e-15)
    mean, P = f.mean, f.covariance
    H = reference.numeric_jacobian(
        lambda s: np.concatenate([reference.expected(0, (0, 0, 0), s[:3], s[3 + 2 * i : 5 + 2 * i]) for i in picked]),
        mean,
    )
    assert np.allclose(e.joint(picked), H @ P @ H.T, atol=1e-8)
    f.predict(inputs.increment(1))
    with pytest.raises(RuntimeError, match="updated since"):
        e.joint(picked)


def test_landmark_at_the_robot_carries_no_information_and_no_nan():
    f = EkfLocalizer(Prior(np.zeros(3), 0.01 * np.eye(3)), RangeBearing(), LandmarkMap(np.array([0]), np.zeros((1, 2))))
    f.update(FrameObservations(np.array([[0.1, 0.2]]), np.diag([0.01, 0.01])[None]), np.array([0]))
    mean, P = f.estimate()
    assert np.isfinite(mean).all()
    assert np.array_equal(P, 0.01 * np.eye(3))


def test_singular_innovation_covariance_is_a_divergence_not_a_nan():
    f = EkfLocalizer(
        Prior(np.zeros(3), np.zeros((3, 3))), RangeBearing(), LandmarkMap(np.array([0]), np.array([[1.0, 0]]))
    )
    with pytest.raises(FilterDivergedError, match="positive definite"):
        f.update(FrameObservations(np.array([[1.0, 0.0]]), np.zeros((1, 2, 2))), np.array([0]))


def test_failure_in_the_whole_run_blanks_the_rest_and_names_the_frame():
    inputs = simulate(SMALL, 0).inputs(labels=True)
    o = inputs.observations
    R = o.R.copy()
    bad = np.flatnonzero(o.frame == 7)
    assert len(bad)
    R[bad] = np.array([[1.0, 0.0], [0.0, -1e9]])
    broken = replace(inputs, observations=replace(o, R=R))
    run = run_filter(broken, known_decisions(broken)[0])
    assert run.failure[0] == 7
    assert np.isnan(run.pose[7:]).all()
    assert np.isfinite(run.pose[:7]).all()


def test_the_innovation_of_a_reading_beyond_the_gate_is_no_number():
    f = EkfLocalizer(Prior(np.zeros(3), 1e-12 * np.eye(3)), RelativePoint(), map_of([[1.0, 0.0]]))
    seen = observations_of([0, 0], [[1.1, 0.0], [3.0, 0.0]])
    done = f.update(FrameObservations(seen.z, seen.R), np.array([0, 0]), threshold=9.0)
    np.testing.assert_allclose(done.white, [[1.0, 0.0], [np.nan, np.nan]], atol=1e-4)


def test_columns_products_and_squares_are_those_of_the_dense_matrix():
    rng = np.random.default_rng(0)
    t, dense = Triangle(), np.zeros((0, 0))
    for size in (40, ROWS, 2 * ROWS + 100, 4 * ROWS + 2):
        t.grow(size)
        larger = np.zeros((size, size))
        larger[: len(dense), : len(dense)] = dense
        dense = larger
        index = rng.permutation(size)[:30]
        columns = rng.normal(size=(size, 30))
        columns[index] = columns[index] + columns[index].T
        t.put(index, columns)
        dense[:, index], dense[index] = columns, columns.T
        C, S = rng.normal(size=(size, 9)), rng.normal(size=(9, 9))
        t.add_product(C @ (S + S.T), C)
        dense += C @ (S + S.T) @ C.T
        index = rng.permutation(size)[:20]
        np.testing.assert_allclose(t.columns(index), dense[:, index], atol=1e-11)
        index.sort()
        np.testing.assert_allclose(t.square(index), dense[np.ix_(index, index)], atol=1e-11)
        at = np.arange(size).reshape(-1, 2)
        np.testing.assert_allclose(t.blocks(), dense[at[:, :, None], at[:, None, :]], atol=1e-11)


def test_a_singular_covariance_has_a_regular_root():
    P = np.diag([1.0, 0.0, 4.0])
    P[0, 2] = P[2, 0] = 2.0
    L = root(P)
    assert np.diag(L).min() > 0.0
    np.testing.assert_allclose((L @ L.T)[np.ix_([0, 2], [0, 2])], P[np.ix_([0, 2], [0, 2])], rtol=1e-6)


@pytest.mark.parametrize("d", [3, 63, 64, 101, 801])
def test_the_update_of_a_covariance_has_the_same_bytes_whichever_way_it_goes(d):
    W = 0.01 * np.random.default_rng(d).normal(size=(d, 6))
    P = np.eye(d)
    subtract(P, d, W)
    expected = np.zeros((d, d))
    for i in range(6):
        expected += W[:, i : i + 1] * W[:, i]
    np.testing.assert_array_equal(P, np.eye(d) - expected)

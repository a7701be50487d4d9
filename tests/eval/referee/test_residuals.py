"""Smoothed residuals, systematic errors in them, and explanations that compete by likelihood."""

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Increments, Observations
from data.logs import open_log
from data.se2 import between, compose, interpolate, pose_error
from eval.referee import residuals
from eval.referee.effects import DELAYS, effects, scored, without
from eval.referee.explanations import ALIKE, evidence_of, explanations
from eval.referee.residuals import Used, misfits, smoothed_residuals, summaries, typical, used_by
from eval.replay.run import compare
from eval.studies.diagnosis import _best
from eval.studies.twins import inputs_of
from tests.quick import slow
from tests.research import confusion


def test_residuals_are_what_was_added_in_stated_sigmas():
    found = smoothed_residuals(*confusion.exact("arena:2"))
    assert np.nanmax(np.abs(found.odometry)) < 1e-9
    assert np.nanmax(np.abs(found.observations)) < 1e-9
    assert np.isnan(found.odometry[0]).all()
    (inputs, path, used), rng = confusion.exact("arena:2"), np.random.default_rng(0)
    o, M = inputs.observations, inputs.increments.covariance
    u, v = rng.normal(size=o.z.shape), rng.normal(size=(len(inputs), 3))
    sigma = np.sqrt(np.einsum("nii->ni", M))
    noisy = replace(
        inputs, increments=Increments(inputs.increments.mean + sigma * v, M),
        observations=Observations(o.frame, o.z + np.sqrt(np.einsum("mii->mi", o.R)) * u, o.R),
    )  # fmt: skip
    found = smoothed_residuals(noisy, path, used)
    assert found.observations == pytest.approx(u, abs=1e-6)
    assert found.odometry[1:] == pytest.approx(v[1:], abs=1e-6)
    assert found.squared == pytest.approx((u**2).sum(axis=1), abs=1e-6)
    statistics = summaries(found, noisy, used)
    assert statistics["residual_z1_mean"] == pytest.approx(u[:, 0].mean())
    assert statistics["residual_odometry_theta_spread"] == pytest.approx(v[1:, 2].std())
    assert statistics["residual_z2_largest"] == pytest.approx(np.abs(u[:, 1]).max())
    assert abs(statistics["residual_odometry_x_lag1"]) < 0.25  # white: 1 / sqrt(200) is one sigma
    assert typical(found)["z1"] == pytest.approx(1.0, abs=0.1)


def test_a_wrong_pairing_fits_another_landmark_and_an_outlier_fits_none():
    inputs, path, used = confusion.exact("arena:2")
    assert misfits(inputs, path, used, smoothed_residuals(inputs, path, used))[:2] == (0, 0)
    wrong = used.number.copy()
    wrong[100] = (wrong[100] + 1) % len(used.landmarks)
    swapped = Used(wrong, used.landmarks, used.identity)
    found = smoothed_residuals(inputs, path, swapped)
    outlying, elsewhere, excess = misfits(inputs, path, swapped, found)
    assert (outlying, elsewhere) == (1, 1)
    assert excess > 0.0
    z = inputs.observations.z.copy()
    z[100] = [60.0, 0.3]
    far = replace(inputs, observations=replace(inputs.observations, z=z))
    assert misfits(far, path, used, smoothed_residuals(far, path, used))[:2] == (1, 0)


@pytest.fixture(scope="module", params=["arena:2", "linear:1"])
def world(request):
    return confusion.exact(request.param)


def test_every_error_is_found_with_its_size_and_comes_out_again(world):
    inputs, path, used = world
    for e in effects(inputs, path, used):
        size = 1e-3
        spoilt = without(inputs, path, used, {e.name: -size})
        said = scored(spoilt, path, used).slopes()
        if e.name in said:
            assert said[e.name][0] == pytest.approx(size, rel=2e-2 if e.name in DELAYS else 1e-3), e.name
        healed = without(spoilt, path, used, {e.name: size})
        if e.name in DELAYS:  # taken out along the motion before, which is not that after
            assert abs(scored(healed, path, used).slopes()[e.name][0]) < 0.1 * size
            continue
        assert healed.observations.z == pytest.approx(inputs.observations.z, abs=1e-12)
        assert healed.increments.mean == pytest.approx(inputs.increments.mean, abs=1e-12)


def test_similar_errors_are_distinguished_jointly(world):
    inputs, path, used = world
    spoilt = without(inputs, path, used, {"odometry_theta_distance": -1e-3, "odometry_theta_turn": -2e-3})
    said = scored(spoilt, path, used)
    chosen = np.array([said.names.index(n) for n in ("odometry_theta_distance", "odometry_theta_turn")])
    sizes, errors = said.together(chosen)
    assert sizes == pytest.approx([1e-3, 2e-3], rel=1e-2)
    assert (errors > 0.0).all()


def test_a_late_observation_is_from_an_earlier_pose_and_a_displaced_sensor_observes_from_elsewhere(world):
    inputs, path, used = world
    o, late, ahead = inputs.observations, 1e-5, 1e-5
    speed = np.gradient(np.column_stack([path[:, :2], np.unwrap(path[:, 2])]), inputs.time, axis=0)
    then = inputs.sensor.predict((path - late * speed)[o.frame], used.landmarks[used.number])
    rate = inputs.sensor.residual(then, o.z) / late
    columns = {e.name: e.observations for e in effects(inputs, path, used)}
    assert columns["latency"] == pytest.approx(rate, abs=1e-3 * np.abs(rate).max())
    age = inputs.time[o.frame] - inputs.time[0]
    assert columns["latency_growth"] == pytest.approx(rate * age[:, None], abs=1e-3 * np.abs(rate * age[:, None]).max())
    moved = path + ahead * np.column_stack([np.cos(path[:, 2]), np.sin(path[:, 2]), np.zeros(len(path))])
    then = inputs.sensor.predict(moved[o.frame], used.landmarks[used.number])
    rate = inputs.sensor.residual(then, o.z) / ahead
    assert columns["mount_x"] == pytest.approx(rate, abs=1e-3 * np.abs(rate).max())


def test_increments_that_turn_first_have_chords_along_their_last_heading_and_none_of_a_current(world):
    inputs, path, used = world
    columns = {e.name: e.motion for e in effects(inputs, path, used)}
    step = between(path[:-1], path[1:])
    turn = 0.5e-3 * step[:, 2]
    rotated = np.column_stack([np.cos(turn) * step[:, 0] - np.sin(turn) * step[:, 1],
                               np.sin(turn) * step[:, 0] + np.cos(turn) * step[:, 1]])  # fmt: skip
    assert 1e-3 * columns["odometry_integration"][1:, :2] == pytest.approx(rotated - step[:, :2], abs=1e-6)
    drifted = path.copy()  # a current moves the robot in the world and odometry does not see it
    drifted[:, 1] += 1e-3 * (inputs.time - inputs.time[0])
    unseen = step - between(drifted[:-1], drifted[1:])
    assert 1e-3 * columns["odometry_current_y"][1:] == pytest.approx(unseen, abs=1e-9)


@pytest.fixture(scope="module")
def log():
    return open_log("arena:5")


def evidence(log):
    inputs = inputs_of(log, "localization", "known")
    (run,) = compare(inputs, "localization", ("batch",), "known")
    return evidence_of(inputs, run.final.pose, residuals.used_by(run, inputs))


def with_noise(log, noise):
    o = log.recorded.observations
    sigma = np.sqrt(np.einsum("mii->mi", o.R))
    return replace(log, recorded=replace(log.recorded, observations=replace(o, z=o.z + sigma * noise)))


def noise_of(log):
    """The noise (M, 2) of a log's observations, in stated sigmas."""
    o, truth = log.recorded.observations, log.truth
    exact = log.recorded.sensor.predict(truth.pose[o.frame], log.recorded.map.positions(truth.landmark_of))
    return log.recorded.sensor.residual(o.z, exact) / np.sqrt(np.einsum("mii->mi", o.R))


def best(log):
    return explanations(evidence(log), [])[0].finding


def test_a_sound_log_needs_no_explanation(log):
    assert explanations(evidence(log), [])[0].net < ALIKE


def test_a_jump_is_found_at_its_frame_with_its_size(log):
    mean = log.recorded.increments.mean.copy()
    mean[80, :2] -= [0.6, -0.8]
    moved = Increments(mean, log.recorded.increments.covariance)
    found = best(replace(log, recorded=replace(log.recorded, increments=moved)))
    assert (found.kind, found.frames) == ("jump", ((80, 80),))
    assert found.size == pytest.approx(1.0, abs=0.1)


def test_frames_without_redundant_odometry_beside_the_largest_are_no_jumps():
    e = confusion.evidence("jump odometry", 0)
    own = e.redundancy.odometry.copy()
    at = int(np.nanargmax(np.nansum(e.odometry**2, axis=1)))
    own[[at - 1, at + 1]] = 0.0
    found = explanations(replace(e, redundancy=e.redundancy._replace(odometry=own)), [])
    frames = {x.finding.frames[0][0] for x in found if x.finding.kind == "jump"}
    assert at in frames
    assert not {at - 1, at + 1} & frames


def test_a_systematic_error_goes_before_a_larger_noise_that_hides_it():
    log = open_log("arena:4:frames=120")
    o = log.recorded.observations
    turned = replace(o, z=o.z + [0.0, 0.015], R=9.0 * o.R)
    inputs = inputs_of(replace(log, recorded=replace(log.recorded, observations=turned)), "localization", "known")
    (smoother,) = compare(inputs, "localization", ("batch",))
    e = evidence_of(inputs, smoother.final.pose, used_by(smoother, inputs))
    assert explanations(e, [])[0].finding.kind == "sigma"
    (found, *_), _ = _best(e, smoother, [])
    assert (found.kind, found.name) == ("systematic", "z2_constant")
    assert found.size == pytest.approx(0.015, abs=0.003)


@pytest.mark.parametrize("task", ["localization", slow("slam")])
def test_a_displaced_sensor_is_no_integration_and_taken_out_exactly(task):
    log = open_log("arena:4")
    r, o, xy = log.recorded, log.recorded.observations, log.truth.landmarks.positions(log.truth.landmark_of)
    pose = log.truth.pose[o.frame]
    moved = r.sensor.predict(compose(pose, np.array([0.3, 0.1, 0.0])), xy)
    z = o.z + r.sensor.residual(moved, r.sensor.predict(pose, xy))
    log = replace(log, recorded=replace(r, observations=replace(o, z=z)))
    inputs = inputs_of(log, task, "known")
    (smoother,) = compare(inputs, task, ("batch",))
    e = evidence_of(inputs, smoother.final.pose, used_by(smoother, inputs))
    (found,), healed = _best(e, smoother, [])
    assert (found.said, found.other) == ("systematic mount", ())
    for part, true in zip(found.parts, (0.3, 0.1), strict=True):
        assert part.size == pytest.approx(true, abs=3.0 * part.error)
    assert np.array(healed.sensor.translation) == pytest.approx([-0.3, -0.1], abs=0.06)


@pytest.mark.slow
def test_a_change_of_the_noise_is_found_with_its_frames(log):
    frame = log.recorded.observations.frame
    inside = (frame >= 60) & (frame < 120)
    found = best(with_noise(log, np.where(inside[:, None], 2.0 * noise_of(log), 0.0)))
    assert found.kind == "change"
    assert found.size == pytest.approx(3.0, rel=0.15)
    assert np.abs(np.array(found.frames[0]) - [60, 119]).max() <= 10


def test_correlated_errors_of_a_landmark_are_no_wrong_sigma(log):
    o, rng = log.recorded.observations, np.random.default_rng(0)
    lasting = np.zeros((len(o.frame), 2))
    for landmark in np.unique(log.truth.landmark_of):
        rows = np.flatnonzero(log.truth.landmark_of == landmark)
        state = rng.standard_normal(2)
        for i in rows:
            state = 0.9 * state + np.sqrt(1.0 - 0.81) * rng.standard_normal(2)
            lasting[i] = state
    found = best(with_noise(log, lasting - noise_of(log)))
    assert found.kind == "correlation"
    assert found.size == pytest.approx(0.9, abs=0.1)


def test_heavy_tails_are_no_wrong_sigma(log):
    heavy = np.random.default_rng(0).standard_t(3.0, (len(log.recorded.observations.frame), 2)) / np.sqrt(3.0)
    found = best(with_noise(log, heavy - noise_of(log)))
    assert found.kind == "tails"
    assert found.size <= 6.0


def test_late_observations_are_one_error(log):
    r, o, pose = log.recorded, log.recorded.observations, log.truth.pose
    places = r.map.positions(log.truth.landmark_of)
    at = r.time[o.frame] - 0.3
    earlier = interpolate(r.time, pose, at) + np.minimum(at / r.time[1], 0.0)[:, None] * pose_error(pose[1], pose[0])
    late = r.sensor.residual(r.sensor.predict(earlier, places), r.sensor.predict(pose[o.frame], places))
    moved = replace(log, recorded=replace(r, observations=replace(o, z=o.z + late)))
    found = explanations(evidence(moved), [])[0].finding
    assert found.kind == "systematic"
    assert "latency" in (found.name, *found.other)
    if found.name == "latency":
        assert found.size == pytest.approx(0.3, rel=0.15)


@pytest.mark.parametrize("true", [*confusion.DRAWN, *confusion.SYSTEMATIC])
def test_no_explanation_wins_over_the_true_one_by_what_it_contains(true):
    found = confusion.best(true, 1)
    assert (found is None) == (true == confusion.SOUND)
    assert found is None or true.partition(",")[0] not in found.contains
    assert found is None or found.beyond > 0.0

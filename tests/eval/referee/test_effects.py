"""Systematic errors are estimated with their size and removed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Increments, Observations
from data.logs import open_log
from data.se2 import between
from eval.referee.effects import DELAYS, effects, scored, without
from eval.referee.residuals import Used


def exactly(name):
    """A log without noise, its path, and its landmarks."""
    log = open_log(name)
    r, pose, o = log.recorded, log.truth.pose, log.recorded.observations
    motion = np.zeros_like(pose)
    motion[1:] = between(pose[:-1], pose[1:])
    places = log.truth.landmarks
    z = r.sensor.predict(pose[o.frame], places.positions(log.truth.landmark_of))
    inputs = replace(
        r, prior=replace(r.prior, mean=pose[0]), increments=Increments(motion, r.increments.covariance),
        observations=Observations(o.frame, z, o.R),
    )  # fmt: skip
    return inputs, pose, Used(places.rows(log.truth.landmark_of), places.xy, places.id)


@pytest.fixture(scope="module", params=["arena:2", "linear:1"])
def world(request):
    return exactly(request.param)


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


def test_a_late_observation_is_from_an_earlier_pose(world):
    inputs, path, used = world
    o, late = inputs.observations, 1e-5
    speed = np.gradient(np.column_stack([path[:, :2], np.unwrap(path[:, 2])]), inputs.time, axis=0)
    then = inputs.sensor.predict((path - late * speed)[o.frame], used.landmarks[used.number])
    rate = inputs.sensor.residual(then, o.z) / late
    columns = {e.name: e.observations for e in effects(inputs, path, used)}
    assert columns["latency"] == pytest.approx(rate, abs=1e-3 * np.abs(rate).max())
    age = inputs.time[o.frame] - inputs.time[0]
    assert columns["latency_growth"] == pytest.approx(rate * age[:, None], abs=1e-3 * np.abs(rate * age[:, None]).max())


def test_a_displaced_sensor_observes_from_elsewhere(world):
    inputs, path, used = world
    o, ahead = inputs.observations, 1e-5
    moved = path + ahead * np.column_stack([np.cos(path[:, 2]), np.sin(path[:, 2]), np.zeros(len(path))])
    then = inputs.sensor.predict(moved[o.frame], used.landmarks[used.number])
    columns = {e.name: e.observations for e in effects(inputs, path, used)}
    rate = inputs.sensor.residual(then, o.z) / ahead
    assert columns["mount_x"] == pytest.approx(rate, abs=1e-3 * np.abs(rate).max())


def test_increments_that_turn_first_have_chords_along_their_last_heading(world):
    inputs, path, used = world
    columns = {e.name: e.motion for e in effects(inputs, path, used)}
    step = between(path[:-1], path[1:])
    turn = 0.5e-3 * step[:, 2]
    rotated = np.column_stack([np.cos(turn) * step[:, 0] - np.sin(turn) * step[:, 1],
                               np.sin(turn) * step[:, 0] + np.cos(turn) * step[:, 1]])  # fmt: skip
    assert 1e-3 * columns["odometry_integration"][1:, :2] == pytest.approx(rotated - step[:, :2], abs=1e-6)

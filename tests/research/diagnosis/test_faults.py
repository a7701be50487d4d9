"""Faults put into logs: each changes what it says by as much as it says, and nothing else."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy import stats

from data.se2 import between, pose_error, rotation, wrap_angle
from data.worlds.arena import Arena
from data.worlds.circle import Circle
from data.worlds.corridor import Corridor
from data.worlds.registry import simulate
from tests.research.diagnosis.faults import FAULTS

WORLDS = {
    "arena": ("arena", Arena(frames=60, clutter=0.5)),
    "points": ("arena", Arena(frames=60, sensor="relative_point")),
    "corridor": ("corridor", Corridor(people=True)),
    "circle": ("circle", Circle(frames=150)),
}
ODOMETRY = ("curvature", "distance-scale", "odometry-noise")
SENSOR = ("range-scale", "bearing-bias", "latency", "heavy-tails")


@functools.cache
def world_log(name):
    return simulate(*WORLDS[name], 0, name)


def put_in(name, log, size, seed=0):
    return FAULTS[name].put_in(log, size, np.random.default_rng(seed))


def arrays(log):
    """Everything in a log that could change, by name; labels as they are granted."""
    r, o, u, t = log.recorded, log.recorded.observations, log.recorded.increments, log.truth
    return {
        "increments": u.mean, "Q": u.covariance, "z": o.z, "R": o.R, "frame": o.frame, "time": r.time,
        "prior": r.prior.mean, "P0": r.prior.covariance, "pose": t.pose, "id": t.landmarks.id, "xy": t.landmarks.xy,
        "landmark_of": t.landmark_of, "map": r.map.xy, "label": log.granted, "start": r.start,
    }  # fmt: skip


def changed(log, other):
    return {name for name, a in arrays(log).items() if not np.array_equal(a, arrays(other)[name])}


def noiseless(log):
    """Rows of the landmarks' observations, and what the sensor would read without noise."""
    rows = np.flatnonzero(log.truth.landmark_of >= 0)
    o, xy = log.recorded.observations, log.truth.landmarks.positions(log.truth.landmark_of[rows])
    return rows, log.recorded.sensor.predict(log.truth.pose[o.frame[rows]], xy)


def noise(log):
    rows, exact = noiseless(log)
    return log.recorded.sensor.residual(log.recorded.observations.z[rows], exact)


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_changes_what_it_says_and_nothing_else(name, world):
    log = world_log(world)
    expected = {"increments"} if name in ODOMETRY else {"z"} if name in SENSOR else {"label"}
    for size in FAULTS[name].sizes:
        faulty = put_in(name, log, size)
        assert changed(log, faulty) == expected
        assert all(np.isfinite(a).all() for a in arrays(faulty).values())
        assert (np.abs(faulty.recorded.increments.mean[:, 2]) <= math.pi).all()
        assert not faulty.recorded.increments.mean[0].any()
        assert type(faulty.recorded.sensor) is type(log.recorded.sensor)
        if log.recorded.sensor.name == "range_bearing":
            z = faulty.recorded.observations.z
            assert (z[:, 0] > 0.0).all()
            assert (np.abs(z[:, 1]) <= math.pi).all()


@pytest.mark.parametrize("world", WORLDS)
def test_odometry_says_what_it_should(world):
    log = world_log(world)
    before, truth = log.recorded.increments.mean, between(log.truth.pose[:-1], log.truth.pose[1:])
    said = {name: put_in(name, log, 0.1).recorded.increments.mean for name in ODOMETRY}
    np.testing.assert_allclose(said["distance-scale"][:, :2], 1.1 * before[:, :2])
    np.testing.assert_array_equal(said["distance-scale"][:, 2], before[:, 2])
    way = np.hypot(*before[:, :2].T)
    np.testing.assert_allclose(wrap_angle(said["curvature"][:, 2] - before[:, 2]), 0.1 * way, atol=1e-12)
    np.testing.assert_array_equal(said["curvature"][:, :2], before[:, :2])
    error = pose_error(before[1:], truth)
    np.testing.assert_allclose(pose_error(said["odometry-noise"][1:], truth), 0.1 * error, atol=1e-12)


@pytest.mark.parametrize("world", WORLDS)
def test_the_sensor_says_what_it_should(world):
    log = world_log(world)
    z = log.recorded.observations.z
    longer, turned = (put_in(name, log, 0.1).recorded.observations.z for name in ("range-scale", "bearing-bias"))
    before = log.recorded.sensor.polar(z)
    np.testing.assert_allclose(log.recorded.sensor.polar(longer), before * [1.1, 1.0])
    after = log.recorded.sensor.polar(turned)
    np.testing.assert_allclose(after[:, 0], before[:, 0])
    np.testing.assert_allclose(wrap_angle(after[:, 1] - before[:, 1]), 0.1, atol=1e-12)
    if log.recorded.sensor.name == "relative_point":
        np.testing.assert_allclose(turned, z @ rotation(0.1).T)


def test_a_late_reading_is_of_the_place_left_behind_with_the_noise_it_had():
    """Circle: straight steps of 0.25 m in 1 s. In half a second the robot goes half of a chord and turns half of it."""
    log = world_log("circle")
    late = put_in("latency", log, 0.5)
    rows, _ = noiseless(log)
    frame, pose = log.recorded.observations.frame[rows], log.truth.pose
    assert frame.min() > 0
    halfway = pose.copy()
    halfway[1:] -= 0.5 * pose_error(pose[1:], pose[:-1])
    exact = log.recorded.sensor.predict(halfway[frame], log.truth.landmarks.positions(log.truth.landmark_of[rows]))
    np.testing.assert_allclose(late.recorded.observations.z[rows] - exact, noise(log), atol=1e-9)


def test_heavy_tailed_noise_is_students_with_the_stated_covariance():
    """Squared distance / 2, by the share of the covariance that is the scale, is F(2, nu): Kotz and Nadarajah, 2004."""
    log = simulate("arena", Arena(frames=1500), 1)
    rows, _ = noiseless(log)
    R = log.recorded.observations.R[rows]
    for nu in (2.5, 5.0):
        e = noise(put_in("heavy-tails", log, nu))
        squared = np.einsum("ni,nij,nj->n", e, np.linalg.inv(R), e)
        assert stats.kstest(squared / 2.0 * nu / (nu - 2.0), stats.f(2, nu).cdf).pvalue > 1e-3
    assert np.mean(squared) == pytest.approx(2.0, abs=0.1)  # nu = 5: the variance of a square exists


def test_wrong_labels_are_the_asked_share_of_those_of_landmarks():
    log = simulate("arena", Arena(frames=1500, clutter=1.0), 1)
    wrong = put_in("wrong-labels", log, 0.05).granted != log.truth.landmark_of
    assert not wrong[log.truth.landmark_of < 0].any()
    rate = wrong[log.truth.landmark_of >= 0].mean()
    assert rate == pytest.approx(0.05, abs=4.0 * math.sqrt(0.05 * 0.95 / len(wrong)))

"""The arena: a swinging loop among landmarks in a square, readings with the noise they state, clutter by area."""

import math
from dataclasses import fields

import numpy as np
import pytest

from data.worlds.arena import Arena, simulate

MANY = Arena(landmarks=400, side=40.0, frames=1000, clutter=2.0, detection=0.8)


@pytest.fixture(scope="module", params=["range_bearing", "relative_point"])
def made(request):
    arena = Arena(**{f.name: getattr(MANY, f.name) for f in fields(Arena)} | {"sensor": request.param})
    return arena, simulate(arena, 5)


@pytest.fixture(scope="module")
def log(made):
    return made[1]


def test_what_is_in_view_is_read_as_often_as_detected_and_nothing_nearer_or_farther(log):
    o, who, p = log.recorded.observations, log.truth.landmark_of, log.truth.pose
    away = np.linalg.norm(log.truth.landmarks.xy[None] - p[:, None, :2], axis=2)
    there = (away >= MANY.min_range) & (away <= MANY.max_range)
    own = who >= 0
    assert there[o.frame[own], who[own]].all()
    assert own.sum() / there.sum() == pytest.approx(0.8, abs=0.02)
    assert len({*zip(o.frame[own].tolist(), who[own].tolist(), strict=True)}) == own.sum()


def test_a_narrow_view_reads_only_what_is_ahead():
    arena = Arena(landmarks=200, frames=60, field_of_view=math.pi / 2, clutter=5.0)
    log = simulate(arena, 1)
    assert np.abs(log.recorded.observations.z[:, 1]).max() < math.pi / 4 + 5.0 * arena.sigma_bearing
    assert (log.recorded.sensor.min_angle, log.recorded.sensor.max_angle) == pytest.approx((-np.pi / 4, np.pi / 4))
    assert Arena(field_of_view=9.0).model().max_angle == math.pi


def test_the_prior_is_off_by_what_it_states():
    arena = Arena(landmarks=1, frames=2, odometry_rate=2.0)
    logs = [simulate(arena, seed) for seed in range(200)]
    off = np.array([g.recorded.prior.mean - g.truth.pose[0] for g in logs])
    np.testing.assert_allclose(off.std(axis=0), [0.1, 0.1, 0.03], rtol=0.2)
    np.testing.assert_allclose(np.sqrt(np.diag(logs[0].recorded.prior.covariance)), [0.1, 0.1, 0.03])

"""Observations registered to the map by the other pairings of their frame, and their covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data import se2
from data.inputs import Increments, Inputs, Observations, Prior
from data.result import DISCARD, NEW, MapEstimate, Run, Trajectory
from data.sensors import RangeBearing, RelativePoint
from eval.referee.ambiguity import registered
from eval.referee.errors import observed

PLACES = np.array([[4.0, 0.0], [0.0, 5.0], [-4.0, 1.0], [0.0, -5.0], [3.0, 4.0], [3.0, -4.0], [-3.0, 5.0]])
L = len(PLACES)
STATED = 0.02


def world(sensor, frames, *, noise=(0.0, 0.0), off=0.01, wild=None, seed=0):
    """A run whose frames observe every landmark: its path has this error, its landmarks none.

    noise: of observations along and across the line of sight [m], stated as `STATED`; wild: row of one that is 1 m off.
    """
    rng = np.random.default_rng(seed)
    truth = np.stack([0.1 * np.arange(frames), 0.2 * np.sin(np.arange(frames)), 0.3 * np.arange(frames)], axis=1)
    z, R = [], []
    for pose in truth:
        body = se2.transform_points(se2.inverse(pose), PLACES)
        u = body / np.hypot(*body.T)[:, None]
        across = np.stack([-u[:, 1], u[:, 0]], axis=1)
        body = body + noise[0] * rng.normal(size=(L, 1)) * u + noise[1] * rng.normal(size=(L, 1)) * across
        if wild is not None and wild // L == len(z) // L:
            body[wild % L] += [1.0, 0.0]
        r = np.hypot(*body.T)
        polar = isinstance(sensor, RangeBearing)
        z += [*(np.stack([r, np.arctan2(body[:, 1], body[:, 0])], axis=1) if polar else body)]
        R += [np.diag([1.0, each**-2 if polar else 1.0]) * STATED**2 for each in r]
    frame = np.repeat(np.arange(frames), L)
    none = Increments(np.zeros((frames, 3)), np.zeros((frames, 3, 3)))
    observations = Observations(frame, np.array(z), np.array(R))
    inputs = Inputs(Prior(np.zeros(3), np.eye(3)), np.arange(frames, dtype=float), none, observations, sensor)
    path = truth + off * rng.uniform(-1.0, 1.0, (frames, 3)) * [1.0, 1.0, 0.02]
    chosen = np.where(frame == 0, NEW, np.tile(np.arange(L), frames))
    created = np.where(frame == 0, np.arange(frames * L), -1)
    found = MapEstimate(
        np.arange(L), PLACES, np.tile(1e-6 * np.eye(2), (L, 1, 1)), np.zeros(L, int), np.full(L, frames)
    )
    online = Trajectory(path, np.tile(np.eye(3), (frames, 1, 1)))
    return Run("ekf", "known", "slam", online, None, found, chosen, chosen, created), inputs, truth


SENSORS = [RelativePoint(), RangeBearing()]


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_path_that_is_off_does_not_matter(sensor):
    run, inputs, _ = world(sensor, 6)
    r = registered(run, inputs)
    assert r.row.tolist() == list(range(L)) * 6
    assert r.xy == pytest.approx(np.tile(PLACES, (6, 1)), abs=5e-4)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("off", [0.0, 0.3])
def test_a_wrong_observation_hardly_pulls_the_others(sensor, off):
    """By least squares alone they would be off by 0.15 m."""
    run, inputs, truth = world(sensor, 20, noise=(STATED / 2, STATED / 2), off=off, wild=2 * L + 3)
    r = registered(run, inputs)
    error = np.hypot(*(r.xy[2 * L : 3 * L] - PLACES).T)
    assert np.delete(error, 3).mean() < 0.045
    assert r.xy[2 * L + 3] == pytest.approx(PLACES[3] + se2.rotation(truth[2, 2]) @ [1.0, 0.0], abs=0.06)


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("times", [(0.5, 0.5), (2.0, 2.0), (1.6, 0.8), (0.8, 1.6)])
def test_covariances_are_those_of_the_errors_along_and_across_the_line_of_sight(sensor, times):
    run, inputs, truth = world(sensor, 150, noise=tuple(STATED * np.array(times)))
    r = registered(run, inputs)
    off = r.xy - PLACES[r.row]
    sight = PLACES[r.row] - truth[inputs.observations.frame, :2]
    u = sight / np.hypot(*sight.T)[:, None]
    for axis, expected in zip((u, np.stack([-u[:, 1], u[:, 0]], axis=1)), times, strict=True):
        error, estimated, stated = (
            np.einsum("mi,mi->m", off, axis) ** 2,
            np.einsum("mi,mij,mj->m", axis, r.covariance, axis),
            np.einsum("mi,mij,mj->m", axis, r.stated, axis),
        )
        assert np.mean(error / estimated) == pytest.approx(1.0, rel=0.15)
        assert np.median(estimated / stated) == pytest.approx(expected**2, rel=0.3)


def test_the_stated_covariance_is_that_of_observation_and_pose():
    """Where everything fits, each of the others counts one and a half times, for Student's tails."""
    run, inputs, _ = world(RelativePoint(), 5, off=0.0)
    run = replace(run, online=Trajectory(run.online.pose, np.tile(0.01**2 * np.eye(3), (5, 1, 1))))
    r = registered(run, inputs)
    pose = run.online.pose[3]
    J = np.stack([np.concatenate([np.eye(2), [[-(xy - pose[:2])[1]], [(xy - pose[:2])[0]]]], axis=1) for xy in PLACES])
    for k in range(L):
        others = [J[i].T @ J[i] * 1.5 / STATED**2 for i in range(L) if i != k]
        P = np.linalg.inv(np.eye(3) / 0.01**2 + sum(others))
        assert r.stated[3 * L + k] == pytest.approx(STATED**2 * np.eye(2) + J[k] @ P @ J[k].T, rel=1e-4, abs=1e-9)


def test_an_observation_has_no_row_without_a_mapped_landmark_or_a_pose():
    run, inputs, _ = world(RelativePoint(), 6)
    pose, xy, final = np.array(run.online.pose), np.array(PLACES), np.array(run.final_decisions)
    pose[4], xy[2], final[5 * L + 1] = np.nan, np.nan, DISCARD
    keep = np.delete(np.arange(L), 5)
    few = MapEstimate(keep, xy[keep], run.map.covariance[keep], run.map.first_frame[keep], run.map.times_seen[keep])
    changed = replace(run, online=Trajectory(pose, run.online.covariance), map=few, final_decisions=final)
    r = registered(changed, inputs)
    expected = np.tile([0, 1, -1, 3, 4, -1, 5], 6)  # rows of the map
    expected[4 * L : 5 * L], expected[5 * L + 1] = -1, -1
    assert r.row.tolist() == expected.tolist()
    assert np.isnan(r.xy[4 * L : 5 * L]).all()
    assert np.isfinite(np.delete(r.xy, np.arange(4 * L, 5 * L), axis=0)).all()
    assert r.xy[5 * L + 1] == pytest.approx(PLACES[1], abs=5e-4), "laid onto the map all the same"


def test_an_observation_shows_the_landmark_it_initialized_unless_that_was_retracted():
    run, _, _ = world(RelativePoint(), 2)
    assert observed(run).tolist() == list(range(L)) * 2
    final = np.array(run.final_decisions)
    final[0], final[1] = DISCARD, 4
    assert observed(replace(run, final_decisions=final)).tolist() == [DISCARD, 4, *range(2, L), *range(L)]


def test_other_inputs_and_runs_without_a_path_are_not_registered():
    run, inputs, _ = world(RelativePoint(), 3)
    assert registered(replace(run, online=None), inputs) is None
    assert registered(run, world(RelativePoint(), 4)[1]) is None
    nothing = MapEstimate(np.empty(0, int), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, int), np.empty(0, int))
    assert registered(replace(run, map=nothing), inputs) is None


def test_the_final_path_counts():
    run, inputs, _ = world(RelativePoint(), 3)
    wrong = Trajectory(np.full((3, 3), np.nan), run.online.covariance)
    assert np.isfinite(registered(replace(run, online=wrong, final=run.online), inputs).xy).all()

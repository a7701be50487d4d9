"""Landmarks that may be the same as a neighbour, and landmarks that may be two."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from data import se2
from data.inputs import Increments, Inputs, Observations, Prior
from data.notice import Code
from data.result import DISCARD, NEW, MapEstimate, Run, Trajectory
from data.sensors import RangeBearing, RelativePoint
from data.worlds import registry
from data.worlds.arena import Arena, simulate
from data.worlds.registry import name_of
from eval.figures.map import map_figure
from eval.referee.ambiguity import (
    FALSE,
    NONE,
    Registered,
    ambiguous,
    doubles,
    log_evidence,
    neighbours,
    registered,
    variance_of,
)
from eval.referee.diagnostics import ambiguity_of
from eval.referee.errors import observed
from eval.replay.run import compare
from tests.research.variety.worlds import Crowding, Drawn, Misstated, Readings, log_of


def map_of(xy, sigma=0.02, number=None):
    xy = np.asarray(xy, float)
    n = np.arange(len(xy)) if number is None else np.asarray(number)
    return MapEstimate(n, xy, np.tile(sigma**2 * np.eye(2), (len(xy), 1, 1)), np.zeros(len(xy)), np.ones(len(xy)))


def found(m, number, frame, sigma=0.1):
    return neighbours(m, np.full(len(m), sigma**2), np.array(number), np.array(frame)).tolist()


def test_two_inside_the_noise_without_a_common_frame_are_ambiguous():
    assert found(map_of([[0.0, 0.0], [0.18, 0.0]]), [0, 1, 0], [0, 1, 2]) == [1, 0]
    assert found(map_of([[0.0, 0.0], [0.18, 0.0]]), [0, 1, 0], [0, 0, 2]) == [NONE, NONE]
    m = map_of([[0.0, 0.0], [0.2, 0.0], [0.1, 0.0]], number=[3, 5, 9])
    assert found(m, [3, 5, 9], [0, 1, 2]) == [9, 9, 3] or found(m, [3, 5, 9], [0, 1, 2]) == [9, 9, 5]
    m = map_of([[0.0, 0.0], [2.0, 0.0], [9.0, 0.0]])
    wide = replace(m, covariance=m.covariance * np.array([1.0, 2500.0, 1.0])[:, None, None])
    assert found(m, [0, 1, 2], [0, 1, 2]) == [NONE] * 3
    assert found(wide, [0, 1, 2], [0, 1, 2]) == [1, 0, NONE]
    m = map_of([[0.0, 0.0], [5.0, 0.0]], number=[2, 4])
    assert variance_of(m, np.array([2, 2, 7]), np.array([1.0, 3.0, 9.0])).tolist() == [2.0, 0.0]


@pytest.mark.parametrize(("apart", "distinct"), [(0.309, False), (0.317, True)])
def test_the_gate_is_that_of_both_covariances_and_an_observation(apart, distinct):
    # sqrt(9.21 (2 * 0.02^2 + 0.1^2)) = 0.315; without the covariances 0.303
    assert (found(map_of([[0.0, 0.0], [apart, 0.0]]), [0, 1], [0, 1]) == [NONE, NONE]) is distinct


def test_nothing_is_ambiguous_with_labels_or_for_other_inputs():
    log = simulate(Arena(frames=60), 0)
    (run,) = compare(log.inputs(labels=True), "slam", ["ekf"])
    assert (ambiguous(run, log.recorded) == NONE).all()
    assert len(ambiguous(run, log.recorded)) == len(run.map)
    twin = replace(run.map, xy=run.map.xy * 0.0)
    assert (ambiguous(replace(run, map=twin, walls=True), log.recorded) == NONE).all()
    assert (ambiguous(replace(run, map=twin), simulate(Arena(frames=59), 0).recorded) == NONE).all()
    assert len(ambiguous(replace(run, map=None), log.recorded)) == 0


SIGMA = 0.1


def observations(rng, landmarks=40, frames=60, apart=0.0, share=0.0, both=0.0, clutter=0.2):
    """Landmarks 10 m apart, each observed in every frame, with clutter nearby.

    apart: of a second point, in sigmas; share: of observations of the second; both: of frames with both.
    """
    place = np.stack([10.0 * np.arange(landmarks), np.zeros(landmarks)], axis=1)
    rows, frame, xy = [], [], []
    for k in range(frames):
        for i in range(landmarks):
            second = place[i] + [apart * SIGMA, 0.0]
            there = second if rng.random() < share else place[i]
            seen = [(i, there), *[(-1, second)] * (rng.random() < both)]
            seen += [(-1, place[i] + rng.uniform(-3.0, 3.0, 2))] * (rng.random() < clutter)
            for row, at in seen:
                rows.append(row)
                frame.append(k)
                xy.append(at + (0.0 if row < 0 and at is not second else SIGMA) * rng.standard_normal(2))
    S = np.tile(SIGMA**2 * np.eye(2), (len(rows), 1, 1))
    return Registered(np.array(rows), np.array(xy), S, S), place, np.array(frame)


def marked(r, place, frame, at=None):
    """Share of the landmarks that are called two."""
    evidence = log_evidence(r, place, frame, np.arange(frame.max() + 1) if at is None else at)
    return float(np.mean(evidence > math.log(len(place) / FALSE)))


@pytest.mark.parametrize("seed", range(4))
def test_single_landmarks_are_not_called_two_in_any_clutter(seed):
    rng = np.random.default_rng(seed)
    assert marked(*observations(rng, landmarks=200, frames=30, clutter=0.1 * seed)) == 0.0


@pytest.mark.parametrize(("apart", "least", "most"), [(0.5, 0.0, 0.0), (2.0, 0.0, 0.6), (3.5, 0.9, 1.0)])
def test_the_scatter_shows_two_that_are_far_enough_apart(apart, least, most):
    r = observations(np.random.default_rng(0), frames=120, apart=apart, share=0.5, clutter=0.0)
    assert least <= marked(*r) <= most


def test_second_observations_in_a_frame_show_two_and_those_from_one_place_are_one_piece_of_evidence():
    assert marked(*observations(np.random.default_rng(1), apart=0.5, both=0.5)) > 0.9
    r, place, frame = observations(np.random.default_rng(1), apart=0.5, both=0.5)
    assert marked(r, place, frame, at=np.zeros(60, np.int64)) == 0.0
    assert marked(r, place, frame, at=np.arange(60) // 20) == 0.0
    rng = np.random.default_rng(2)
    r, place, frame = observations(rng, landmarks=20, frames=240, clutter=0.0)
    at = np.arange(240) // 12  # four times round, through the same five places
    lasting = SIGMA * rng.standard_normal((len(place), 5, 2))
    r = r._replace(xy=place[r.row] + lasting[r.row, at[frame] % 5] + 0.1 * (r.xy - place[r.row]))
    assert marked(r, place, frame) > 0.2
    assert marked(r, place, frame, at) == 0.0


@pytest.fixture(scope="module")
def log():
    """An arena where half of the landmarks have a neighbour at 1.5 sigma, and noise is stated at twice what it is."""
    values = {"landmarks": 12, "side": 12.0, "frames": 120, "max_range": 8.0}
    name = name_of("arena", registry.parameters_of("arena")(**values), 5)
    readings = Readings(0.1, 0.02, detection=0.9, clutter=0.05)
    return log_of(Drawn(5, name, readings, Crowding(paired=0.5, spacing=1.5), Misstated(1.0, 2.0, 2.0)))


@pytest.mark.slow
def test_merged_neighbours_are_marked_in_the_file_and_in_a_notice(log):
    (run,) = compare(log.inputs(), "slam", ["ekf"], "jcbb")
    two = doubles(run, log.recorded)
    own = ambiguous(run, log.recorded) == run.map.number
    truth = log.truth.landmarks.xy
    near = [np.sort(np.hypot(*(truth - xy).T))[1] < 0.5 for xy in run.map.xy[two]]
    assert two.sum() >= 3
    assert all(near)
    assert own.any()
    assert (own <= two).all()
    found = {n.code: n.named for n in ambiguity_of(run, log.recorded)}
    assert found[Code.DOUBLE] == {"double": own.sum(), "landmarks": len(own)}
    legend = [text.get_text() for each in map_figure(log, (run,)).legends for text in each.get_texts()]
    assert "ambiguous landmarks" in legend


def test_the_noise_is_estimated_and_with_labels_none_is_called_two(log):
    for run in compare(log.inputs(labels=True), "slam", ["ekf", "isam2"]):
        assert not doubles(run, log.recorded).any()
    (run,) = compare(log.inputs(labels=True), "slam", ["isam2"])
    r = registered(run, log.recorded)
    off = r.xy[r.row >= 0] - run.map.xy[r.row[r.row >= 0]]
    square = np.einsum("ki,kij,kj->k", off, np.linalg.inv(r.covariance[r.row >= 0]), off)
    assert 1.6 < square.mean() < 2.4  # stated at twice, it would be 0.5
    (run,) = compare(log.inputs(labels=True), "slam", ["ekf"])
    assert registered(replace(run, map=None), log.recorded) is None
    assert registered(replace(run, walls=True), log.recorded) is None
    assert len(doubles(replace(run, map=None), log.recorded)) == 0


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


def test_other_inputs_and_what_has_no_landmark_or_pose_is_not_registered():
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
    run, _, _ = world(RelativePoint(), 2)
    assert observed(run).tolist() == list(range(L)) * 2
    final = np.array(run.final_decisions)
    final[0], final[1] = DISCARD, 4
    assert observed(replace(run, final_decisions=final)).tolist() == [DISCARD, 4, *range(2, L), *range(L)]
    run, inputs, _ = world(RelativePoint(), 3)
    assert registered(replace(run, online=None), inputs) is None
    assert registered(run, world(RelativePoint(), 4)[1]) is None
    nothing = MapEstimate(np.empty(0, int), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, int), np.empty(0, int))
    assert registered(replace(run, map=nothing), inputs) is None

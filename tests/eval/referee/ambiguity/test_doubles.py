"""A landmark may be two by the scatter of its observations, or by a second observation in the same frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from data.notice import Code
from data.worlds import registry
from data.worlds.registry import name_of
from eval.figures.map import map_figure
from eval.referee.ambiguity import FALSE, Registered, ambiguous, doubles, log_evidence, registered
from eval.referee.diagnostics import ambiguity_of
from eval.replay.run import compare
from tests.research.variety.worlds import Crowding, Drawn, Misstated, Readings, log_of

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


def test_second_observations_in_the_same_frames_show_two_at_any_distance():
    assert marked(*observations(np.random.default_rng(1), apart=0.5, both=0.5)) > 0.9


def test_observations_from_one_place_are_one_piece_of_evidence():
    r, place, frame = observations(np.random.default_rng(1), apart=0.5, both=0.5)
    assert marked(r, place, frame, at=np.zeros(60, np.int64)) == 0.0
    assert marked(r, place, frame, at=np.arange(60) // 20) == 0.0


def test_errors_that_last_while_the_robot_stays_are_one_piece_of_evidence():
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


def test_with_labels_none_is_called_two(log):
    for run in compare(log.inputs(labels=True), "slam", ["ekf", "isam2"]):
        assert not doubles(run, log.recorded).any()


def test_the_noise_is_estimated_from_the_observations(log):
    (run,) = compare(log.inputs(labels=True), "slam", ["isam2"])
    r = registered(run, log.recorded)
    off = r.xy[r.row >= 0] - run.map.xy[r.row[r.row >= 0]]
    square = np.einsum("ki,kij,kj->k", off, np.linalg.inv(r.covariance[r.row >= 0]), off)
    assert 1.6 < square.mean() < 2.4  # stated at twice, it would be 0.5


def test_other_inputs_and_runs_without_a_map_mark_nothing(log):
    (run,) = compare(log.inputs(labels=True), "slam", ["ekf"])
    assert registered(replace(run, map=None), log.recorded) is None
    assert registered(replace(run, walls=True), log.recorded) is None
    assert len(doubles(replace(run, map=None), log.recorded)) == 0

"""Detection rate and false-rejection rate of landmarks that are two."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from data.inputs import CLUTTER, LabelledObservations
from data.worlds import registry
from data.worlds.registry import name_of
from eval.referee.ambiguity import doubles
from eval.replay.run import compare
from tests.research.variety.worlds import Crowding, Drawn, Misstated, Readings, log_of

pytestmark = pytest.mark.slow
ALONE, READ = 20, 6
"""Landmarks of the arena without their neighbours; observations of both landmarks of a counted pair."""


def world(index, distance, stated, detection, clutter):
    values = {"landmarks": ALONE, "side": 16.0, "frames": 200, "max_range": 8.0, "field_of_view": 3.14159}
    name = name_of("arena", registry.parameters_of("arena")(**values), index)
    readings = Readings(0.1, 0.02, detection, clutter)
    return log_of(Drawn(index, name, readings, Crowding(paired=0.3, spacing=distance), Misstated(1.0, stated, stated)))


def taken_for_one(log, rng, *, together):
    """Inputs whose labels have one landmark for each pair; of two in a frame one is unlabelled or left out."""
    o, who, xy = log.recorded.observations, log.truth.landmark_of, log.truth.landmarks.xy
    label, partner = who.copy(), {}
    for q in range(ALONE, len(xy)):
        p = partner[q] = int(np.hypot(*(xy[:ALONE] - xy[q]).T).argmin())
        for i in np.flatnonzero(who == q):
            other = np.flatnonzero((o.frame == o.frame[i]) & (who == p))
            left = len(other) and rng.random() < 0.5
            label[i] = CLUTTER if len(other) and not left else p
            label[other[: int(bool(left))]] = CLUTTER
    kept = np.ones(len(who), bool) if together else (label >= 0) | (who < 0)
    seen = LabelledObservations(o.frame[kept], o.z[kept], o.R[kept], label=label[kept])
    return replace(log.inputs(labels=True).without_map(), observations=seen), partner


def marked(distance, detections, *, together=True, seeds=2):
    """(pairs, of these marked, landmarks that stand alone, of these marked) over worlds of all kinds."""
    found = np.zeros(4, int)
    for k, (stated, detection, _) in enumerate(itertools.product((0.5, 1.0, 2.0, 4.0), detections, range(seeds))):
        log = world(2000 + k, distance, stated, detection, (0.0, 0.1, 0.2)[k % 3])
        inputs, partner = taken_for_one(log, np.random.default_rng(k), together=together)
        (run,) = compare(inputs, "slam", ["ekf"])
        two, xy = doubles(run, inputs), log.truth.landmarks.xy
        who = inputs.observations.label[np.flatnonzero(run.created >= 0)]
        times = np.bincount(log.truth.landmark_of[log.truth.landmark_of >= 0], minlength=len(xy))
        for row, p in enumerate(who[run.map.number]):
            of = [q for q, first in partner.items() if first == p]
            if of and min(times[p], times[of].min()) >= READ:
                found += [1, two[row], 0, 0]
            elif not of and np.sort(np.hypot(*(xy - xy[p]).T))[1] > 1.0:
                found += [0, 0, 1, two[row]]
    return found


@pytest.mark.parametrize("distance", [0.25, 1.0, 3.0])
def test_pairs_in_common_frames_are_marked_and_single_landmarks_are_not(distance):
    pairs, two, alone, wrong = marked(distance, (1.0, 0.8))
    assert two > 0.95 * pairs > 50
    assert wrong <= 0.01 * alone
    pairs, two, *_ = marked(distance, (0.5,))
    assert two > 0.7 * pairs > 20


@pytest.mark.parametrize(("distance", "most"), [(1.0, 0.02), (2.0, 0.05), (3.0, 0.15)])
def test_without_common_frames_hardly_any_pair_is_marked(distance, most):
    pairs, two, *_ = marked(distance, (1.0, 0.5), together=False)
    assert two <= most * pairs

"""Explanations of residuals compete by likelihood: the right kind has the best odds, with its size and its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Increments
from data.logs import open_log
from eval.compare import compare
from eval.referee import residuals
from eval.referee.explanations import ALIKE, Evidence, corrected, explanations
from eval.replay.settings import Setup
from eval.studies.twins import inputs_of, smoothed_twin, source_of
from tests.research.diagnosis.faults import FAULTS

COMPONENTS = residuals.COMPONENTS


def smoothed(log):
    inputs = inputs_of(log, "localization", "known")
    (run,) = compare(inputs, "localization", ("batch",), "known")
    return inputs, run


@pytest.fixture(scope="module")
def usual():
    """A sound log in a known map, and what residuals of its replicates look like."""
    log = open_log("arena:5")
    source = source_of(log, smoothed(log)[1], (), Setup())
    drawn = [smoothed_twin(source, seed) for seed in range(6)]
    typical = {c: float(np.median([s.typical[c] for s in drawn])) for c in COMPONENTS}
    certain = {c: float(np.std([s.typical[c] for s in drawn])) for c in COMPONENTS}
    lag1 = {c: float(np.median([s.statistics[f"residual_{c}_lag1"].value for s in drawn])) for c in COMPONENTS}
    return log, typical, lag1, certain


def evidence(log, usual):
    inputs, run = smoothed(log)
    used = residuals.used_by(run, inputs)
    found = residuals.smoothed_residuals(inputs, run.final.pose, used)
    return Evidence(inputs, run.final.pose, used, found, *usual[1:])


def with_noise(log, noise):
    """The log with more noise (M, 2) on its observations, in stated sigmas."""
    o = log.recorded.observations
    sigma = np.sqrt(np.einsum("mii->mi", o.R))
    return replace(log, recorded=replace(log.recorded, observations=replace(o, z=o.z + sigma * noise)))


def noise_of(log):
    """The noise (M, 2) of a log's observations, in stated sigmas."""
    o, truth = log.recorded.observations, log.truth
    places = log.recorded.map.positions(truth.landmark_of)
    exact = log.recorded.sensor.predict(truth.pose[o.frame], places)
    return log.recorded.sensor.residual(o.z, exact) / np.sqrt(np.einsum("mii->mi", o.R))


def best(log, usual):
    return explanations(evidence(log, usual), [])[0].finding


def test_a_sound_log_needs_no_explanation(usual):
    assert explanations(evidence(usual[0], usual), [])[0].net < ALIKE


def test_a_jump_is_found_at_its_frame_with_its_size(usual):
    log = usual[0]
    mean = log.recorded.increments.mean.copy()
    mean[80, :2] -= [0.6, -0.8]
    moved = Increments(mean, log.recorded.increments.covariance)
    found = best(replace(log, recorded=replace(log.recorded, increments=moved)), usual)
    assert (found.kind, found.frames) == ("jump", ((80, 80),))
    assert found.size == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_change_of_the_noise_is_found_with_its_frames(usual):
    log = usual[0]
    frame = log.recorded.observations.frame
    inside = (frame >= 60) & (frame < 120)
    found = best(with_noise(log, np.where(inside[:, None], 2.0 * noise_of(log), 0.0)), usual)
    assert found.kind == "change"
    assert found.size == pytest.approx(3.0, rel=0.15)
    assert np.abs(np.array(found.frames[0]) - [60, 119]).max() <= 10


def test_correlated_errors_of_a_landmark_are_no_wrong_sigma(usual):
    log = usual[0]
    o, rng = log.recorded.observations, np.random.default_rng(0)
    lasting = np.zeros((len(o.frame), 2))
    for landmark in np.unique(log.truth.landmark_of):
        rows = np.flatnonzero(log.truth.landmark_of == landmark)
        state = rng.standard_normal(2)
        for i in rows:
            state = 0.9 * state + np.sqrt(1.0 - 0.81) * rng.standard_normal(2)
            lasting[i] = state
    found = best(with_noise(log, lasting - noise_of(log)), usual)
    assert found.kind == "correlation"
    assert found.size == pytest.approx(0.9, abs=0.1)


def test_heavy_tails_are_no_wrong_sigma(usual):
    log = usual[0]
    heavy = np.random.default_rng(0).standard_t(3.0, (len(log.recorded.observations.frame), 2)) / np.sqrt(3.0)
    found = best(with_noise(log, heavy - noise_of(log)), usual)
    assert found.kind == "tails"
    assert found.size <= 6.0


@pytest.mark.slow
def test_a_displaced_landmark_is_named(usual):
    log = usual[0]
    ids, count = np.unique(log.truth.landmark_of, return_counts=True)
    moved = int(ids[np.argmax(count)])
    xy = log.recorded.map.xy.copy()
    xy[log.recorded.map.rows(np.array([moved]))] += [0.3, 0.4]
    e = evidence(replace(log, recorded=replace(log.recorded, map=replace(log.recorded.map, xy=xy))), usual)
    found = explanations(e, [])
    assert (found[0].finding.kind, found[0].finding.name) == ("displaced", str(moved))
    assert found[0].finding.size == pytest.approx(0.5, abs=0.1)


def test_late_observations_are_one_error(usual):
    log = usual[0]
    late = FAULTS["latency"].put_in(log, 0.3, np.random.default_rng(0))
    found = explanations(evidence(late, usual), [])[0].finding
    assert found.kind == "systematic"
    assert "latency" in (found.name, *found.other)
    if found.name == "latency":
        assert found.size == pytest.approx(0.3, rel=0.15)


@pytest.mark.slow
def test_a_correction_takes_the_explanation_away(usual):
    log = usual[0]
    twice = with_noise(log, noise_of(log))
    e = evidence(twice, usual)
    x = next(x for x in explanations(e, []) if x.finding.kind == "sigma")
    again = evidence(
        replace(twice, recorded=replace(twice.recorded, observations=corrected(e, x.finding).observations)), usual
    )
    left = [y for y in explanations(again, []) if (y.finding.kind, y.finding.name) == ("sigma", x.finding.name)]
    assert x.finding.size == pytest.approx(2.0, rel=0.1)
    assert abs(left[0].finding.size - 1.0) < 0.1

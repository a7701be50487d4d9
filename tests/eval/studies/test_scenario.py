"""Scenario files: what they say reaches the simulator and the estimators, and every fault in them is named."""

import math
from dataclasses import replace

import numpy as np
import pytest

from data.errors import UsageError
from data.worlds.arena import Arena, simulate
from eval.studies.scenario import load_scenario, with_wrong_labels
from eval.studies.shipped import scenarios

SOUND = """
about = "a small arena"
runs = 3
task = ["localization", "slam"]

[world]
kind = "arena"
frames = 40
landmarks = 12

[estimators]
ekf = { must_be = "consistent", task = ["localization"] }
batch = {}
"""


@pytest.fixture
def written(tmp_path):
    def write(text, name="small.toml"):
        path = tmp_path / name
        path.write_text(text)
        return str(path)

    return write


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n == "walls" else n for n in scenarios()])
def test_every_shipped_scenario_is_sound_and_tells_its_source(name):
    s = load_scenario(name)
    assert s.name == name
    assert s.about
    assert s.runs >= 1
    if s.published is not None:
        assert s.cite
    log = s.parts()[0].simulate(0)
    assert len(log.recorded) > 1
    assert log.has_labels


def test_the_world_of_the_file_is_the_one_that_is_simulated(written):
    s = load_scenario(written(SOUND))
    assert (s.name, s.runs, s.task, s.estimators) == ("small", 3, ("localization", "slam"), ("ekf", "batch"))
    log, same = s.simulate(7), simulate(Arena(frames=40, landmarks=12), 7)
    assert log.name == "small:7"
    np.testing.assert_array_equal(log.recorded.observations.z, same.recorded.observations.z)


def test_angles_that_a_corridor_keeps_in_degrees_are_given_in_degrees(written):
    text = SOUND.replace('kind = "arena"\nframes = 40\nlandmarks = 12', 'kind = "corridor"\nmin_angle = -60')
    assert load_scenario(written(text)).world().min_angle == pytest.approx(-math.pi / 3)


def test_an_estimator_may_be_told_other_noise_but_the_measurements_stay():
    s = load_scenario("small-circle")
    changed = next(m.world for m in s.members if m.name == "ekf-invariant")
    plain, stated = s.simulate(3), s.simulate(3, changed)
    np.testing.assert_array_equal(plain.recorded.increments.mean, stated.recorded.increments.mean)
    np.testing.assert_array_equal(plain.recorded.observations.z, stated.recorded.observations.z)
    assert np.abs(plain.recorded.increments.covariance - stated.recorded.increments.covariance).max() > 1e-7


@pytest.mark.parametrize(("old", "new", "words"), [
    ('about = "a small arena"\n', "", "about: missing; text is needed"),
    ("runs = 3", "runs = 0", "runs = 0: at least 1"), ("runs = 3", "rnus = 3", "unknown key 'rnus'"),
    ("runs = 3", "runs = 2.5", "runs = 2.5: a whole number"),
    ("frames = 40", "frmaes = 40", "unknown key 'frmaes' in [world]"),
    ("frames = 40", 'frames = "many"', "[world] frames = 'many': a whole number"),
    ("frames = 40", "sigma_range = -0.1", "sigma_range = -0.1"),
    ("frames = 40", "sigma_range = nan", "a finite number"),
    ('kind = "arena"', 'kind = "moon"', "[world] kind = 'moon': unknown; known: arena"),
    ('kind = "arena"', "kind = [[1]]", "[world] kind = [[1]]: "),
    ("batch = {}", "ukf = {}", "unknown key 'ukf' in [estimators]"),
    ("batch = {}", 'batch = { must_be = "good" }', "must_be = 'good'"),
    ("batch = {}", 'batch = { task = ["mapping"] }', "'mapping' is unknown"),
    ("batch = {}", "batch = { world = { speed = true } }", "[estimators.batch.world] speed = True: a finite number"),
    ('"localization", "slam"]', '"slam", "slam"]', "none of them twice"),
    ('[estimators]', '[setup]\ngte = 0.9\n[estimators]', "unknown key 'gte' in [setup]"),
    ('runs = 3', 'wrong = [0.5, 0.1]', "ascending"), ('runs = 3', 'wrong = [1.0]', "shares from 0"),
    ('runs = 3', 'from_frame = -1', "must not be negative"),
    ("batch = {}", 'batch = {}\n[[published.row]]\nestimator = "isam2"\nquantity = "nees_pose"\nvalue = 3', "isam2"),
    ("batch = {}", 'batch = {}\n[[published.row]]\nestimator = "ekf"\nquantity = "speed"\nvalue = 3', "'speed': unkn"),
    ("batch = {}", 'batch = {}\n[[published.row]]\nestimator = "ekf"\nvalue = 3', "[published.row] quantity: missing"),
    ("[world]", "[world", "not valid TOML"), ("[world]", "[[world]]", "this must be a table"),
    ('[world]\nkind = "arena"\nframes = 40\nlandmarks = 12\n', "", "no [world] table"),
    ("[estimators]", "[setup]\ngate = 2\n[estimators]", "small.toml: [setup] gate = 2: a probability"),
    ('kind = "arena"\n', "", "[world] kind: missing"),
])  # fmt: skip
def test_a_fault_in_a_file_is_one_line_that_names_file_and_key(written, old, new, words):
    assert old in SOUND
    with pytest.raises(UsageError, match=r"small\.toml") as fault:
        load_scenario(written(SOUND.replace(old, new, 1)))
    assert words in str(fault.value)
    assert "\n" not in str(fault.value)


def test_wrong_labels_are_as_many_as_asked_never_right_and_nested():
    log = simulate(Arena(), 4)
    true_id = log.truth.landmark_of
    few, many = (with_wrong_labels(log, rate, 4).label for rate in (0.05, 0.2))
    assert 0.17 < np.mean(many != true_id) < 0.23
    assert set(np.unique(many)) <= set(log.truth.landmarks.id.tolist())
    wrong = few != true_id
    np.testing.assert_array_equal(few[wrong], many[wrong])
    np.testing.assert_array_equal(with_wrong_labels(log, 0.0, 4).label, true_id)
    clutter = replace(log, truth=replace(log.truth, landmark_of=np.full_like(true_id, -1)))
    assert set(with_wrong_labels(clutter, 0.5, 4).label) == {-1}


ERRING = """
about = "a small arena that errs"
runs = 2
task = ["localization"]

[world]
kind = "arena"
frames = 60
curvature = 0.05

[setup]
calibrate = ["curvature", "scale=0.02"]

[estimators]
ekf = { must_be = "consistent", task = ["localization"] }
"""


def test_a_study_of_estimators_that_calibrate_runs_plain_ones_too_and_demands_nothing_of_them(written):
    plain, calibrated = load_scenario(written(ERRING)).parts()
    assert (plain.name, calibrated.name) == ("small:plain", "small:calibrated")
    assert (plain.declared("localization", "ekf"), calibrated.declared("localization", "ekf")) == (False, True)
    assert plain.parts() == (plain,)
    assert plain.simulate(0).recorded.systematic is None
    found = calibrated.simulate(0).recorded.systematic
    assert (found.names, found.sigma.tolist()) == (("scale", "curvature"), [0.02, 0.05])
    np.testing.assert_array_equal(
        plain.simulate(0).recorded.increments.mean, calibrated.simulate(0).recorded.increments.mean
    )


def test_a_scenario_names_its_errors(written):
    with pytest.raises(UsageError, match="a scenario names the errors, of scale"):
        load_scenario(written(ERRING.replace('["curvature", "scale=0.02"]', '"auto"')))

"""`eval.tune` finds noise, biases, scales and latency that were put into simulated logs, and says what it did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.errors import DataError, UsageError
from data.inputs import Increments, Observations
from data.motion import VelocityModel, VelocityNoise, preintegrate
from data.open_log.reader import load_folder
from data.open_log.writer import write_folder
from data.worlds.arena import Arena, simulate
from eval.tune import Numbers, main, tune
from eval.tuning.fit import AT_BOUND, FITTED, HELD, fit, middle, pairings, score
from eval.tuning.model import GROUPS, apply, make_model, vector

SMALL = Arena(frames=80)
NOISE = ("motion", "sensor")
TRUE_AT_ZERO = ("motion_lateral", "bias_range", "bias_bearing", "odometry_v", "odometry_omega")


def changed(log, *, noise=1.0, bias=(0.0, 0.0), scale=(1.0, 1.0)):
    """The log with sigmas stated `noise` times too large, biased readings and odometry that counts `scale` too much."""
    r = log.recorded
    o, mean = r.observations, r.increments.mean * np.array([scale[0], scale[0], scale[1]])
    return replace(
        log,
        recorded=replace(
            r,
            increments=Increments(mean, r.increments.covariance * noise**2),
            observations=Observations(o.frame, o.z + np.array(bias), o.R * noise**2),
        ),
    )


def fitted(log, groups=NOISE, slam=False):
    inputs = log.inputs(labels=True)
    if slam:
        inputs = inputs.without_map()
    model, decisions = make_model(inputs, None, groups), pairings(inputs)
    return model, decisions, fit(model, decisions)


def by_name(model, values):
    return dict(zip([p.name for p in model.parameters], values, strict=True))


@pytest.mark.parametrize(("seed", "wrong", "slam"), [(0, 2.0, False), (1, 2.0, True), (2, 0.5, False), (3, 0.5, True)])
def test_sigmas_stated_wrong_by_a_factor_of_two_are_recovered_within_three_standard_errors(seed, wrong, slam):
    model, decisions, found = fitted(changed(simulate(SMALL, seed), noise=wrong), slam=slam)
    for name, theta, error in zip(by_name(model, found.theta), found.theta, found.error):
        true = 0.0 if name in TRUE_AT_ZERO else -np.log(wrong)
        if np.isfinite(error):
            assert abs(theta - true) < 3.0 * error, name
    error = by_name(model, found.error)
    assert error["sigma_range"] < 0.05
    assert error["sigma_bearing"] < 0.05
    assert error["motion_along"] < 0.3
    before = score(model.inputs, decisions)
    after = score(apply(model, found.theta), decisions)
    assert not 0.4 < before.nis < 2.5
    assert after.lower < after.nis < after.upper
    assert after.log_likelihood - before.log_likelihood == pytest.approx(found.gain, abs=1e-6)


def test_a_bearing_bias_and_an_odometry_scale_are_found():
    log = changed(simulate(SMALL, 0), bias=(0.15, 0.03), scale=(1.05, 0.96))
    model, _, found = fitted(log, ("bias", "odometry"))
    value = by_name(model, [p.value(t) for p, t in zip(model.parameters, found.theta)])
    error = by_name(model, found.error)
    assert value["bias_range"] == pytest.approx(0.15, abs=3.0 * error["bias_range"])
    assert value["bias_bearing"] == pytest.approx(0.03, abs=3.0 * error["bias_bearing"])
    assert value["odometry_v"] == pytest.approx(1.0 / 1.05, abs=3.0 * error["odometry_v"])
    assert value["odometry_omega"] == pytest.approx(1.0 / 0.96, abs=3.0 * error["odometry_omega"])
    assert error["bias_range"] < 0.02
    assert error["bias_bearing"] < 0.005
    assert max(error["odometry_v"], error["odometry_omega"]) < 0.015


def test_parameters_of_zero_leave_the_inputs_as_they_are():
    inputs = simulate(SMALL, 0).inputs(labels=True)
    model = make_model(inputs, None, GROUPS)
    same = apply(model, np.zeros(len(model)))
    assert np.array_equal(same.increments.mean, inputs.increments.mean)
    assert np.array_equal(same.increments.covariance, inputs.increments.covariance)
    assert np.array_equal(same.observations.z, inputs.observations.z)
    assert np.array_equal(same.observations.R, inputs.observations.R)


def test_factors_multiply_standard_deviations_and_biases_are_taken_off():
    inputs = simulate(SMALL, 0).inputs(labels=True)
    model = make_model(inputs, None, GROUPS)
    values = {"sigma_range": 3.0, "bias_bearing": 0.1, "motion_along": 2.0, "motion_heading": 5.0, "range_growth": 0.5}
    new = apply(model, vector(model, values))
    o, z = new.observations, inputs.observations.z
    assert o.R[:, 0, 0] == pytest.approx(9.0 * 0.1**2 * z[:, 0])
    assert o.R[:, 1, 1] == pytest.approx(0.02**2)
    assert np.cos(o.z[:, 1] - z[:, 1] + 0.1) == pytest.approx(1.0)
    ratio = new.increments.covariance[1:] / inputs.increments.covariance[1:]
    assert ratio == pytest.approx(np.tile(np.outer([2.0, 5.0, 5.0], [2.0, 5.0, 5.0]), (len(ratio), 1, 1)), rel=1e-6)


def test_scaled_increments_are_those_of_scaled_velocities():
    t = np.arange(0.0, 5.0, 0.5)
    v, omega = np.full(len(t), 1.3), np.full(len(t), 0.2)
    model = VelocityModel(VelocityNoise("density", (0.1, 0.1)))
    inputs = simulate(replace(SMALL, frames=len(t)), 0).inputs(labels=True)
    inputs = replace(inputs, increments=preintegrate(model, t, v, omega, t)[0])
    fit_model = make_model(inputs, None, ("odometry",))
    new = apply(fit_model, vector(fit_model, {"odometry_v": 1.1, "odometry_omega": 0.9}))
    expected = preintegrate(model, t, 1.1 * v, 0.9 * omega, t)[0].mean
    assert new.increments.mean == pytest.approx(expected, abs=2e-4)


def test_what_a_log_does_not_determine_stays_as_stated():
    log = simulate(replace(SMALL, frames=30), 0)
    r = log.recorded
    D = np.diag([1.0, 0.0, 0.0])
    log = replace(log, recorded=replace(r, increments=Increments(r.increments.mean, D @ r.increments.covariance @ D)))
    model, _, found = fitted(log, ("motion",))
    status, theta = by_name(model, found.status), by_name(model, found.theta)
    assert status["motion_heading"] == status["motion_lateral"] == HELD
    assert theta["motion_heading"] == theta["motion_lateral"] == 0.0
    assert status["motion_along"] in (FITTED, AT_BOUND)


def test_what_a_short_log_cannot_tell_goes_back_to_what_it_states():
    _, _, found = fitted(simulate(replace(SMALL, frames=6), 2), ("motion",))
    assert HELD in found.status
    for theta, error, word in zip(found.theta, found.error, found.status):
        assert np.isfinite(error) == (word == FITTED)
        assert (theta == 0.0) == (word == HELD)


def test_innovations_of_the_halves_sum_to_those_of_the_whole():
    inputs = simulate(SMALL, 0).inputs(labels=True)
    decisions = pairings(inputs)
    half = middle(inputs, decisions)
    whole, first, second = score(inputs, decisions), score(inputs, decisions, 0, half), score(inputs, decisions, half)
    assert first.dof + second.dof == whole.dof == 2 * len(inputs.observations.z)
    assert first.log_likelihood + second.log_likelihood == pytest.approx(whole.log_likelihood)
    assert abs(first.dof - second.dof) < 0.1 * whole.dof


@pytest.fixture
def stated(tmp_path):
    """An arena with sigmas twice too large, as a folder."""
    write_folder(changed(simulate(replace(SMALL, frames=40), 5), noise=2.0), tmp_path / "stated")
    return tmp_path / "stated"


def test_the_copy_holds_the_fitted_numbers_the_same_truth_and_a_warning(stated, tmp_path, capsys):
    out = tmp_path / "tuned"
    assert main([str(stated), str(out), "--fit", "motion,sensor,bias"]) == 0
    text = capsys.readouterr().out
    assert "second half, tuned on the first" in text
    assert "do not report results on it" in text
    for name in ("truth.csv", "landmarks.csv"):
        assert (out / name).read_bytes() == (stated / name).read_bytes()
    log, before = load_folder(out), load_folder(stated)
    assert log.name == "tuned"
    assert log.notes[-1].endswith("do not report results on it; apply its numbers to another log with --use.")
    told = log.source["tuned"]
    assert told["fitted_to"] == "stated"
    factor = told["values"]["sigma_range"]
    assert factor == pytest.approx(0.5, abs=3.0 * told["standard_errors"]["sigma_range"])
    o, was = log.recorded.observations, before.recorded.observations
    assert o.R[:, 0, 0] == pytest.approx(factor**2 * was.R[:, 0, 0])
    assert o.z[:, 0] == pytest.approx(was.z[:, 0] - told["values"]["bias_range"])
    assert np.array_equal(log.truth.landmark_of, before.truth.landmark_of)


def test_the_same_log_gives_the_same_bytes(stated, tmp_path):
    for place in ("one", "two"):
        assert main([str(stated), str(tmp_path / place / "tuned"), "--fit", "sensor"]) == 0
    for path in sorted((tmp_path / "one" / "tuned").iterdir()):
        assert path.read_bytes() == (tmp_path / "two" / "tuned" / path.name).read_bytes()


def test_numbers_fitted_on_one_log_are_applied_to_another(stated, tmp_path, capsys):
    assert main([str(stated), str(tmp_path / "tuned"), "--fit", "sensor,bias"]) == 0
    other = tmp_path / "other"
    write_folder(changed(simulate(SMALL, 6), noise=2.0), other)
    assert main([str(other), str(tmp_path / "applied"), "--use", str(tmp_path / "tuned")]) == 0
    assert "do not report results" not in capsys.readouterr().out.split("other:")[1]
    values = load_folder(tmp_path / "tuned").source["tuned"]["values"]
    log, was = load_folder(tmp_path / "applied"), load_folder(other)
    ratio = log.recorded.observations.R[:, 1, 1] / was.recorded.observations.R[:, 1, 1]
    assert ratio == pytest.approx(values["sigma_bearing"] ** 2)
    assert log.source["tuned"] == {"fitted_to": "stated", "values": values}
    assert "stated" in log.notes[-1]


def test_gross_outliers_beyond_the_gate_are_left_out_once_for_all():
    log = simulate(SMALL, 0)
    r = log.recorded
    z = r.observations.z.copy()
    z[::50, 0] += 5.0
    log = replace(log, recorded=replace(r, observations=Observations(r.observations.frame, z, r.observations.R)))
    plain, gated = tune(log, groups="sensor"), tune(log, groups="sensor", gate=0.99999)
    factor = [t.model.parameters[0].value(t.theta[0]) for t in (plain, gated)]
    assert factor[0] > 3.0
    assert factor[1] == pytest.approx(1.0, abs=0.1)


def refused(*arguments):
    """Exit status 2 and one line."""
    assert main([str(a) for a in arguments]) == 2


def test_a_log_without_labels_is_refused(stated, tmp_path, capsys):
    lines = (stated / "observations.csv").read_text().splitlines()
    (stated / "observations.csv").write_text("\n".join(line.rpartition(",")[0] for line in lines) + "\n")
    refused(stated, tmp_path / "out")
    assert "has no labels" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_log_in_which_nothing_is_observed_is_refused(stated, tmp_path, capsys):
    header = (stated / "observations.csv").read_text().splitlines()[0]
    (stated / "observations.csv").write_text(header + "\n")
    refused(stated, tmp_path / "out")
    assert "there are no observations" in capsys.readouterr().err


def test_a_folder_with_other_content_is_left_alone(stated, tmp_path, capsys):
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("years of work")
    refused(stated, other)
    assert "not a tuned log" in capsys.readouterr().err
    write_folder(simulate(SMALL, 1), tmp_path / "untuned")
    refused(stated, tmp_path / "untuned")
    refused(stated, stated)
    assert "LOG itself" in capsys.readouterr().err
    assert (other / "thesis.tex").read_text() == "years of work"


def test_a_tuned_copy_is_not_tuned_again_but_may_be_replaced(stated, tmp_path, capsys):
    assert main([str(stated), str(tmp_path / "tuned"), "--fit", "sensor"]) == 0
    assert main([str(stated), str(tmp_path / "tuned"), "--fit", "bias"]) == 0
    assert set(load_folder(tmp_path / "tuned").source["tuned"]["values"]) == {"bias_range", "bias_bearing"}
    refused(tmp_path / "tuned", tmp_path / "again")
    assert "tune the original" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--fit", "magic"], "--fit magic: not known"),
        (["--gate", "1.5"], "a probability"),
        (["--use", "{stated}"], "not a tuned log"),
        (["--use", "{stated}", "--fit", "sensor"], "not a tuned log"),
    ],
)
def test_options_that_make_no_sense_are_refused_in_one_line(stated, tmp_path, capsys, options, message):
    refused(stated, tmp_path / "out", *[o.format(stated=stated) for o in options])
    assert message in capsys.readouterr().err


def test_a_filter_that_fails_as_stated_is_a_clear_error():
    log = simulate(SMALL, 0)
    r = log.recorded
    covariance = r.increments.covariance.copy()
    covariance[5] = -np.eye(3)
    log = replace(log, recorded=replace(r, increments=Increments(r.increments.mean, covariance)))
    with pytest.raises(DataError, match="fails at frame 5"):
        tune(log)


def test_a_slam_log_in_which_no_landmark_is_seen_twice_is_refused():
    log = simulate(replace(SMALL, frames=1), 0)
    log = replace(log, recorded=log.recorded.without_map())
    with pytest.raises(DataError, match="no landmark is seen twice"):
        tune(log)


def test_numbers_a_log_has_no_room_for_are_refused():
    with pytest.raises(UsageError, match="latency was fitted"):
        tune(simulate(SMALL, 0), use=Numbers("x", {"latency": 0.1}))

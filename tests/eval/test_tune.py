"""`eval.tune` finds latency and noise that were put into a log, says what it did, and refuses what makes no sense."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from data.errors import DataError, UsageError
from data.formats.open_log.reader import load_folder
from data.formats.open_log.writer import write_folder
from data.inputs import Increments, Observations
from data.sensors import Range
from data.worlds.arena import simulate
from eval.tune import main
from eval.tuning import Numbers, tune
from tests.eval.tuning.stated import SMALL, changed


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
    assert log.notes[-1].endswith("do not report results on it; apply its values to another log with --use.")
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


@pytest.mark.slow
def test_sigmas_fitted_to_correlated_innovations_are_not_to_be_believed_and_it_is_said_first(tmp_path, capsys):
    """Each landmark's ranges wander: the fit makes NIS right, and the covariance is too small as before."""
    log = simulate(SMALL, 0)
    r, rng = log.recorded, np.random.default_rng(1)
    wander = np.zeros((len(r), 100))
    for k in range(1, len(r)):
        wander[k] = 0.97 * wander[k - 1] + 0.05 * rng.standard_normal(100)
    o = r.observations
    z = o.z.copy()
    z[:, 0] += wander[o.frame, log.truth.landmark_of]
    log = replace(log, recorded=replace(r, observations=Observations(o.frame, z, o.R)))
    write_folder(log, tmp_path / "wandering")
    assert main([str(tmp_path / "wandering"), str(tmp_path / "out"), "--fit", "motion,sensor"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("warning: innovations stay correlated (lag-1 +0.")
    assert "pose NEES" in text
    assert load_folder(tmp_path / "out").notes[-1].startswith("In this fit, innovations stay correlated (lag-1 +0.")
    made = tune(log, groups="sensor")
    # what the warning names can be typed
    (groups,) = re.findall(r"\(--fit (\S+) fits no sigma\)", text.split("\n\n")[0])
    assert main([str(tmp_path / "wandering"), str(tmp_path / "again"), "--fit", groups]) == 0
    assert made.scores["tuned"].nis == pytest.approx(1.0, abs=0.05)
    assert made.errors["tuned"][2] > 3.6, "NEES, expected 3"
    assert tune(log, groups="bias").doubtful is None, "no sigma was fitted"
    assert tune(simulate(SMALL, 0), groups="sensor").doubtful is None, "white"


def refused(*arguments):
    """Exit status 2 and one line."""
    assert main([str(a) for a in arguments]) == 2


def test_a_log_without_labels_is_refused(stated, tmp_path, capsys):
    lines = (stated / "observations.csv").read_text().splitlines()
    (stated / "observations.csv").write_text("\n".join(line.rpartition(",")[0] for line in lines) + "\n")
    refused(stated, tmp_path / "out")
    assert "has no labels" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_log_of_ranges_alone_is_refused(stated, tmp_path, capsys):
    log = load_folder(stated)
    write_folder(replace(log, recorded=replace(log.recorded, sensor=Range())), stated)
    refused(stated, tmp_path / "out")
    assert "one of bearings or ranges alone; a fit needs one that measures two numbers" in capsys.readouterr().err


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
    assert "is LOG itself" in capsys.readouterr().err
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
        (["--fit", "magic"], "--fit magic: unknown; known: motion"),
        (["--fit", "latency"], "--fit latency: the log has increments (frames.csv), which cannot be cut"),
        (["--fit", "sensor,latency"], "convert it with v and omega, which become odometry.csv"),
        (["--gate", "1.5"], "a probability"),
        (["--use", "{stated}"], "not a tuned log"),
        (["--use", "{stated}", "--fit", "sensor"], "not a tuned log"),
    ],
)
def test_options_that_make_no_sense_are_refused_in_one_line(stated, tmp_path, capsys, options, message):
    refused(stated, tmp_path / "out", *[o.format(stated=stated) for o in options])
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


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

"""`eval.tune` finds latency and noise that were put into a log, says what it did, and refuses what makes no sense."""

from dataclasses import replace

import numpy as np
import pytest

from data.errors import DataError, UsageError
from data.formats.open_log import load_folder, write_folder
from data.inputs import Increments
from data.sensors import Range
from data.truth import Truth
from data.worlds.arena import simulate
from eval.tune import main
from eval.tuning import Numbers, tune
from tests.eval.tuning.stamped import SMALL, changed


@pytest.fixture
def stated(tmp_path):
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


def test_a_log_without_labels_or_of_ranges_alone_is_refused(stated, tmp_path, refused):
    log = load_folder(stated)
    for given, message in (
        (
            replace(log, recorded=replace(log.recorded, sensor=Range())),
            "one of bearings or ranges alone; a fit needs one",
        ),
        (replace(log, label=None, truth=Truth()), "has no labels"),
    ):
        write_folder(given, stated)
        assert message in refused(main, [str(stated), str(tmp_path / "out")])
        assert not (tmp_path / "out").exists()


def test_a_folder_with_other_content_is_left_alone(stated, tmp_path, refused):
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("years of work")
    assert "not a tuned log" in refused(main, [str(stated), str(other)])
    write_folder(simulate(SMALL, 1), tmp_path / "untuned")
    refused(main, [str(stated), str(tmp_path / "untuned")])
    assert "is LOG itself" in refused(main, [str(stated), str(stated)])
    assert (other / "thesis.tex").read_text() == "years of work"


def test_a_tuned_copy_is_not_tuned_again_but_may_be_replaced(stated, tmp_path, refused):
    assert main([str(stated), str(tmp_path / "tuned"), "--fit", "sensor"]) == 0
    assert main([str(stated), str(tmp_path / "tuned"), "--fit", "bias"]) == 0
    assert set(load_folder(tmp_path / "tuned").source["tuned"]["values"]) == {"bias_range", "bias_bearing"}
    assert "tune the original" in refused(main, [str(tmp_path / "tuned"), str(tmp_path / "again")])


@pytest.mark.parametrize(("options", "message"), [
    (["--fit", "magic"], "--fit magic: unknown; known: motion"),
    (["--fit", "latency"], "--fit latency: the log has increments (frames.csv), which cannot be cut"),
    (["--fit", "sensor,latency"], "convert it with v and omega, which become odometry.csv"),
    (["--gate", "1.5"], "a probability"), (["--use", "{stated}"], "not a tuned log"),
    (["--use", "{stated}", "--fit", "sensor"], "not a tuned log"),
])  # fmt: skip
def test_options_that_make_no_sense_are_refused_in_one_line(stated, tmp_path, refused, options, message):
    given = [str(stated), str(tmp_path / "out"), *(o.format(stated=stated) for o in options)]
    assert message in refused(main, given)


def test_a_fit_that_cannot_be_is_a_clear_error():
    log = simulate(SMALL, 0)
    r = log.recorded
    covariance = r.increments.covariance.copy()
    covariance[5] = -np.eye(3)
    log = replace(log, recorded=replace(r, increments=Increments(r.increments.mean, covariance)))
    with pytest.raises(DataError, match="fails at frame 5"):
        tune(log)
    log = simulate(replace(SMALL, frames=1), 0)
    log = replace(log, recorded=log.recorded.without_map())
    with pytest.raises(DataError, match="no landmark is seen twice"):
        tune(log)
    with pytest.raises(UsageError, match="latency was fitted"):
        tune(simulate(SMALL, 0), use=Numbers("x", {"latency": 0.1}))

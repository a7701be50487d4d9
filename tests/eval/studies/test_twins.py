"""A twin is its log drawn again, written as an open log too: same frames, same covariances, everything else anew."""

from dataclasses import replace

import numpy as np
import pytest

from data import se2
from data.errors import UsageError
from data.formats.open_log import write_folder
from data.inputs import CLUTTER
from data.log import shortened
from data.logs import open_log
from data.notice import stopped
from data.result import Failure
from data.truth import Truth
from eval.referee.errors import observed
from eval.replay.run import compare
from eval.replay.settings import Setup
from eval.studies import twins
from eval.studies.twins import digest_of, inputs_of, one_twin, smoother_of, source_of, twin
from eval.twin import main


def made(name="arena:1", task="slam", association="known", frames=60, estimators=("ekf",)):
    log = shortened(open_log(name), frames)
    inputs = inputs_of(log, task, association)
    runs = compare(inputs, task, (*estimators, "batch"), association)
    return log, runs, source_of(log, smoother_of(runs, inputs), estimators, Setup())


@pytest.fixture(scope="module")
def source():
    return made()[2]


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(source):
    one, same, other = twin(source, 5).recorded, twin(source, 5).recorded, twin(source, 6).recorded
    for get in (lambda r: r.prior.mean, lambda r: r.increments.mean, lambda r: r.observations.z):
        assert get(one).tobytes() == get(same).tobytes()
        assert get(one).tobytes() != get(other).tobytes()


def test_errors_of_twins_have_the_stated_covariances_and_no_mean(source):
    logs = [twin(source, seed) for seed in range(200)]
    r = source.log.recorded
    o, seen = r.observations, source.landmark_of >= 0
    motion = np.array([t.recorded.increments.mean[1:] - se2.between(source.path[:-1], source.path[1:]) for t in logs])
    exact = r.sensor.predict(source.path[o.frame[seen]], source.landmarks.positions(source.landmark_of[seen]))
    z = np.array([r.sensor.residual(t.recorded.observations.z[seen], exact) for t in logs])
    first = np.array([se2.pose_error(t.recorded.prior.mean, source.path[0]) for t in logs])
    for errors, stated in (
        (motion, r.increments.covariance[1:]), (z, o.R[seen]), (first[:, None], r.prior.covariance[None]),
    ):  # fmt: skip
        squares = np.einsum("rni,nij,rnj->rn", errors, np.linalg.inv(stated), errors)
        d = errors.shape[-1]
        assert squares.mean() == pytest.approx(d, abs=5.0 * np.sqrt(2.0 * d / squares.size))
        white = np.linalg.solve(np.linalg.cholesky(stated), errors.mean(axis=0)[..., None])
        assert np.mean(white**2) * len(logs) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / white.size))


def test_the_labels_of_a_twin_are_the_pairings_of_the_smoother_and_clutter_is_copied_as_read():
    log, runs, source = made("corridor:0:people", frames=44)
    t = twin(source, 0)
    clutter = t.truth.landmark_of == CLUTTER
    assert clutter.any()
    assert t.recorded.observations.z[clutter].tobytes() == log.recorded.observations.z[clutter].tobytes()
    paired = observed(runs[0]) >= 0
    assert t.truth.landmark_of[paired].tolist() == observed(runs[0])[paired].tolist()


def test_methods_that_decide_themselves_are_counted_on_twins():
    source = made("corridor:0", association="jcbb", frames=30)[2]
    tp, tn, fp, fn = one_twin(source, 0).counts["ekf"]
    assert tp + tn + fp + fn == len(source.log.recorded.observations.frame)
    assert tp > 0


def test_what_cannot_have_twins_is_a_sentence():
    log, runs, _ = made()
    with pytest.raises(UsageError, match="5 frames, at least 10"):
        source_of(shortened(log, 5), runs[-1], ("ekf",), Setup())
    failed = replace(runs[-1], failure=Failure("diverged", 0, stopped("landmark 3 is not determined")))
    with pytest.raises(UsageError, match=r"failed .landmark 3 is not determined"):
        source_of(log, failed, ("ekf",), Setup())


def test_the_digest_changes_with_whatever_a_twin_depends_on(source):
    moved = replace(source, path=source.path + 1e-9)
    other = replace(source, estimators=("ekf", "ekf-fej"))
    gated = replace(source, setup=Setup(gate_known=0.99))
    assert len({digest_of(s) for s in (source, moved, other, gated)}) == 4
    assert digest_of(source) == digest_of(replace(source))


def test_a_sample_that_was_kept_comes_back_and_a_damaged_one_does_not(source, tmp_path):
    sample = one_twin(source, 3)
    file = tmp_path / "3.json"
    twins.save(file, sample)
    assert repr(twins.load(file)) == repr(sample)
    file.write_bytes(file.read_bytes()[:-20])
    assert twins.load(file) is None
    assert twins.load(tmp_path / "4.json") is None


@pytest.fixture(scope="module")
def unmeasured(tmp_path_factory):
    """A log that nobody measured: no true path, no map, labels of the sensor."""
    log = shortened(open_log("arena:3"), 50)
    folder = tmp_path_factory.mktemp("logs") / "mine"
    given = replace(log, recorded=log.recorded.without_map(), truth=Truth(), label=log.granted, labels_are_sensed=True)
    write_folder(given, folder)
    return folder


def test_a_twin_of_a_log_that_nobody_measured_has_a_truth(unmeasured, tmp_path, capsys):
    assert main([str(unmeasured), str(tmp_path / "twin"), "--seed", "4"]) == 0
    assert "50 frames" in capsys.readouterr().out
    real, made = open_log(str(unmeasured)), open_log(str(tmp_path / "twin"))
    assert real.truth.pose is None
    assert made.truth.known_poses == 50
    assert made.truth.landmark_of is not None
    assert made.recorded.map is None  # SLAM, as with the log itself
    assert made.recorded.observations.frame.tolist() == real.recorded.observations.frame.tolist()
    assert made.source["twin_of"] == "mine"


def test_in_localization_the_path_of_the_localizing_smoother_is_the_truth(tmp_path):
    assert main(["arena:3", str(tmp_path / "l")]) == 0
    assert main(["arena:3", str(tmp_path / "s"), "--task", "slam"]) == 0
    local, slam = (open_log(str(tmp_path / n)) for n in "ls")
    assert local.recorded.map is not None
    true = open_log("arena:3").truth.pose
    assert np.hypot(*(local.truth.pose - true)[:, :2].T).max() < np.hypot(*(slam.truth.pose - true)[:, :2].T).max()


def test_what_makes_no_sense_is_one_line(unmeasured, tmp_path, refused):
    for arguments, words in (([str(unmeasured), "--task", "localization"], "has no map"), (["nowhere"], "nowhere")):
        assert words in refused(main, [*arguments, str(tmp_path / "out")])
    write_folder(shortened(open_log("arena:3"), 4), tmp_path / "short")
    assert "4 frames, at least 10 are needed" in refused(main, [str(tmp_path / "short"), str(tmp_path / "twin")])
    assert not (tmp_path / "twin").exists()
    assert "whole number" in refused(main, ["arena:3", "out", "--seed", "-1"])

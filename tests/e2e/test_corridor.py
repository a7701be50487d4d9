"""The corridor lab from end to end: recorded runs reproduced by the command, and what simulated ones must show."""

import math

import numpy as np
import pytest

from data.worlds.corridor import Corridor, simulate
from eval.referee import consistency, errors
from eval.referee.score import confusion_of
from eval.replay.run import compare
from eval.run_all import main
from tests.builders.tables import rows

LOGS = [f"corridor_s0_people{people}_odo{odometry}" for people in (0, 1) for odometry in (0, 1)]
RECORDED = {"nn": "NN", "singles": "SINGLES", "jcbb-first": "JCBB"}
FEW, MANY = range(24), range(50)


def column(path, *names):
    return np.array([[float(r[n]) for n in names] for r in rows(path)])


@pytest.fixture(scope="module")
def replayed(shared_data, tmp_path_factory):
    """Result folder of one run of the command over the four recorded logs, with the lab's gates."""
    out = tmp_path_factory.mktemp("corridor") / "results"
    logs = [part for name in LOGS for part in ("--log", str(shared_data / "lab_corridor" / name))]
    methods = ["--association", "known,nn,singles,jcbb-first,jcbb", "--gate", "0.99", "--new-gate", "0.99"]
    options = ["--task", "slam", "--estimator", "ekf", "--no-plots", "--out", str(out), "-q", "--jobs", "1"]
    assert main([*logs, *methods, *options]) == 0
    return out


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.parametrize("method", RECORDED)
def test_the_command_makes_every_recorded_decision_and_pose_again(replayed, shared_data, name, method):
    reference = shared_data / "lab_corridor" / name / "reference" / RECORDED[method]
    ours = replayed / "runs" / name / f"slam-ekf-{method}"
    decided = column(ours / "decisions.csv", "frame", "observation", "decision")
    recorded = column(reference / "hypotheses.csv", "frame", "observation", "h")
    np.testing.assert_array_equal(decided[:, :2], recorded[:, :2])
    np.testing.assert_array_equal(np.maximum(decided[:, 2] + 1, 0), recorded[:, 2])
    off = column(ours / "online.csv", "x", "y", "theta") - column(reference / "poses.csv", "x", "y", "theta")
    off[:, 2] = np.remainder(off[:, 2] + math.pi, 2 * math.pi) - math.pi
    assert np.abs(off).max() < (1e-8 if name.endswith("odo1") else 1e-6)
    clean = reference / ("decisions_clean.csv" if "people1" in name else "decisions.csv")
    expected = column(clean, "tp", "tn", "fp", "fn").sum(0).astype(int).tolist()
    counted = [r for r in rows(replayed / "association.csv") if (r["log"], r["association"]) == (name, method)]
    assert [[int(r[k]) for k in ("tp", "tn", "fp", "fn")] for r in counted] == [expected, expected]  # online and final
    assert len(rows(ours / "landmarks.csv")) == len(rows(reference / "map.csv"))


def test_least_joint_distance_and_labels_do_on_the_recorded_runs_what_independent_checks_found(replayed):
    found = {
        (r["log"], r["association"]): [int(r[k]) for k in ("tp", "tn", "fp", "fn")]
        for r in rows(replayed / "association.csv")
    }
    assert found[LOGS[1], "jcbb"] == [427, 89, 4, 5]
    assert found[LOGS[3], "jcbb"] == [414, 139, 29, 11]
    assert found[LOGS[1], "known"] == [437, 88, 0, 0]


@pytest.fixture(
    scope="module",
    params=[pytest.param(FEW, marks=pytest.mark.slow), pytest.param(MANY, marks=pytest.mark.slow)],
    ids=["few", "many"],
)
def study(request):
    result = []
    for seed in request.param:
        log = simulate(Corridor(), seed)
        inputs = log.inputs(labels=True)
        runs = {("ekf", a): compare(inputs, "slam", ["ekf"], a)[0] for a in ("known", "jcbb")}
        runs["isam2", "known"] = compare(inputs, "slam", ["isam2"])[0]
        result.append((log, runs))
    return result


def rmse(log, run):
    return errors.rms(errors.position_distance(run.online.pose, log.truth.pose))


def test_jcbb_pairs_nothing_wrong_and_is_as_good_as_the_labels_in_the_median(study):
    wrong, known, jcbb = [], [], []
    for log, runs in study:
        run = runs["ekf", "jcbb"]
        wrong.append(confusion_of(run, log, "online").fp / len(run.decisions))
        known.append(rmse(log, runs["ekf", "known"]))
        jcbb.append(rmse(log, run))
    assert np.median(wrong) <= 0.005
    assert np.mean(wrong) <= 0.01
    assert np.median(jcbb) <= 1.2 * np.median(known)


@pytest.mark.parametrize("estimator", ["ekf", "isam2"])
def test_with_labels_errors_are_inside_three_sigma_as_often_as_they_should_be(study, estimator):
    """Errors along a run are correlated, so the runs are the sample: Student's t at 0.1 % on their shares."""
    for coordinate in range(3):
        shares = []
        for log, runs in study:
            t = runs[estimator, "known"].online
            error = consistency.se2.pose_error(t.pose, log.truth.pose)[1:, coordinate]
            shares.append(np.mean(np.abs(error) <= 3.0 * np.sqrt(t.covariance[1:, coordinate, coordinate])))
        mean, standard_error = np.mean(shares), np.std(shares, ddof=1) / math.sqrt(len(shares))
        assert mean > 0.9973 - 3.5 * max(standard_error, 1e-3)
        assert mean > 0.985

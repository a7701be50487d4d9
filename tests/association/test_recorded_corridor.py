"""The recorded corridor runs: from increments and observations alone, every decision of the lab program and its poses.

Both gates at 0.99 are the lab's newness rule. The program's features count from 1 and 0 means unpaired; ours are
numbers from 0. An increment's covariance never needs the floor there (only row 0 is zero, and that row is no motion).
"""

import math

import numpy as np
import pytest

from association.decide import decide
from data.formats.open_log import load_folder
from data.inputs import CLUTTER
from ekf.slam import EkfSlam

LOGS = [f"corridor_s0_people{people}_odo{odometry}" for people in (0, 1) for odometry in (0, 1)]
RECORDED = {"nn": "NN", "singles": "SINGLES", "jcbb-first": "JCBB"}


def table(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def replay(inputs, method, new_gate=0.99):
    """Decisions, numbers created (M,) and poses (N, 3) of EKF-SLAM with its own decisions."""
    f = EkfSlam(inputs.prior, inputs.sensor)
    decisions, created, pose = [], [], []
    for k in range(len(inputs)):
        if k > 0:
            f.predict(inputs.increment(k))
        observations = inputs.frame_observations(k)
        decided = decide(method, f.expect(observations), 0.99, new_gate)
        assert decided.complete
        done = f.update(observations, decided.decisions)
        decisions.append(decided.decisions)
        created.append(done.created)
        pose.append(f.estimate().mean)
    return np.concatenate(decisions), np.concatenate(created), np.array(pose)


def counts(log, decisions, created):
    """TP, TN, FP, FN by the definition, with the right answer for a person always none."""
    inputs, truth = log.inputs(labels=False), log.truth.landmark_of
    frame, founder, result = inputs.observations.frame, {}, np.zeros(4, int)
    for k in range(len(inputs)):
        rows = np.flatnonzero(frame == k)
        for i in rows:
            right = founder.get(truth[i], -1) if truth[i] != CLUTTER else -1
            paired = decisions[i] >= 0
            result[(0 if decisions[i] == right else 2) if paired else (1 if right < 0 else 3)] += 1
        for i in rows:
            if created[i] >= 0:
                founder.setdefault(truth[i], created[i])
    return tuple(result.tolist())


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.parametrize("method", RECORDED)
def test_every_recorded_decision_is_made_again(shared_data, name, method):
    folder = shared_data / "lab_corridor" / name
    log = load_folder(folder)
    assert log.recorded.floored == 0
    inputs = log.inputs(labels=False).without_map()
    decisions, created, pose = replay(inputs, method)

    reference = folder / "reference" / RECORDED[method]
    np.testing.assert_array_equal(np.maximum(decisions + 1, 0), table(reference / "hypotheses.csv")["h"])
    features = table(reference / "features.csv")
    initializing = np.flatnonzero(created >= 0)
    frame = inputs.observations.frame[initializing]
    np.testing.assert_array_equal(created[initializing] + 1, features["feature"])
    np.testing.assert_array_equal(frame, features["frame"])
    np.testing.assert_array_equal(initializing - inputs.start[frame], features["observation"])

    recorded = table(reference / "poses.csv")
    error = pose - np.stack([recorded[c] for c in ("x", "y", "theta")], 1)
    error[:, 2] = np.remainder(error[:, 2] + math.pi, 2 * math.pi) - math.pi
    assert np.abs(error).max() < (1e-8 if name.endswith("odo1") else 1e-6)

    clean = reference / ("decisions_clean.csv" if "people1" in name else "decisions.csv")
    expected = tuple(int(table(clean)[c].sum()) for c in ("tp", "tn", "fp", "fn"))
    assert counts(log, decisions, created) == expected


def test_a_wider_second_gate_leaves_no_duplicate_where_there_are_no_people(shared_data):
    log = load_folder(shared_data / "lab_corridor" / LOGS[1])
    decisions, created, _ = replay(log.inputs(labels=False).without_map(), "jcbb", new_gate=0.99999)
    assert counts(log, decisions, created)[2] == 0
    assert (created >= 0).sum() == 88

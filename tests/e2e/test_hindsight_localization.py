"""The recorded UTIAS logs without labels: no robot is lost, and the pairings are those of the barcodes."""

from __future__ import annotations

import numpy as np
import pytest

from data.formats.mrclam.load import Treatment, load_mrclam
from data.result import DISCARD, revised
from eval.referee.confusion import share_within
from eval.replay.hindsight.localizing_frontend import LocalizingFrontEnd
from eval.replay.run import compare, filter_known
from eval.replay.settings import Setup

pytestmark = pytest.mark.usefixtures("tables_parsed_once")


def localize(log):
    """Ratio of position RMSE to that with labels, share of pairings that are right, and share of those with labels."""
    labels = log.inputs(labels=True).observations.label
    inputs = log.inputs(labels=False)
    front = LocalizingFrontEnd("ekf", "jcbb-hindsight", inputs, Setup())
    pose, decisions = np.empty((len(inputs), 3)), np.full(len(labels), -2)
    for k in range(len(inputs)):
        frame = inputs.frame(k)
        front.move(frame)
        if len(frame.observations.z):
            pairing = front.associate(frame)
            front.update(frame, pairing)
            decisions[frame.first : frame.first + len(pairing.decisions)] = pairing.decisions
        front.tidy()
        pose[k] = front.estimator.estimate().mean
    front.close()
    known = filter_known(log.inputs(labels=True), "localization").online.pose
    off = [np.nanmean(np.sum((p - log.truth.pose)[:, :2] ** 2, axis=1)) for p in (pose, known)]
    assert not front.alarms
    found = []
    for d in (decisions, revised(decisions, front.events())):
        right = (d == labels).sum()
        found += [right / (d >= 0).sum(), right / (labels >= 0).sum()]
    return np.sqrt(off[0] / off[1]), found


def test_a_robot_is_followed_without_labels(shared_data):
    ratio, shares = localize(load_mrclam(shared_data / "mrclam" / "MRCLAM_Dataset9.zip", 3, Treatment(stop=100.0)))
    assert ratio < 1.001
    assert min(shares) == 1.0


@pytest.mark.slow
def test_a_smoother_ends_where_the_final_decisions_lead(shared_data):
    # landmarks stand 0.18 m apart: which of them was seen often shows only later
    log = load_mrclam(shared_data / "mrclam" / "MRCLAM_Dataset6.zip", 5, Treatment(stop=200.0))
    isam2, smoothed = compare(log.inputs(labels=False), "localization", ["isam2", "batch"], "jcbb-hindsight")
    assert (isam2.final_decisions != isam2.decisions).sum() > 20
    assert np.abs(isam2.final.pose - smoothed.final.pose).max() < 1e-5
    labels = log.inputs(labels=True)
    final = isam2.final_decisions
    assert share_within(final, labels.observations.label, final, labels.map) > 0.97


def test_what_is_not_settled_at_the_end_is_smoothed_as_it_is_reported(shared_data):
    # after more than a minute without an observation
    log = load_mrclam(shared_data / "mrclam" / "MRCLAM_Dataset6.zip", 4, Treatment(240.0, 342.0))
    isam2, smoothed = compare(log.inputs(labels=False), "localization", ["isam2", "batch"], "jcbb-hindsight")
    assert ((isam2.decisions == DISCARD) & (isam2.final_decisions >= 0)).any()
    assert np.abs(isam2.final.pose - smoothed.final.pose).max() < 1e-5


BAD = [(755.0, 836.0), (945.0, 1050.0)]
LOGS = [(9, 3), (1, 1), (1, 2), (1, 3), (1, 4), (6, 1), (6, 2), (6, 3), (6, 4), (6, 5)]


def options(folder, dataset):
    if dataset == 1:
        return {"landmarks": folder / "Landmark_Groundtruth.corrected.dat"}
    return {"exclude_truth": BAD} if dataset == 9 else {}


@pytest.mark.slow
@pytest.mark.parametrize(("dataset", "robot"), LOGS)
def test_it_is_as_good_as_with_labels(shared_data, dataset, robot):
    """Position within 20 % of what labels give; their wrong ones, some barcodes are misread, are gated out."""
    folder = shared_data / "mrclam"
    log = load_mrclam(folder / f"MRCLAM_Dataset{dataset}.zip", robot, Treatment(**options(folder, dataset)))
    names = ["ekf", "isam2", "batch", "fixed-lag"]
    labels = log.inputs(labels=True)
    ours = compare(log.inputs(labels=False), "localization", names, "jcbb-hindsight")
    known = compare(labels, "localization", names, "known", Setup(gate_known=0.9999))
    label = labels.observations.label
    for mine, theirs in zip(ours, known, strict=True):
        for phase in ("online", "final"):
            paths = [getattr(run, phase) for run in (mine, theirs)]
            if paths[0] is None:
                continue
            off = [np.nanmean(np.sum((p.pose - log.truth.pose)[:, :2] ** 2, axis=1)) for p in paths]
            assert np.sqrt(off[0] / off[1]) < 1.2, (mine.estimator, phase)
        for decisions in (mine.decisions, mine.final_decisions):
            used = decisions >= 0
            if dataset == 6:
                assert share_within(decisions, label, decisions, labels.map) > 0.97
            else:
                right = decisions == label
                assert right.sum() / used.sum() > 0.97
                assert right.mean() > 0.9

"""The recorded UTIAS logs without labels: no robot is lost, and the pairings are those of the barcodes."""

from __future__ import annotations

import numpy as np
import pytest

from data.mrclam import load_mrclam
from data.result import revised
from eval.hindsight_frontend import LocalizingFrontEnd
from eval.replay import filter_known
from eval.setup import Setup


def localize(log):
    """Ratio of position RMSE to that with labels, share of pairings that are right, and share of those with labels."""
    labels = log.inputs(labels=True).observations.label
    inputs = log.inputs(labels=False)
    front = LocalizingFrontEnd("ekf", "jcbb-hindsight", inputs, Setup())
    pose, decisions = np.empty((len(inputs), 3)), np.full(len(labels), -2)
    for k in range(len(inputs)):
        front.move()
        rows = slice(int(inputs.start[k]), int(inputs.start[k + 1]))
        if rows.stop > rows.start:
            decisions[rows] = front.associate(rows)[0]
        front.tidy()
        pose[k] = front.estimator.estimate().mean
    front.close()
    known = filter_known(log.inputs(labels=True), "localization").online.pose
    off = [np.nanmean(np.sum((p - log.truth.pose)[:, :2] ** 2, axis=1)) for p in (pose, known)]
    assert not front.localizer.alarms
    found = []
    for d in (decisions, revised(decisions, front.events())):
        right = (d == labels).sum()
        found += [right / (d >= 0).sum(), right / (labels >= 0).sum()]
    return np.sqrt(off[0] / off[1]), found


def test_a_robot_is_followed_without_labels(shared_data):
    ratio, shares = localize(load_mrclam(shared_data / "mrclam" / "MRCLAM_Dataset9.zip", 3, stop=200.0))
    assert ratio < 1.001
    assert min(shares) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("dataset", "robot"), [(9, 3), (1, 1), (1, 2), (1, 3), (1, 4)])
def test_datasets_1_and_9_are_as_good_as_with_labels(shared_data, dataset, robot):
    folder = shared_data / "mrclam"
    options = {"landmarks": folder / "Landmark_Groundtruth.corrected.dat"} if dataset == 1 else {
        "exclude_truth": [(755.0, 836.0), (945.0, 1050.0)]
    }  # fmt: skip
    ratio, shares = localize(load_mrclam(folder / f"MRCLAM_Dataset{dataset}.zip", robot, **options))
    assert ratio < 1.2
    assert min(shares) > 0.97

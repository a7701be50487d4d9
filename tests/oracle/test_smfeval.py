"""The peer `smfeval` on the same trajectory: its NEES, CRPS, log score, energy score and bootstrap interval.

It reads wide TUM (pose and the lower triangle of the 6x6 covariance in a row) and scores translations alone. So the
heading is written as height: its translation is then our pose, its covariance ours. Rotations are all the identity:
then the tangent space of a pose is the world frame.
"""

import numpy as np
import pytest
from smfeval.io import load_estimate
from smfeval.scoring import gaussian_log_score_components, translation_crps

from data import se2
from data.logs import open_log
from eval.referee.errors import along
from eval.referee.score import Trial, score
from eval.replay.run import compare

ROTATION = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def scored():
    log = open_log("arena:3")
    (run,) = compare(log.inputs(labels=True), "localization", ["ekf"])
    (row,) = score([Trial(log, "localization", (run,))]).metrics.to_dict("records")
    return log, run, row, along(run, "online", log)


@pytest.fixture(scope="module")
def files(scored, tmp_path_factory):
    log, run, _, _ = scored
    folder = tmp_path_factory.mktemp("tum")
    truth = log.truth.pose
    # the heading beside its truth, so that no height jumps by a turn
    height = truth[:, 2] + se2.pose_error(run.online.pose, truth)[:, 2]
    wide, plain = [], []
    for k, t in enumerate(log.recorded.time):
        C = 1e-4 * np.eye(6)
        C[:3, :3] = run.online.covariance[k]
        entries = [C[i, j] for i in range(6) for j in range(i + 1)]
        wide.append([t, *run.online.pose[k, :2], height[k], *ROTATION, *entries])
        plain.append([t, *truth[k], *ROTATION])
    for name, rows in (("estimate.tum", wide), ("truth.tum", plain)):
        (folder / name).write_text("".join(" ".join(repr(float(v)) for v in row) + "\n" for row in rows))
    return folder


@pytest.fixture(scope="module")
def steps(files):
    return load_estimate(files / "estimate.tum", body_frame="robot")[1]


def test_its_log_score_and_crps_are_ours(scored, steps):
    log, _, row, _ = scored
    theirs = [gaussian_log_score_components(s, y, np.array(ROTATION)) for s, y in zip(steps, log.truth.pose)]
    assert row["log_score"] == pytest.approx(np.mean([t.translation.log_score for t in theirs]), rel=1e-9)
    assert row["nees_pose"] == pytest.approx(np.mean([t.translation.nees for t in theirs]), rel=1e-9)
    each = np.mean([translation_crps(s, y) for s, y in zip(steps, log.truth.pose)])
    assert row["crps_x_m"] + row["crps_y_m"] + row["crps_heading_rad"] == pytest.approx(3.0 * each, rel=1e-9)

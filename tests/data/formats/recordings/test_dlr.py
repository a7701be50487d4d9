"""The circle log of DLR: its order of covariances, identities, and lines that are none."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import DataError
from data.formats.recordings.dlr import load_dlr

STEP = "STEP a.png 0.1 -0.2 0.05 1e-4 2e-5 3e-4 4e-5 5e-5 6e-4\r\n"
SEEN = "LANDMARK_C 1 -1 0.7 0.01 0 0.02 -1\r\n"
TEXT = f"# comment\r\n\r\n{STEP}LANDMARK_C 0.5 -2 0.9 0.01 0.001 0.02 17\r\n{SEEN}{STEP}"


def test_steps_and_circles_are_read(tmp_path):
    (tmp_path / "map.circles").write_text(TEXT)
    log = load_dlr(tmp_path / "map.circles", "dlr")
    r = log.recorded
    assert r.increments.mean[1].tolist() == [0.1, -0.2, 0.05]
    assert r.increments.covariance[1] == pytest.approx(
        np.array([[1e-4, 2e-5, 4e-5], [2e-5, 3e-4, 5e-5], [4e-5, 5e-5, 6e-4]])
    )
    assert (r.observations.frame.tolist(), log.truth.landmark_of.tolist()) == ([1, 1], [17, -2])
    assert r.observations.R[0].tolist() == [[0.01, 0.001], [0.001, 0.02]]
    (tmp_path / "bad").write_text(TEXT + "LANDMARK_C 1 2\n")
    with pytest.raises(DataError, match="bad:7"):
        load_dlr(tmp_path / "bad", "dlr")

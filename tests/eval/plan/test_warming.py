"""What is compiled beforehand runs: a part that cannot would be compiled at its first use."""

from __future__ import annotations

import numpy as np

from eval.plan import warming


def test_place_recognition_is_run_on_a_small_log_that_was_read_from_a_folder(monkeypatch):
    asked = []
    monkeypatch.setattr(warming, "relocalize", lambda scan, place: asked.append((scan, place)))
    warming.PARTS["place recognition"]()
    ((scan, place),) = asked
    np.testing.assert_array_equal(scan.xy, place.xy)
    assert len(place.id) == 6
    assert scan.covariance.shape == (12, 12)
    assert scan.rows == tuple((i,) for i in range(6))

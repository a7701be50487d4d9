"""What is compiled beforehand runs: a part that cannot would be compiled at its first use."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

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


@pytest.mark.parametrize(("cores", "status", "here"), [(2, 0, 1), (2, 1, 3), (1, 0, 3)])
def test_a_second_process_compiles_its_parts_and_this_one_does_if_it_fails(cores, status, here, monkeypatch):
    done = []
    parts = {name: partial(done.append, name) for name in ("filters", *warming.BESIDE)}
    assert set(warming.BESIDE) < set(warming.PARTS)
    monkeypatch.setattr(warming, "PARTS", parts)
    monkeypatch.setattr(warming, "beside", lambda: SimpleNamespace(wait=lambda: status, kill=lambda: None))
    warming._compile(True, cores)
    assert done == list(parts)[:here]

"""The innovation of an observation that was not used is no number."""

from __future__ import annotations

import numpy as np

from data.se2 import Array
from data.sensors import RelativePoint
from ekf import updates
from ekf.kernels import NEWEST, Pairings


def whitened(readings: Array, threshold: float) -> Array:
    """What an update writes over a record that holds other numbers; both landmarks known, 1 m ahead."""
    k = len(readings)
    white, keep = np.full((k, 2), 7.0), np.zeros(k, bool)
    known, R = np.tile([1.0, 0.0], (k, 1)), np.tile(0.01 * np.eye(2), (k, 1, 1))
    at = np.full(k, -1, np.int64)
    sensor = RelativePoint(max_range=8.0)
    how = updates.UpdateRule(threshold, updates.ADDITIVE, 1, False, NEWEST)
    done = updates.Outcome(keep, np.zeros(3), white)
    seen = Pairings(at, known, readings, R)
    mean, P = np.zeros(3), 1e-12 * np.eye(3)
    updates.update(sensor.kind, sensor.extrinsic, mean, mean, P, 3, seen, 0, k, how, done)
    return white


def test_those_beyond_the_gate_have_none():
    white = whitened(np.array([[1.1, 0.0], [3.0, 0.0]]), 9.0)
    np.testing.assert_allclose(white, [[1.0, 0.0], [np.nan, np.nan]], atol=1e-4)


def test_nor_have_they_if_all_are():
    assert np.isnan(whitened(np.array([[3.0, 0.0], [-3.0, 0.0]]), 9.0)).all()

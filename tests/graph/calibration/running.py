"""Smoothers that estimate systematic errors, and what their runs are compared by."""

from __future__ import annotations

import numpy as np

from graph.incremental import Isam2Smoother


def calibrated(inputs, **options):
    return Isam2Smoother(inputs.prior, inputs.sensor, inputs.map, systematic=inputs.systematic, **options)


def true_map(inputs, created, xy):
    return xy[inputs.observations.label[np.argsort(created)[np.count_nonzero(created < 0) :]]]


def in_sigmas(difference, covariance):
    return np.abs(difference) / np.sqrt(np.diag(covariance))

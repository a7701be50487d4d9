"""Where errors are so small that every model is linear, filters end where the smoothers do; a test per measurement."""

import numpy as np
import pytest

from data.inputs import Increments, Prior
from data.pose_measurements import FixKind
from eval.replay.run import compare
from eval.replay.settings import FILTERS, Setup
from tests.builders.logs import inputs_of as build, observations_of
from tests.ekf.pose_oracle import closures_of, fixes_of, wandering

SCALE, FRAMES = 3e-5, 16


def inputs_of(kind):
    rng = np.random.default_rng(4)
    prior = Prior(np.array([1.0, 2.0, 0.4]), SCALE**2 * np.diag([0.09, 0.06, 0.04]))
    motions, fixes, closures, sources = wandering(rng, FRAMES, prior, SCALE)
    mean = np.array([np.zeros(3), *(m.mean for m in motions[1:])])
    covariance = np.array([np.zeros((3, 3)), *(m.covariance for m in motions[1:])])
    rows = [row for row in fixes if row[1].name.lower() == kind]
    return build(
        Increments(mean, covariance), observations_of([], [], label=[]), start=prior.mean, spread=prior.covariance,
        fixes=fixes_of(rows, sources) if rows else None, closures=closures_of(closures) if kind == "closure" else None,
    )  # fmt: skip


@pytest.mark.parametrize("kind", [*(kind.name.lower() for kind in FixKind), "closure"])
def test_a_filter_ends_where_the_smoothers_do(kind):
    inputs = inputs_of(kind)
    assert (inputs.fixes is None) == (kind == "closure")
    names = (*FILTERS, "isam2", "batch")
    *filters, isam2, batch = compare(inputs, "slam", names, setup=Setup(gate_poses=None))
    bare = compare(inputs_of("nothing"), "slam", ["ekf"])[0].online.covariance[-1]
    last, P = batch.final.pose[-1], batch.final.covariance[-1]
    assert np.trace(P) < 0.9 * np.trace(bare), "it says something"
    for run in (*filters, isam2):
        assert run.failure is None
        np.testing.assert_allclose(run.online.pose[-1], last, atol=1e-9 * np.sqrt(P.trace()) + 1e-11)
        np.testing.assert_allclose(run.online.covariance[-1], P, atol=1e-5 * P.trace())

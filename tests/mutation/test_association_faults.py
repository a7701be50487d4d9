"""Faults of the list of traps that sit between estimator, association and referee, put in by a fixture and caught.

Those inside a method stand in `tests/association/test_traps.py`. Each check passes as the code is and fails with the
fault; both are asserted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from association import decide as decide_module
from data.corridor import Corridor, simulate
from data.inputs import Inputs, LabelledObservations
from data.result import DISCARD, NEW
from ekf import slam as slam_module
from eval import confusion, replay
from eval.replay import compare, step_by_step
from eval.score import confusion_of
from eval.setup import Setup


@pytest.fixture(scope="module")
def log():
    return simulate(Corridor(frames=20), 0)


# 3: a new landmark without cross-covariance to the pose


def check_the_filter_is_as_certain_as_the_smoother(log):
    inputs = log.inputs(labels=True).without_map()
    ekf, isam2 = (step_by_step(name, inputs, "slam") for name in ("ekf", "isam2"))
    ratio = ekf.online.covariance[1:, 0, 0] / isam2.online.covariance[1:, 0, 0]
    assert ratio.min() > 0.8
    assert ratio.max() < 1.2


@pytest.fixture
def without_cross_covariance(monkeypatch):
    real = slam_module.kernels.augment

    def augment(kind, extrinsic, mean, P, size, z, R, variance, first):
        real(kind, extrinsic, mean, P, size, z, R, variance, first)
        P[size : size + 2, :size] = 0.0
        P[:size, size : size + 2] = 0.0

    monkeypatch.setattr(slam_module.kernels, "augment", augment)


def test_trap_3_a_new_landmark_without_cross_covariance(log, request):
    check_the_filter_is_as_certain_as_the_smoother(log)
    request.getfixturevalue("without_cross_covariance")
    with pytest.raises(AssertionError):
        check_the_filter_is_as_certain_as_the_smoother(log)


# 8: the right answer is looked up in the frame before


def check_labels_are_never_wrong(log):
    counts = confusion_of(compare(log.inputs(labels=True), "slam", ["ekf"], "known")[0], log, "online")
    assert counts.fp == counts.fn == 0


@pytest.fixture
def truth_of_the_frame_before(monkeypatch):
    real = confusion.ground_truth

    def late(frame, true_id, created, known, removed=None):
        gt = real(frame, true_id, created, known, removed)
        first = np.searchsorted(frame, frame)
        before = np.searchsorted(frame, np.maximum(frame - 1, 0))
        return gt[np.minimum(before + np.arange(len(frame)) - first, len(gt) - 1)]

    monkeypatch.setattr(confusion, "ground_truth", late)


def test_trap_8_the_right_answer_of_the_frame_before(log, request):
    check_labels_are_never_wrong(log)
    request.getfixturevalue("truth_of_the_frame_before")
    with pytest.raises(AssertionError):
        check_labels_are_never_wrong(log)


# 10: a joint marginal in another order than asked for


def check_the_smoother_expects_what_the_filter_expects(log):
    setup = Setup(gate_known=0.999999)
    ekf, isam2 = compare(log.inputs(labels=True), "slam", ["ekf", "isam2"], "known", setup)
    a, b = np.nansum(ekf.innovations.nis), np.nansum(isam2.innovations.nis)
    assert b == pytest.approx(a, rel=0.05)


@pytest.fixture
def marginals_in_order_of_their_keys(monkeypatch):
    from graph.engine import Engine

    real = Engine.covariance

    def covariance(self, keys):
        return real(self, [*keys[1:], keys[0]]) if len(keys) > 1 else real(self, keys)

    monkeypatch.setattr(Engine, "covariance", covariance)


def test_trap_10_joint_marginals_in_the_order_of_their_keys(log, request):
    check_the_smoother_expects_what_the_filter_expects(log)
    request.getfixturevalue("marginals_in_order_of_their_keys")
    with pytest.raises((AssertionError, np.linalg.LinAlgError)):
        check_the_smoother_expects_what_the_filter_expects(log)


# 15: a new landmark is decided with a look at the true id


def check_decisions_do_not_depend_on_the_truth(log):
    ids = log.truth.landmark_of.copy()
    np.random.default_rng(0).shuffle(ids)
    other = replace(log, truth=replace(log.truth, landmark_of=ids))
    a, b = (compare(x.inputs(labels=True), "slam", ["ekf"], "nn")[0] for x in (log, other))
    np.testing.assert_array_equal(a.decisions, b.decisions)


@pytest.fixture
def newness_that_peeks(monkeypatch):
    """The firewall taken down (labels stay in the inputs), and newness that asks whether the label is new."""
    frames = {}
    monkeypatch.setattr(Inputs, "without_labels", lambda self: self)
    real = replay.FrontEnd.associate

    def associate(self, rows, watch=None):
        o = self.inputs.observations
        assert isinstance(o, LabelledObservations)
        frames["label"], frames["known"] = o.label[rows], set(o.label[: rows.start].tolist())
        return real(self, rows, watch)

    def newness(expectation, decisions, new_gate):
        known = np.array([label in frames["known"] for label in frames["label"].tolist()])
        return np.where(decisions == NEW, np.where(known, DISCARD, NEW), decisions)

    monkeypatch.setattr(replay.FrontEnd, "associate", associate)
    monkeypatch.setattr(decide_module, "newness", newness)


def test_trap_15_a_new_landmark_decided_by_its_true_id(log, request):
    check_decisions_do_not_depend_on_the_truth(log)
    request.getfixturevalue("newness_that_peeks")
    with pytest.raises(AssertionError):
        check_decisions_do_not_depend_on_the_truth(log)


def test_the_faults_are_gone_afterwards(log):
    """Ordinary runs stay unpatched."""
    check_labels_are_never_wrong(log)
    assert step_by_step("ekf", log.inputs().without_map(), "slam", "jcbb").failure is None

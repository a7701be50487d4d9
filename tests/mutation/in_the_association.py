"""Faults between expectation and decision, put into the methods the replay calls; checks as in `tests.association`."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.stats import chi2

from association import decide as decide_module
from association import jcbb as jcbb_module
from association.decide import decide
from association.expectation import SingularInnovationError, plain_residual
from association.jcbb import search_best
from association.methods import ml
from data.inputs import Inputs
from data.result import DISCARD, NEW
from data.sensors import measure
from ekf import kernels
from eval.replay import run as replay
from eval.replay.run import compare
from tests.association import checks as alone
from tests.mutation.faults import Check, Fault, interpreted, replaced
from tests.mutation.verdicts import corridor


def method(name):
    """The decisions of a method as the replay asks for them."""
    return lambda e, gate: decide(name, e, gate, gate).decisions


def ordinary_expectation(f, observations):
    return f.expect(observations)


def jcbb(e, gate):
    """JCBB before newness has its say."""
    return jcbb_module.jcbb(e, gate)


def as_good_as_exhaustive():
    alone.check_a_tie_found_later_can_win(jcbb)
    alone.check_as_good_as_an_exhaustive_search(jcbb)


def decisions_without_truth():
    log = corridor()
    ids = log.truth.landmark_of.copy()
    np.random.default_rng(0).shuffle(ids)
    other = replace(log, truth=replace(log.truth, landmark_of=ids))
    a, b = (compare(x.inputs(labels=True), "slam", ["ekf"], "nn")[0].decisions for x in (log, other))
    assert np.array_equal(a, b), f"{(a != b).sum()} of {len(a)} changed"


BEHIND = Check(
    "a landmark straight behind is recognised across the cut",
    partial(alone.check_a_landmark_behind_is_recognised_across_the_cut, ordinary_expectation),
)
CONTRADICTION = Check(
    "pairs that contradict each other are not both made",
    partial(alone.check_pairs_that_contradict_each_other_are_not_both_made, jcbb),
)
ADD_UP = Check(
    "many pairs may add up to more than one may have",
    partial(alone.check_many_pairs_may_add_up_to_more_than_one_may_have, jcbb),
)
EXHAUSTIVE = Check("JCBB is as good as an exhaustive search", as_good_as_exhaustive)
TWO_SIGMA = Check("two sigma are inside a gate of 99 %", alone.check_two_sigma_are_inside_a_gate_of_99_percent)
NO_PEEKING = Check("decisions stay when true ids are shuffled", decisions_without_truth)
AT_THE_ROBOT = Check(
    "a landmark at the robot is expected with finite numbers",
    partial(alone.check_a_landmark_at_the_robot_is_expected_with_finite_numbers, lambda e: e),
)
FAR = Check(
    "the nearer of two far landmarks is the likelier",
    partial(alone.check_the_nearer_of_two_far_landmarks_is_the_likelier, method("ml")),
)
UNCERTAIN = Check(
    "by distance an uncertain landmark attracts more",
    partial(alone.check_by_distance_an_uncertain_landmark_attracts_more, method("nn")),
)
CERTAIN = Check(
    "by likelihood the certain landmark is taken",
    partial(alone.check_by_likelihood_the_certain_one_is_taken, method("ml")),
)


def gate_at(dof_for):
    """JCBB's gates at other degrees of freedom; None: no gate."""

    def make(real):
        def gate_threshold(probability, dof=2):
            wanted = dof_for(dof)
            return np.inf if wanted is None else real(probability, wanted)

        return gate_threshold

    return replaced("association.expectation.gate_threshold", make)


def ties_cut(monkeypatch):
    cut = interpreted(search_best, {"hopeless = after < best or": "hopeless = after <= best or"})
    monkeypatch.setattr(jcbb_module, "search_best", cut)


def without_a_guard(monkeypatch):
    bare = interpreted(measure, {"if r < MIN_RANGE:": "if False:"})
    expect = interpreted(kernels.expect, measure_landmark=interpreted(kernels.measure_landmark, measure=bare))

    def expect_quietly(*arguments):
        with np.errstate(all="ignore"):
            expect(*arguments)

    monkeypatch.setattr(kernels, "expect", expect_quietly)


def exponentiated(monkeypatch):
    score = "d2 + e.log_determinants()"
    monkeypatch.setitem(decide_module.PLAIN, "ml", interpreted(ml, {score: f"-np.exp(-0.5 * ({score}))"}))


def newness_that_peeks(monkeypatch):
    """The firewall taken down (labels stay in the inputs), and newness that asks whether the label is new."""
    frames = {"seen": set()}
    monkeypatch.setattr(Inputs, "without_labels", lambda self: self)
    real = replay.FrontEnd.associate

    def associate(self, frame):
        if frame.first == 0:
            frames["seen"] = set()
        frames["label"], frames["known"] = frame.label, set(frames["seen"])
        frames["seen"] |= set(frame.label.tolist())
        return real(self, frame)

    def newness(expectation, decisions, new_gate):
        known = np.array([label in frames["known"] for label in frames["label"].tolist()])
        return np.where(decisions == NEW, np.where(known, DISCARD, NEW), decisions)

    monkeypatch.setattr(replay.FrontEnd, "associate", associate)
    monkeypatch.setattr(decide_module, "newness", newness)


def likelihood_for_distance(monkeypatch):
    monkeypatch.setitem(decide_module.PLAIN, "nn", ml)


def distance_for_likelihood(real):
    return lambda self: np.zeros_like(real(self))


FAULTS = (
    Fault(1, "bearing not wrapped in association", BEHIND,
          replaced("data.sensors.Sensor.residual", lambda real: lambda self, z, z_hat: plain_residual(z, z_hat))),
    Fault(5, "JCBB without a joint test", CONTRADICTION, gate_at(lambda dof: dof if dof == 2 else None)),
    Fault(5, "joint test at the dof of one pair", ADD_UP, gate_at(lambda dof: 2)),
    Fault(6, "bound that cuts branches that could tie", EXHAUSTIVE, ties_cut),
    Fault(7, "chi2.cdf for its inverse", TWO_SIGMA,
          replaced("association.expectation._chi2", lambda real: lambda p, dof: float(chi2.cdf(p, dof)))),
    Fault(15, "newness that looks at the true id", NO_PEEKING, newness_that_peeks),
    Fault(17, "division by the range without a guard", AT_THE_ROBOT, without_a_guard,
          by=SingularInnovationError, match="observation 0 and landmark 0"),
    Fault(18, "likelihood that underflows", FAR, exponentiated),
    Fault(19, "nearest neighbour by likelihood", UNCERTAIN, likelihood_for_distance),
    Fault(19, "maximum likelihood by distance alone", CERTAIN,
          replaced("association.expectation.Expectation.log_determinants", distance_for_likelihood)),
)  # fmt: skip

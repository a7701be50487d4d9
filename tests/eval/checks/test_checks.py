"""Ours pass every check, and each check fails what is wrong in its way, with a sentence that says so."""

import re

import pytest

import slamref
from association.names import METHODS
from data.errors import UsageError
from eval.checks import associations, estimators
from eval.checks.exactness import exactness
from eval.checks.finding import APPROXIMATE, EXACT, CheckError, graded
from eval.replay.external.adapter import Method, load, text_of
from eval.replay.settings import FILTERS, INCREMENTAL
from tests.eval.checks import wrong


@pytest.mark.parametrize(
    "name", ["ekf", *(pytest.param(n, marks=pytest.mark.slow) for n in (*FILTERS[1:], *INCREMENTAL))]
)
def test_our_own_estimators_pass_every_check(name):
    findings = slamref.estimator_findings(name)
    assert [f.line for f in findings if not f.passed or "not exact" in f.sentence] == []
    # only filters claim to be exact in a linear world, in both tasks
    assert len({f.check for f in findings}) == len(findings) == (36 if name in FILTERS else 34)


@pytest.mark.parametrize(("off", "passed", "said"), [
    (0.0, True, "x within 0.001 sigma"), (EXACT, True, "x within"), (1.001 * EXACT, True, "not exact: x only within"),
    (APPROXIMATE, True, "not exact: x only within"),
    (1.001 * APPROXIMATE, False, "sigma off where x was expected within"),
])  # fmt: skip
def test_how_far_off_decides_what_is_said(off, passed, said):
    found = graded("a check", off, "x")
    assert (found.passed, said in found.sentence) == (passed, True)


@pytest.mark.parametrize("name", METHODS)
def test_our_own_ways_of_association_pass_every_check(name):
    slamref.check_association(name)


PREDICTED = "z_hat off by up to .* sigma, first in frame 2; .*look at `predict` of the mean"
WRONG = [
    (estimators.seams, "localization", wrong.NoWrap, r"sigma off where the same path in a world turned by .* rad"),
    (estimators.seams, "localization", wrong.BelowZero, "the same path in a world turned by"),
    (estimators.seams, "localization", wrong.NearTheSeam, "the same path in a world turned by 3.1 rad"),
    (estimators.seams, "localization", wrong.Averaging, r"turned by .* rad \(a heading is 3.14\)"),
    (estimators.without_noise, "localization", wrong.Drifting, "sigma off where the true path from exact observations"),
    (exactness, "localization", wrong.Drifting, PREDICTED),
    (estimators.covariances, "slam", wrong.Asymmetric, "frame 0: Asymmetric.estimate: the covariance is not symmetric"),
    (estimators.purity, "slam", wrong.Writing, "observations.z of frame 0 was changed by up to 0.5: copy what is kept"),
    (estimators.purity, "slam", wrong.Keeping, "prior.mean was changed by up to "),
    (estimators.determinism, "slam", wrong.Unseeded, "m apart on the same input: random numbers without a seed"),
    (estimators.determinism, "slam", wrong.Sharing, "or state shared by all objects of the class"),
    (estimators.empty_frames, "localization", wrong.Shaken, "an update with DISCARD alone leaves the pose where it is"),
    (estimators.empty_frames, "slam", wrong.Empty, "Empty.update raised ValueError: zero-size array"),
    (exactness, "slam", wrong.Swapped, "landmarks off by up to"),
    (exactness, "slam", wrong.OwnRange, "landmarks off .* a range and bearing of your own, .* do not fit it"),
    (estimators.removal, "slam", wrong.Returning, "landmark 0 was removed and is in the map again"),
    (exactness, "slam", wrong.Blurred, "HPH' off by up to"),
    (estimators.runs, "localization", wrong.Drifting, "our EKF's path of an ordinary log, .* expected within 1 sigma"),
    (estimators.runs, "slam", wrong.Dead, r"stopped at frame 1: Dead.predict raised OSError: flat battery \(wrong.py"),
]


@pytest.mark.parametrize(("check", "task", "estimator", "words"), WRONG, ids=lambda x: getattr(x, "__name__", ""))
def test_each_check_of_an_estimator_fails_what_is_wrong_in_its_way(check, task, estimator, words):
    found = list(check(text_of(estimator, "estimator"), task))
    assert not all(f.passed for f in found), [f.line for f in found]
    assert any(re.search(words, f.sentence) for f in found if not f.passed), [f.line for f in found]


def test_sigma_points_on_both_sides_of_the_seam_are_no_fault(monkeypatch):
    monkeypatch.setattr(wrong.Averaging, "turn", staticmethod(estimators.wrap_angle))
    assert "0.001 sigma" in next(iter(estimators.seams(text_of(wrong.Averaging, "estimator"), "localization"))).sentence


@pytest.mark.parametrize(("method", "name", "words"), [
    (wrong.first, "exact observations", "names no candidate|is exactly landmark"),
    (wrong.unwrapped, "angle seams", "bearings 3.1316 and -3.1316 are 0.02 rad apart, decided is -1, not 7"),
    (wrong.greedy, "no landmark twice", r"in \d+ of 30 crowded frames a landmark is paired twice"),
    (wrong.fragile, "empty frames", "fragile raised ValueError: zero-size array"),
    (wrong.ungated, "gate", r"a pair of squared distance .* passed the gate 0.99, which is 9.21"),
    (wrong.in_order, "order of candidates", r"goes to \d+, and to \d+ with the candidates in another order"),
    (wrong.writing, "purity", "it changed expectation.z: work on a copy"),
    (wrong.tossing, "determinism", "the same frame twice: .*; random numbers need a fixed seed"),
    (wrong.never, "exact observations", ""), (wrong.one_dof, "inside the gate", ""),
])  # fmt: skip
def test_each_check_of_an_association_fails_what_is_wrong_in_its_way(method, name, words):
    loaded = load(text_of(method, "association"))
    found = next(f for f in associations.run(Method(loaded), loaded.thing) if f.check == name)
    assert not found.passed
    assert re.search(words, found.sentence)


def test_a_method_may_say_that_it_pairs_twice():
    said = {f.check: f for f in slamref.association_findings(wrong.allowed)}
    assert all(f.passed for f in said.values())
    assert "as it declares" in said["no landmark twice"].sentence


def test_failures_are_an_assertion_error_with_a_sentence_each():
    with pytest.raises(CheckError, match=r"greedy fails 1 of 9 checks:\nFAIL  no landmark twice: in") as failed:
        slamref.check_association(wrong.greedy)
    assert isinstance(failed.value, AssertionError)
    assert sum(not f.passed for f in failed.value.findings) == 1


def test_what_is_no_estimator_fails_at_its_interface_and_what_cannot_be_checked_is_said():
    class Nothing:
        pass

    (found,) = slamref.estimator_findings(Nothing)
    assert (found.check, found.passed) == ("interface", False)
    assert "no method 'predict'" in found.sentence
    with pytest.raises(UsageError, match="batch: does not work step by step"):
        slamref.check_estimator("batch")
    with pytest.raises(UsageError, match="known: decides by more than one frame"):
        slamref.check_association("known")

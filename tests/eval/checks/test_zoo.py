"""The zoo of wrong estimators and ways of association: each is rejected; right ones and sound approximations pass."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from ekf.filter import FilterDivergedError
from eval.checks import exactness, worlds
from eval.checks.estimators import without_noise
from eval.checks.exactness import Agreement, Bug, Deviation, Quantity, Stopped, sentence
from eval.replay.external.adapter import text_of
from eval.replay.settings import FILTERS, INCREMENTAL
from tests.eval.checks.plain import Plain, wrapped
from tests.eval.checks.zoo import MUTANTS, SWARMS, Jittered, mutant, swarm
from tests.oracle import reference_ekf

LOCALIZING = ("R-doubled", "stale-Jacobians", "no-wrap", "NIS-is-dof", "body-frame", "last-dropped")


def facts(estimator, task="slam"):
    text = estimator if isinstance(estimator, str) else text_of(estimator, "estimator")
    exact = getattr(estimator, "exact", text not in INCREMENTAL)
    linear = exactness.compared(text, task, worlds.LINEAR, exact=True) if exact else []
    shown = any(not isinstance(f, Agreement) for f in linear)
    return linear if shown else [*linear, *exactness.compared(text, task, worlds.MILD, exact=exact)]


@pytest.mark.parametrize(("name", "task"), [*product(MUTANTS, ["slam"]), *product(LOCALIZING, ["localization"])])
def test_a_wrong_estimator_is_rejected_and_its_mistake_named(name, task):
    mutant, bug = MUTANTS[name]
    wrong = [f for f in facts(mutant, task) if not isinstance(f, Agreement)]
    assert wrong
    assert all(set(f.bugs) == ({bug} if isinstance(bug, Bug) else bug or set()) for f in wrong)
    assert all(bug is None or "Likely: " in sentence(f) for f in wrong)


@pytest.mark.parametrize("name", SWARMS)
def test_draws_and_weights_of_samples_tell_their_mistakes(name):
    changes, bugs = SWARMS[name]
    for found in exactness.exactness(text_of(swarm(changes), "estimator"), "localization"):
        assert {getattr(f, "bugs", ()) for f in found.facts} == {bugs}


def test_bearings_not_wrapped_are_named_of_pairings_used_one_by_one_and_whatever_comes_later():
    class Later(Plain):
        exact = False

        def update(self, o, decisions):
            for i in np.flatnonzero(decisions >= 0):
                super().update(type("Seen", (), {"z": o.z[i : i + 1], "R": o.R[i : i + 1]}), decisions[i : i + 1])

        def innovation(self, z, z_hat):
            a = self.x[2]
            return z - z_hat if self.sensor.kind else z - [z_hat[0, 0], wrapped(z_hat[0, 1] + a) - a]

        Q = lambda self, M: 3.3 * M  # noqa: E731

    class Averaged(Plain):
        exact = False

        def innovation(self, z, z_hat):
            points = wrapped(z_hat[:, 1:] + [0.002, 0.0, -0.002]).mean(axis=1)  # of sigma points
            return super().innovation(z, np.column_stack([z_hat[:, 0], points]))

    for estimator, bug in ((Later, Bug.INNOVATION_NOT_WRAPPED), (Averaged, Bug.ACROSS_PI)):
        (found,) = exactness.exactness(text_of(estimator, "estimator"), "localization")
        assert {f.bugs for f in found.facts} == {(bug,)}


def test_a_motion_that_divides_by_its_turn_stops_in_a_step_without_one():
    arcs = mutant(moved=lambda s, c, n, u, v, w: Plain.moved(s, c, n, u, v, w) if w else np.full(3, np.nan))
    for thing, passes in ((arcs, False), (Plain, True)):
        assert [f.passed for f in without_noise(text_of(thing, "estimator"), "slam")] == [passes]


def test_a_mistake_is_one_sentence_that_names_what_follows_from_it():
    mutant, _ = MUTANTS["R-doubled"]
    for found in exactness.exactness(text_of(mutant, "estimator"), "slam"):
        assert not found.passed
        assert len(found.facts) > 3
        assert found.sentence.count("Likely: ") == found.sentence.count(" off by up to ") == 1
        assert "; so are " in found.sentence


def test_what_is_off_before_any_pairing_is_put_down_to_new_landmarks_and_not_to_a_sensor_of_its_own():
    found = next(exactness.exactness(text_of(MUTANTS["new-too-sure-then-corrected"][0], "estimator"), "slam"))
    assert re.search("pose covariance off.* new landmarks alone", found.sentence)
    assert "of your own" not in found.sentence


def test_a_mistake_explains_nothing_that_began_before():
    first = Deviation("mild", Quantity.POSE, 0, True, True, 9.0, 0.05, (), True)
    then = replace(first, quantity=Quantity.COVARIANCE, frame=1, first=False, bugs=(Bug.Q_NONE,))
    assert re.search("Off before anything else: .*pose covariance .*Likely: ", exactness.sentences([first, then]))


@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("estimator", [Plain, *FILTERS])
def test_what_claims_to_be_exact_is(estimator, task):
    linear, mild = facts(estimator, task)
    assert {type(linear), type(mild)} == {Agreement}
    assert (linear.world, linear.allowed, mild.world, linear.frames) == ("linear", exactness.EXACTLY, "mild", 14)
    assert set(linear.quantities) >= set(Quantity) - {
        Quantity.LANDMARKS,
        Quantity.LANDMARK_COVARIANCE,
        Quantity.SAMPLES,
    }


@pytest.mark.parametrize(
    ("estimator", "task"), [(Jittered, "localization"), (Jittered, "slam"), *((n, "slam") for n in INCREMENTAL)]
)
def test_a_sound_approximation_is_accepted(estimator, task):
    (mild,) = facts(estimator, task)
    assert isinstance(mild, Agreement)
    assert (mild.world, mild.allowed) == (worlds.MILD, exactness.NEARLY)


def test_an_approximation_that_claims_to_be_exact_is_told_how_to_declare_it():
    class Claiming(Jittered):
        exact = True

    linear = [f for f in facts(Claiming) if isinstance(f, Deviation)]
    assert {f.world for f in linear} == {worlds.LINEAR}
    assert any("declares `exact = False`" in sentence(f) for f in linear)


def test_what_cannot_begin_or_diverges_is_a_line_and_no_traceback():
    def raising(error):
        def method(*_):
            raise error

        return method

    never = mutant(landmarks=raising(OSError("no map")))
    diverging = mutant(update=raising(FilterDivergedError("infinite")))

    class NoResidual(Plain):
        def said(self, o, numbers, z_hat, joint):
            return replace(super().said(o, numbers, z_hat, joint), residual=None)

    for kind, why in ((never, "OSError: no map"), (diverging, "infinite"), (NoResidual, "TypeError")):
        (stopped,) = facts(kind)
        assert (stopped.frame, stopped.bugs) == (0, ())
        assert why in stopped.why


@pytest.mark.parametrize("exact", [True, False])
def test_a_landmark_that_waits_is_an_error_only_of_what_claims_to_be_exact(exact):
    class Waiting(Plain):
        def update(self, o, decisions):
            kept = np.where(decisions == -1, -2, decisions) if len(self.x) > 12 else decisions
            return super().update(o, kept) | {"created": np.where(kept == -1, self.numbers(kept), -1)}

        def numbers(self, decisions):
            return (len(self.x) - 3) // 2 - (decisions == -1).sum() + np.cumsum(decisions == -1) - 1

    Waiting.exact = exact
    (only,) = facts(Waiting)
    assert isinstance(only, Stopped if exact else Agreement)
    assert not exact or "NEW observations initialize no landmark" in only.why


def test_an_approximation_of_which_no_pairing_was_compared_has_not_passed():
    class Never(Jittered):
        def update(self, o, decisions):
            return super().update(o, np.full(len(decisions), -2)) | {"created": np.full(len(decisions), -1)}

    assert "in frame 0: 3 NEW observations initialize no landmark, so nothing could be" in sentence(*facts(Never))


def test_a_gate_of_its_own_is_named():
    class Gated(Jittered):
        def update(self, o, decisions):
            kept = np.where(np.cumsum(decisions >= 0) > 3, -2, decisions)
            return super().update(o, kept) | {"used": kept >= 0}

    assert "leaves out pairings that it is given (a gate of its own?)" in sentence(facts(Gated, "localization")[0])


@pytest.mark.parametrize("world", [worlds.LINEAR, worlds.MILD])
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_the_exact_filter_is_that_of_the_textbook(world, task):
    """`tests.oracle.reference_ekf` shares no code with it."""
    inputs = exactness.inputs_of(world, task)
    frames, states = exactness.exact_states(world, task)
    o, kind = inputs.observations, inputs.sensor.kind
    known = None if inputs.map is None else {int(i): xy for i, xy in zip(inputs.map.id, inputs.map.xy)}
    path, P, nis, x, full = reference_ekf.run(
        kind, np.zeros(3), inputs.prior.mean, inputs.prior.covariance, inputs.increments.mean,
        inputs.increments.covariance, o.frame, o.z, o.R, np.concatenate([d for _, d in frames]), known,
    )  # fmt: skip
    np.testing.assert_allclose([s.pose for s in states], path, atol=1e-6)
    sigma = np.sqrt(np.einsum("nii->ni", P))
    off = (np.array([s.covariance for s in states]) - P) / (sigma[:, :, None] * sigma[:, None, :])
    assert np.abs(off).max() < 1e-5
    np.testing.assert_allclose([0.0 if np.isnan(s.nis) else s.nis for s in states], nis, rtol=1e-4, atol=1e-9)
    if known is None:
        np.testing.assert_allclose(states[-1].xy.ravel(), x[3:], atol=1e-5)
        np.testing.assert_allclose(states[-1].blocks[0], full[3:5, 3:5], rtol=1e-4)

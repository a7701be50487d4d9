"""Foreign estimators and methods among ours: the same numbers where they are the same; faults are sentences."""

import dataclasses

import numpy as np
import pytest

import slamref
from association.expectation import Expectation
from data.inputs import FrameObservations
from data.notice import Code, notice
from data.worlds.arena import Arena, simulate
from eval.replay.external import adapter
from eval.replay.run import compare
from tests.data.formats.open_log.same_log import assert_same_log
from tests.eval.replay.external import things

LOG = simulate(Arena(frames=12), 3)
LABELLED = LOG.inputs(labels=True)
OWN = {"slam": things.Mine, "localization": things.MineLocal}


def same(a, b):
    aside = {"estimator": "", "association": "", "seconds": 0.0, "notes": ()}
    assert_same_log(dataclasses.replace(a, **aside), dataclasses.replace(b, **aside))


@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("association", ["known", "nn", "jcbb", "ml-ratio", "jcbb-hindsight"])
def test_an_unchanged_subclass_gives_the_same_numbers_to_the_bit(task, association):
    ours, theirs = compare(LABELLED, task, ["ekf", OWN[task]], association)
    same(ours, theirs)
    assert (theirs.estimator, theirs.association) == (OWN[task].__name__, association)
    assert theirs.status == "ok"


@pytest.mark.parametrize("task", ["slam", "localization"])
def test_singles_under_another_name_gives_the_same_numbers_to_the_bit_with_every_estimator(task):
    names = ["ekf", "isam2", "batch", OWN[task]]
    ours = compare(LABELLED, task, names, "singles")
    theirs = compare(LABELLED, task, names, things.again)
    for a, b in zip(ours, theirs, strict=True):
        same(a, b)
    assert {r.association for r in theirs} == {"my.singles"}


def test_the_least_that_an_estimator_can_be_runs_with_labels():
    for task in ("slam", "localization"):
        (run,) = compare(LABELLED, task, [things.Bare])
        (path,) = compare(LABELLED, task, ["dead-reckoning"])
        np.testing.assert_allclose(run.online.pose, path.online.pose, atol=1e-12)
        assert run.status == "ok"
        assert np.isnan(run.online.covariance).all()
        assert notice(Code.NO_COVARIANCE, name="Bare") in run.notes
        (refused,) = compare(LABELLED, task, [things.Bare], "nn")
        assert (refused.status, refused.failure.frame) == ("incomplete", 0)
        assert "Bare has no `expect`" in refused.failure.why


def test_without_a_covariance_nees_is_blank_and_everything_else_is_there():
    runs = compare(LABELLED, "slam", ["ekf", things.NoCovariance])
    ours, theirs = slamref.score([slamref.Trial(LOG, "slam", tuple(runs))]).metrics.to_dict("records")
    for column in ("nees_pose", "nees_position", "nees_heading", "inside_3sigma"):
        assert not np.isfinite(float(theirs[column] if theirs[column] is not None else np.nan))
    for column in ("rmse_position_m", "rmse_landmark_m", "nis", "accepted"):
        assert ours[column] == theirs[column]


@pytest.mark.parametrize("association", ["known", "singles"])
def test_who_says_nothing_of_innovations_gets_them_from_the_expectation(association):
    ours, theirs = compare(LABELLED, "slam", ["ekf", things.Silent], association)
    np.testing.assert_allclose(theirs.innovations.nis, ours.innovations.nis, rtol=1e-9)
    np.testing.assert_allclose(theirs.innovations.white, ours.innovations.white, rtol=1e-6, atol=1e-9)
    assert theirs.total_nis == pytest.approx(ours.total_nis)
    np.testing.assert_array_equal(theirs.created, ours.created)
    assert not any(n.code in (Code.NIS_STATED, Code.NIS_UNCHECKED) for n in theirs.notes)


@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("association", ["known", "nn"])
def test_a_nis_that_is_stated_too_well_is_not_believed(task, association):
    kind = things.Flattering if task == "slam" else things.FlatteringLocal
    ours, theirs = compare(LABELLED, task, ["ekf", kind], association)
    np.testing.assert_allclose(theirs.innovations.nis, ours.innovations.nis, rtol=1e-9)
    np.testing.assert_allclose(theirs.innovations.log_likelihood, ours.innovations.log_likelihood, rtol=1e-9)
    (said,) = [n for n in theirs.notes if n.code == Code.NIS_STATED]
    total, dof = ours.total_nis
    assert said.named["stated"] == 1.0
    assert said.named["formed"] == pytest.approx(total / dof)
    assert 0 < said.named["frames"] <= said.named["of"] <= len(LABELLED)
    assert "the NIS that it states is not that of its own expectation" in slamref.sentence(said)


@pytest.mark.parametrize(("kind", "why"), [(things.Unexpecting, "it has no `expect`"), (things.Unready, "not yet")])
def test_a_nis_that_cannot_be_formed_is_blank_and_a_notice(kind, why):
    (run,) = compare(LABELLED, "localization", [kind])
    assert (run.status, run.innovations) == ("ok", None)
    (said,) = [n for n in run.notes if n.code == Code.NIS_UNCHECKED]
    assert why in said.named["why"]
    assert said.named["stated"]
    assert "cannot be checked" in slamref.sentence(said)


def test_a_crash_ends_its_own_run_at_its_frame_with_the_traceback():
    ours, theirs, unborn = compare(LABELLED, "slam", ["ekf", things.Crashing, things.Unborn])
    same(ours, compare(LABELLED, "slam", ["ekf"])[0])
    frame = int(LABELLED.observations.frame[np.flatnonzero(ours.created > 8)[0]]) + 1
    assert (theirs.status, theirs.failure.frame) == ("diverged", frame)
    assert theirs.failure.why.startswith("Crashing.update raised RuntimeError: no room for more (things.py, line ")
    assert 'raise RuntimeError("no room\\nfor more")' in theirs.failure.trace
    assert theirs.failure.trace.count("File ") == 1
    assert np.isfinite(theirs.online.pose[:frame]).all()
    assert np.isnan(theirs.online.pose[frame:]).all()
    assert (unborn.status, unborn.failure.frame) == ("diverged", 0)
    assert unborn.failure.why.startswith("Unborn() raised KeyError: 'constructor'")


def test_who_writes_into_its_inputs_is_stopped_and_nobody_else_notices():
    (before,) = compare(LABELLED, "slam", ["ekf"])
    theirs, after = compare(LABELLED, "slam", [things.Writing, "ekf"])
    same(before, after)
    assert "Writing.update raised ValueError" in theirs.failure.why
    assert "read-only" in theirs.failure.why


def test_a_method_that_crashes_or_writes_ends_the_runs_that_use_it():
    def crashing(expectation, gate):
        raise ValueError("lost")

    def writing(expectation, gate):
        expectation.number[:] = 0
        return np.full(len(expectation.z), -1)

    for method, words in ((crashing, "crashing raised ValueError: lost"), (writing, "read-only")):
        run, batch = compare(LABELLED, "slam", ["ekf", "batch"], method)
        assert (run.status, batch.status) == ("diverged", "incomplete")
        assert words in run.failure.why


DECISIONS = np.array([-1, 4, -2, -1])
NEW = DECISIONS == -1


@pytest.mark.parametrize(("given", "words"), [
    (None, "returned None; .mean, covariance. is needed"), ((1, 2, 3), "returned a tuple of 3"),
    (np.zeros(4), r"the mean has shape \(4,\); \(3,\) is needed"),
    (np.array([0.0, np.nan, 0.0]), "the mean is not finite"),
    ((np.zeros(3), np.eye(2)), r"the covariance has shape \(2, 2\); \(3, 3\)"),
    ((np.zeros(3), np.triu(np.ones((3, 3)))), r"not symmetric: two elements differ by 1.*; L @ L\.T is"),
    ((np.zeros(3), np.diag([1.0, 1.0, -0.5])), "not positive semidefinite: an eigenvalue is -0.5"),
    ("here", "the mean is 'here'; an array"),
])  # fmt: skip
def test_a_pose_that_is_none_is_said(given, words):
    with pytest.raises(adapter.ForeignError, match=words):
        adapter.pose_of("F.estimate", given)


def test_a_pose_comes_with_or_without_covariance_and_with_its_heading_wrapped():
    assert np.isnan(adapter.pose_of("", np.zeros(3)).covariance).all()
    assert np.isnan(adapter.pose_of("", (np.zeros(3), None)).covariance).all()
    assert adapter.pose_of("", [1.0, 2.0, 4.0]).mean.tolist() == [1.0, 2.0, pytest.approx(4.0 - 2.0 * np.pi)]
    assert adapter.pose_of("", (np.zeros(3), np.zeros((3, 3)))).covariance.tolist() == np.zeros((3, 3)).tolist()


def test_samples_become_the_mean_and_covariance_that_numpy_has_for_them_across_the_seam():
    rng = np.random.default_rng(1)
    poses = rng.normal([1.0, 2.0, np.pi], [0.1, 0.2, 0.3], (500, 3))
    weights = rng.integers(1, 5, 500)
    found = adapter.pose_of(
        "", adapter.Samples(np.column_stack([poses[:, :2], (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi]), weights)
    )
    np.testing.assert_allclose(found.mean[:2], np.average(poses, axis=0, weights=weights)[:2])
    assert abs(abs(found.mean[2]) - np.pi) < 0.05
    expected = np.cov(poses[:, :2].T, aweights=weights)
    np.testing.assert_allclose(found.covariance[:2, :2], expected, rtol=1e-12)
    np.testing.assert_allclose(found.covariance[2, 2], np.cov(poses[:, 2], aweights=weights), rtol=2e-3)
    with pytest.raises(adapter.ForeignError, match="one sample has all the weight"):
        adapter.pose_of("F.estimate", adapter.Samples(poses, np.eye(500)[0]))
    with pytest.raises(adapter.ForeignError, match="500 samples need as many weights"):
        adapter.pose_of("F.estimate", adapter.Samples(poses, -weights))


def test_an_update_need_not_say_what_it_did():
    done = adapter.updated_of("", None, DECISIONS, NEW, 7)
    assert done.used.tolist() == [False, True, False, False]
    assert done.created.tolist() == [7, -1, -1, 8]
    assert np.isnan(done.nis)
    less = adapter.updated_of(
        "", {"nis": 3.0, "used": np.zeros(4, bool), "created": [7, -1, -1, -1]}, DECISIONS, NEW, 7
    )
    assert (less.nis, less.dof, less.created.tolist()) == (3.0, 0, [7, -1, -1, -1])


@pytest.mark.parametrize(("given", "words"), [
    (3, "returned an int; None, a data.result.Updated, or a dict"), ({"nees": 3}, "a dict with some of its fields"),
    ({"used": np.ones(3, bool)}, r"used is bool \(3,\); bool \(4,\) is needed"),
    ({"created": [8, -1, -1, 7]}, r"created is \[8, -1, -1, 7\]; landmarks are numbered in the order"),
    ({"created": [-1, 7, -1, -1]}, "order of their creation"),
    ({"created": [0.5, 1, 1, 1]}, "whole numbers are needed"),
])  # fmt: skip
def test_an_update_that_cannot_be_is_said(given, words):
    with pytest.raises(adapter.ForeignError, match=words):
        adapter.updated_of("F.update", given, DECISIONS, NEW, 7)


def problem(**changed):
    e = Expectation.from_arrays(np.zeros((2, 2)), np.zeros((3, 2)), np.eye(6), np.tile(np.eye(2), (2, 1, 1)))
    return dataclasses.replace(e, **changed)


@pytest.mark.parametrize(("given", "words"), [
    ("nothing", "returned a str; an association.expectation.Expectation is needed"),
    (problem(z_hat=np.zeros((2, 2))), r"z_hat has shape \(2, 2\); \(3, 2\)"),
    (problem(HPHt=np.full((3, 2, 2), np.inf)), "HPHt is not finite"),
    (problem(number=np.array([1, 1, 2])), "a candidate is named twice"),
])  # fmt: skip
def test_an_expectation_that_cannot_be_is_said(given, words):
    with pytest.raises(adapter.ForeignError, match=words):
        adapter.expectation_of("F.expect", given, FrameObservations(np.zeros((2, 2)), np.tile(np.eye(2), (2, 1, 1))))


@pytest.mark.parametrize(("returned", "words"), [
    (None, "whole numbers are needed"), ([0.0, 1.0], "whole numbers are needed"),
    ([0, 1, 2], r"has shape \(3,\); \(2,\) is needed"),
    ([7, -1], "decision 7 about observation 0 names no candidate; the number of one, NEW .-1. or DISCARD .-2."),
    ([-1, -3], "decision -3 about observation 1"),
])  # fmt: skip
def test_decisions_that_cannot_be_are_said(returned, words):
    def deciding(expectation, gate):
        return returned

    with pytest.raises(adapter.ForeignError, match=words):
        adapter.Method(adapter.load(adapter.text_of(deciding, "association")))(problem(), 0.99)


def test_a_map_without_covariance_is_a_map():
    assert np.isnan(adapter.map_of("", (np.array([0, 2]), np.zeros((2, 2)), None)).covariance).all()
    with pytest.raises(adapter.ForeignError, match=r"returned a list; .number, xy, covariance. is needed"):
        adapter.map_of("F.landmarks", [1])


def test_the_effective_number_of_samples_counts_copies_once():
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert adapter.Samples(poses[1:]).effective == pytest.approx(3.0)
    assert adapter.Samples(poses).effective == pytest.approx(16.0 / 6.0)
    assert adapter.Samples(poses, np.array([1.0, 0.0, 0.0, 0.0])).effective == pytest.approx(1.0)

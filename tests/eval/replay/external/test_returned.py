"""What foreign code returns is used where it can be; where not, a sentence says what it was and what is needed."""

from __future__ import annotations

import numpy as np
import pytest

from association.expectation import Expectation
from data.inputs import FrameObservations
from eval.replay.external.adapter import (
    ForeignError,
    Method,
    Samples,
    expectation_of,
    load,
    map_of,
    pose_of,
    text_of,
    updated_of,
)

DECISIONS = np.array([-1, 4, -2, -1])
NEW = DECISIONS == -1


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (None, "returned None; .mean, covariance. is needed"),
        ((1, 2, 3), "returned a tuple of 3"),
        (np.zeros(4), r"the mean has shape \(4,\); \(3,\) is needed"),
        (np.array([0.0, np.nan, 0.0]), "the mean is not finite"),
        ((np.zeros(3), np.eye(2)), r"the covariance has shape \(2, 2\); \(3, 3\)"),
        ((np.zeros(3), np.triu(np.ones((3, 3)))), "not symmetric: two elements differ by 1"),
        ((np.zeros(3), np.diag([1.0, 1.0, -0.5])), "not positive semidefinite: an eigenvalue is -0.5"),
        ("here", "the mean is 'here'; an array"),
    ],
)
def test_a_pose_that_is_none_is_said(given, words):
    with pytest.raises(ForeignError, match=words):
        pose_of("F.estimate", given)


def test_a_pose_comes_with_or_without_covariance_and_with_its_heading_wrapped():
    assert np.isnan(pose_of("", np.zeros(3)).covariance).all()
    assert np.isnan(pose_of("", (np.zeros(3), None)).covariance).all()
    assert pose_of("", [1.0, 2.0, 4.0]).mean.tolist() == [1.0, 2.0, pytest.approx(4.0 - 2.0 * np.pi)]
    assert pose_of("", (np.zeros(3), np.zeros((3, 3)))).covariance.tolist() == np.zeros((3, 3)).tolist()


def test_samples_become_the_mean_and_covariance_that_numpy_has_for_them_across_the_seam():
    rng = np.random.default_rng(1)
    poses = rng.normal([1.0, 2.0, np.pi], [0.1, 0.2, 0.3], (500, 3))
    weights = rng.integers(1, 5, 500)
    found = pose_of("", Samples(np.column_stack([poses[:, :2], (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi]), weights))
    mean = np.average(poses, axis=0, weights=weights)
    np.testing.assert_allclose(found.mean[:2], mean[:2])
    assert abs(abs(found.mean[2]) - np.pi) < 0.05
    expected = np.cov(poses[:, :2].T, aweights=weights)
    np.testing.assert_allclose(found.covariance[:2, :2], expected, rtol=1e-12)
    np.testing.assert_allclose(found.covariance[2, 2], np.cov(poses[:, 2], aweights=weights), rtol=2e-3)
    with pytest.raises(ForeignError, match="one sample has all the weight"):
        pose_of("F.estimate", Samples(poses, np.eye(500)[0]))
    with pytest.raises(ForeignError, match="500 samples need as many weights"):
        pose_of("F.estimate", Samples(poses, -weights))


def test_an_update_need_not_say_what_it_did():
    done = updated_of("", None, DECISIONS, NEW, 7)
    assert done.used.tolist() == [False, True, False, False]
    assert done.created.tolist() == [7, -1, -1, 8]
    assert np.isnan(done.nis)
    less = updated_of("", {"nis": 3.0, "used": np.zeros(4, bool), "created": [7, -1, -1, -1]}, DECISIONS, NEW, 7)
    assert (less.nis, less.dof, less.created.tolist()) == (3.0, 0, [7, -1, -1, -1])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (3, "returned an int; None, a data.result.Updated, or a dict"),
        ({"nees": 3}, "a dict with some of its fields"),
        ({"used": np.ones(3, bool)}, r"used is bool \(3,\); bool \(4,\) is needed"),
        ({"created": [8, -1, -1, 7]}, r"created is \[8, -1, -1, 7\]; landmarks are numbered in the order"),
        ({"created": [-1, 7, -1, -1]}, "order of their creation"),
        ({"created": [0.5, 1, 1, 1]}, "whole numbers are needed"),
    ],
)
def test_an_update_that_cannot_be_is_said(given, words):
    with pytest.raises(ForeignError, match=words):
        updated_of("F.update", given, DECISIONS, NEW, 7)


def problem(**changed):
    e = Expectation.from_arrays(np.zeros((2, 2)), np.zeros((3, 2)), np.eye(6), np.tile(np.eye(2), (2, 1, 1)))
    return Expectation(**{**{name: getattr(e, name) for name in e.__dataclass_fields__}, **changed})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("nothing", "returned a str; an association.expectation.Expectation is needed"),
        (problem(z_hat=np.zeros((2, 2))), r"z_hat has shape \(2, 2\); \(3, 2\)"),
        (problem(HPHt=np.full((3, 2, 2), np.inf)), "HPHt is not finite"),
        (problem(number=np.array([1, 1, 2])), "a candidate is named twice"),
    ],
)
def test_an_expectation_that_cannot_be_is_said(given, words):
    with pytest.raises(ForeignError, match=words):
        expectation_of("F.expect", given, FrameObservations(np.zeros((2, 2)), np.tile(np.eye(2), (2, 1, 1))))


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        (None, "whole numbers are needed"),
        ([0.0, 1.0], "whole numbers are needed"),
        ([0, 1, 2], r"has shape \(3,\); \(2,\) is needed"),
        ([7, -1], "decision 7 about observation 0 names no candidate; the number of one, NEW .-1. or DISCARD .-2."),
        ([-1, -3], "decision -3 about observation 1"),
    ],
)
def test_decisions_that_cannot_be_are_said(returned, words):
    def deciding(expectation, gate):
        return returned

    with pytest.raises(ForeignError, match=words):
        Method(load(text_of(deciding, "association")))(problem(), 0.99)


def test_a_map_without_covariance_is_a_map():
    found = map_of("", (np.array([0, 2]), np.zeros((2, 2)), None))
    assert np.isnan(found.covariance).all()
    with pytest.raises(ForeignError, match=r"returned a list; .number, xy, covariance. is needed"):
        map_of("F.landmarks", [1])


def test_the_effective_number_of_samples_counts_copies_once():
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert Samples(poses[1:]).effective == pytest.approx(3.0)
    assert Samples(poses).effective == pytest.approx(16.0 / 6.0)
    assert Samples(poses, np.array([1.0, 0.0, 0.0, 0.0])).effective == pytest.approx(1.0)

"""Foreign estimators and ways of association among ours: the same numbers where they are the same, alone where not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import slamref
from data.notice import Code, notice
from data.worlds.arena import Arena, simulate
from eval.replay.run import compare
from tests.eval.replay.external import things

LOG = simulate(Arena(frames=12), 3)
LABELLED = LOG.inputs(labels=True)
OWN = {"slam": things.Mine, "localization": things.MineLocal}


def same(a, b):
    """Whether two runs are the same to the bit, names, notes and time aside."""
    for f in dataclasses.fields(a):
        left, right = getattr(a, f.name), getattr(b, f.name)
        if f.name in ("estimator", "association", "seconds", "notes"):
            continue
        if dataclasses.is_dataclass(left):
            for g in dataclasses.fields(left):
                np.testing.assert_array_equal(getattr(left, g.name), getattr(right, g.name), f"{f.name}.{g.name}")
        elif isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right, f.name)
        else:
            assert left == right, f.name


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

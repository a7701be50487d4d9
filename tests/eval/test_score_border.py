"""Results whose stamps, formats or headings are not what they seem: asked for, refused or said."""

from __future__ import annotations

import numpy as np
import pytest

from tests.eval.test_score_faults import lines, scored

__all__ = ["scored"]

N = 300
TIME = 1_500_000_000.25 + 0.1 * np.arange(N)
PATH = np.column_stack([3.0 * np.cos(0.02 * np.arange(N)), 3.0 * np.sin(0.02 * np.arange(N))])
YAW = 0.5 * np.pi + 0.02 * np.arange(N)


def tum(time, path=PATH, yaw=YAW):
    zero = np.zeros(len(path))
    return lines(np.column_stack([time, path, zero, zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]))


@pytest.mark.parametrize("of", ["estimate", "truth"])
@pytest.mark.parametrize(("stamps", "why"), [(np.floor(TIME), "whole seconds"), (np.full(N, TIME[0]), "all are equal"),
                                             (np.round(TIME / 3) * 3 + 0.5, "few digits")])  # fmt: skip
def test_stamps_that_do_not_tell_poses_apart_are_refused(scored, of, stamps, why):
    files = (tum(stamps), tum(TIME)) if of == "estimate" else (tum(TIME), tum(stamps))
    said = scored(*files, status=2)
    assert f"have the stamp of the next one ({why})" in said
    assert said.count("\n") == 1


def test_poses_that_are_repeated_are_merged(scored):
    text = tum(np.repeat(TIME, 2), np.repeat(PATH, 2, axis=0), np.repeat(YAW, 2))
    assert scored(text, tum(TIME))[0]["matched"] == N


@pytest.mark.parametrize(("step", "matched"), [(1.0009, 291), (2.0, 281), (30.0, 1)])
def test_the_largest_gap_follows_from_the_rate_of_the_truth(scored, step, matched):
    at = np.arange(TIME[0], TIME[-1], step)
    k = (at - TIME[0]) / 0.1
    truth = tum(at, 3.0 * np.column_stack([np.cos(0.02 * k), np.sin(0.02 * k)]), 0.5 * np.pi + 0.02 * k)
    assert scored(tum(TIME), truth)[0]["matched"] == matched

"""Frames of a robot are chained as tf states them."""

from __future__ import annotations

import math

import pytest

from data.formats.recordings.ros import Transforms

HALF = math.sqrt(0.5)
NONE, LEFT = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, HALF, HALF)


def test_a_chain_of_frames_carries_points_to_the_frame_above():
    frames = Transforms()
    frames.add("base", "plate", (1.0, 0.0, 0.2), LEFT)
    frames.add("/plate", "/laser", (0.0, 2.0, 0.3), NONE)
    found = frames.between("base", "laser")
    # a point 1 m ahead of the laser: (1, 2) on the plate, which turns x to y and y to -x
    assert found.R @ [1.0, 0.0, 0.0] + found.t == pytest.approx([1.0 - 2.0, 1.0, 0.5])


def test_frames_without_a_common_one_and_frames_in_a_circle_are_not_connected():
    frames = Transforms()
    frames.add("a", "b", (1.0, 0.0, 0.0), NONE)
    frames.add("b", "a", (1.0, 0.0, 0.0), NONE)
    assert frames.between("base", "b") is None
    assert frames.between("base", "base").t.tolist() == [0.0, 0.0, 0.0]

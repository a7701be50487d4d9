"""Which landmarks a smoother is asked about: those near the robot, however many there are, and none is missed."""

from __future__ import annotations

import numpy as np

from data.worlds.corridor import Corridor, simulate
from eval.replay.run import step_by_step
from graph import incremental as expected
from graph.incremental import REFRESH, STEADY, PositionCache


class World:
    """Landmarks along a line, one a metre, that a smoother may move; counts how many are looked up."""

    def __init__(self, count):
        self.xy = np.stack([np.arange(count), np.ones(count)], 1).astype(float)
        self.looked = 0

    def positions_of(self, numbers):
        self.looked += len(numbers)
        return self.xy[numbers].copy()


def drive(count, frames=200):
    """Landmarks around a robot that goes along the line, against those that are there; lookups per frame."""
    world, near = World(count), PositionCache()
    number = np.arange(count)
    for k in range(frames):
        point = np.array([0.2 * k, 0.0])
        at, xy = near.around(number, point, np.full(count, 5.0), world.positions_of)
        np.testing.assert_array_equal(xy, world.xy[at])
        must = np.flatnonzero(np.hypot(*(world.xy - point).T) <= 5.0)
        assert np.isin(must, at).all()
        world.xy += 0.001  # creeps
    return world.looked / frames


def test_the_number_of_lookups_hardly_grows_with_the_map():
    few, many = drive(300), drive(3000)
    assert few < 14 + 2 * 300 / REFRESH
    assert many < 14 + 2 * 3000 / REFRESH


def test_after_a_loop_was_closed_all_are_looked_up_again():
    for tell in ("pose", "landmark"):
        world, near = World(100), PositionCache()
        number, radius, point = np.arange(100), np.full(100, 5.0), np.zeros(2)
        near.around(number, point, radius, world.positions_of)
        world.xy[50:] -= [50.0, 0.0]  # far away ones come near
        if tell == "pose":
            near.corrected(np.array([0.0, 1.1 * STEADY]))
        else:
            world.xy[2] += [0.6 * STEADY, 0.0]
        at, xy = near.around(number, point, radius, world.positions_of)
        assert np.isin(np.arange(50, 55), at).all(), tell
        np.testing.assert_array_equal(xy, world.xy[at])


def test_new_and_removed_landmarks_are_followed():
    world, near = World(60), PositionCache()
    for number in (np.arange(40), np.arange(60), np.delete(np.arange(60), [3, 7])):
        at, xy = near.around(number, np.array([5.0, 0.0]), np.full(len(number), 4.0), world.positions_of)
        np.testing.assert_array_equal(xy, world.xy[number[at]])
        assert np.isin(number[np.abs(world.xy[number, 0] - 5.0) < 3.0], number[at]).all()
    at, _ = near.around(np.arange(60), np.array([5.0, 0.0]), np.full(60, np.inf), world.positions_of)
    assert len(at) == 60


def test_isam2_decides_and_estimates_as_if_it_asked_for_all_of_them(monkeypatch):
    inputs = simulate(Corridor(), 1).inputs().without_map()
    run = step_by_step("isam2", inputs, "slam", "jcbb", finish=False)
    monkeypatch.setattr(expected, "REFRESH", 1)
    plain = step_by_step("isam2", inputs, "slam", "jcbb", finish=False)
    np.testing.assert_array_equal(run.decisions, plain.decisions)
    np.testing.assert_array_equal(run.online.pose, plain.online.pose)

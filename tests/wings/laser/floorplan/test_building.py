"""Buildings: closed outside, open inside, every room within reach, and ways that keep clear of what stands."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from data.inputs import Scanner
from wings.laser.floorplan.building import _layout
from wings.laser.floorplan.world import drive, plan_of, scan_ranges

ROUND = Scanner(-math.pi, math.radians(4.0), 60.0, 0.01)


@pytest.fixture(scope="module", params=range(4))
def building(request):
    return plan_of(request.param)


def test_every_place_can_be_reached(building):
    n = len(building.ways.place)
    assert (
        connected_components(
            csr_array((building.ways.length, building.ways.edge.T.astype(np.int32)), shape=(n, n)), False
        )[0]
        == 1
    )
    route = building.ways.route(int(building.ways.target[0]), int(building.ways.target[-1]), building.ways.length)
    steps = {frozenset(e) for e in building.ways.edge.tolist()}
    assert all(frozenset(pair) in steps for pair in pairwise(route))


def test_a_drive_keeps_clear_of_walls_and_furniture_and_sees_no_way_out(building):
    path = drive(building.ways, np.random.default_rng(0), 2.0 * np.arange(600), 0.5, 0.6)
    ranges = scan_ranges(path, ROUND, 90, building.walls)
    assert ranges.min() > 0.25
    assert ranges.max() < 42.5  # the diagonal of 30 m a side


def test_buildings_differ():
    assert len({plan_of(seed).walls.tobytes() for seed in range(4)}) == 4


def test_speed_and_turn_rate_are_kept_and_the_path_has_no_jump():
    time = 0.05 * np.arange(8000)
    path = drive(plan_of(0).ways, np.random.default_rng(1), time, 0.5, 0.6)
    step = np.hypot(*np.diff(path[:, :2], axis=0).T) / 0.05
    turn = np.abs(np.diff(np.unwrap(path[:, 2]))) / 0.05
    assert step.max() == pytest.approx(0.5)
    assert turn.max() == pytest.approx(0.6)
    # it goes where it looks: the chord's direction is the mean heading, but where a turn begins or ends between
    moved = step > 0.1
    chord = np.arctan2(*np.diff(path[:, :2], axis=0)[:, ::-1].T)
    middle = 0.5 * (np.unwrap(path[:, 2])[1:] + np.unwrap(path[:, 2])[:-1])
    assert np.abs(np.sin(chord - middle))[moved].max() < 0.015


@pytest.mark.parametrize("seed", range(12))
def test_every_place_inside_is_in_one_room_or_in_a_corridor(seed):
    corridors, rooms = _layout(np.random.default_rng(seed))
    every = np.array([*corridors, *rooms])
    size = every[:, 2:].max(axis=0)
    assert every[:, :2].min(axis=0).tolist() == [0.0, 0.0]
    assert ((size >= 25.0) & (size <= 30.0)).all()
    for x, y in np.random.default_rng(seed).uniform(0.0, 1.0, (400, 2)) * size:
        in_corridors = sum(r.holds(x, y) for r in corridors)
        in_rooms = sum(r.holds(x, y) for r in rooms)
        assert (in_rooms == 0) if in_corridors else (in_rooms == 1), (x, y)
    narrow = [min(r.x1 - r.x0, r.y1 - r.y0) for r in corridors]
    assert 1.8 <= min(narrow) <= max(narrow) <= 2.4

"""Rooms, and what a cone meets in them: known on paper, and a fan of fine beams as reference."""

from __future__ import annotations

import math

import numpy as np
import pytest

from wings.robot.packets import RADIUS
from wings.robot.simulated.room import GAP, cast, clearance, room


def by_beams(segments, pose, half_angle, beams=4001):
    """Nearest hit of beams all over the cone, each against every segment."""
    angle = pose[2] + np.linspace(-half_angle, half_angle, beams)[:, None]
    d = np.stack([np.cos(angle), np.sin(angle)], -1)
    a, e = segments[:, 0] - pose[:2], segments[:, 1] - segments[:, 0]
    cross = d[..., 0] * e[:, 1] - d[..., 1] * e[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        r = (a[:, 0] * e[:, 1] - a[:, 1] * e[:, 0]) / cross
        u = (a[:, 0] * d[..., 1] - a[:, 1] * d[..., 0]) / cross
    hit = (cross != 0) & (r > 0) & (u >= 0) & (u <= 1)
    return np.where(hit, r, np.inf).min()


def test_a_cone_across_a_wall_reads_the_perpendicular_and_one_aslant_the_nearer_edge():
    start = np.array([[5.0, 1.0, -math.pi / 2], [5.0, 1.0, -math.pi / 2 + math.radians(30.0)]])
    echo = cast(room(0), start)
    np.testing.assert_allclose(echo.distance, [1.0, 1.0 / math.cos(math.radians(22.5))], rtol=1e-12)
    np.testing.assert_allclose(echo.incidence, [0.0, math.radians(22.5)], atol=1e-9)
    assert echo.wall.tolist() == [0, 0]


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_wall_in_the_cone_is_that_of_a_fan_of_fine_beams(seed):
    rng = np.random.default_rng(seed)
    place = room(seed)
    poses = np.column_stack([rng.uniform(0.2, 4.8, (20, 2)), rng.uniform(-9, 9, 20)])
    for half_angle in (math.radians(7.5), 0.4, math.pi):
        expected = [by_beams(place.segments, p, half_angle) for p in poses]
        np.testing.assert_allclose(cast(place, poses, half_angle).distance, expected, rtol=2e-3)


def test_clearance_is_the_distance_to_the_nearest_wall_all_round():
    place = room(3)
    for point in np.random.default_rng(0).uniform(0.5, 4.5, (20, 2)):
        round_about = cast(place, np.array([[*point, 0.3]]), math.pi).distance[0]
        assert clearance(place, point) == pytest.approx(round_about)


@pytest.mark.parametrize("seed", range(30))
def test_every_room_is_that_of_its_seed_and_lets_the_robot_start_and_pass(seed):
    place, again = room(seed), room(seed)
    np.testing.assert_array_equal(place.segments, again.segments)
    assert clearance(place, place.start) >= 1.0 - 1e-12 > GAP > 2 * RADIUS
    assert cast(place, place.start[None], 0.0).distance[0] > 1.0


def test_rooms_differ():
    assert len({room(seed).segments.tobytes() for seed in range(30)}) == 30

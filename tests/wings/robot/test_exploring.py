"""Exploration: to the nearest border of unknown space, not through walls, until all that can be reached is seen."""

import numpy as np
import pytest
from scipy import ndimage

from eval.replay.settings import Setup
from tests.quick import slow
from wings.laser.scans.occupancy import Grid, occupancy_grid
from wings.robot.exploring import CELL, ROOM, Explorer, path_to_frontier
from wings.robot.live.session import ScanEstimating, Session
from wings.robot.packets import PERIOD, command_of
from wings.robot.simulated import Lidar, Robot, floor_of, room
from wings.robot.traffic import Unwrapper

NONE = np.empty((0, 2))


def grid(rows):
    """A grid of text, the northernmost row first: `#` wall, `.` free, blank unknown."""
    values = {"#": 2.0, ".": -2.0, " ": 0.0}
    return Grid(np.zeros(2), CELL, np.array([[values[c] for c in row] for row in rows[::-1]]))


CORRIDOR = ["#" * 40, *["#" + "." * 30 + " " * 8 + "#"] * 12, "#" * 40]  # free for 3 m, then unknown


def test_the_path_leads_to_the_border_of_the_unknown_clear_of_walls():
    path = path_to_frontier(grid(CORRIDOR), np.array([0.65, 0.65]), NONE)
    assert np.allclose(path[0], [0.65, 0.65])
    assert 2.6 < path[-1, 0] < 3.2
    assert (np.abs(path[:, 1] - 0.7) < 0.7 - ROOM).all()
    assert np.hypot(*np.diff(path, axis=0).T).max() < 1.5 * CELL


def test_there_is_none_behind_a_wall_nor_where_it_was_given_up_nor_where_all_is_known():
    closed = [row[:25] + "##" + row[27:] for row in CORRIDOR]
    known = [row.replace(" ", ".") for row in CORRIDOR]
    start = np.array([0.65, 0.65])
    assert not len(path_to_frontier(grid(closed), start, NONE))
    assert not len(path_to_frontier(grid(known), start, NONE))
    border = np.array([[x, y] for x in (2.6, 2.8, 3.0) for y in np.arange(0.1, 1.4, 0.2)])
    assert not len(path_to_frontier(grid(CORRIDOR), start, border))


def test_a_hole_in_a_wall_that_is_narrower_than_the_robot_is_no_border():
    wall = [row[:25] + ("." if k == 7 else "#") + row[26:] for k, row in enumerate(CORRIDOR)]
    holed = [row[:26] + row[26:].replace(".", " ") for row in wall]
    assert not len(path_to_frontier(grid(holed), np.array([0.65, 0.65]), NONE))


def test_a_robot_that_its_map_encloses_passes_walls_more_closely():
    narrow = [row[:12] + "##" + row[14:] if k < 6 or k > 8 else row for k, row in enumerate(CORRIDOR)]
    assert path_to_frontier(grid(narrow), np.array([0.65, 0.65]), NONE)[-1, 0] > 2.6


def explored(place, seconds):
    """Whether the robot found nothing more, the share of the reachable area that it has mapped, and the time [s]."""
    robot, unwrapper = Robot(place, np.random.default_rng(0), None, Lidar()), Unwrapper()
    scanning = ScanEstimating(Setup(), 0.01)
    session, explorer = Session((), "jcbb", Setup(), scanning=scanning), Explorer(scanning.scans, lambda: scanning.pose)
    for k in range(round(seconds / PERIOD)):
        answer = robot.answer(k * PERIOD)
        packet = unwrapper.packet(k * PERIOD, answer, joined=True, scan=robot.scan(answer))
        session.take(packet)
        robot.command(k * PERIOD, command_of(*explorer(packet)))
        if explorer.finished:
            break
    made = occupancy_grid(*scanning.scans(), resolution=CELL)
    corner = place.segments.reshape(-1, 2).min(axis=0) - 0.5
    walls = np.zeros(np.ceil((np.ptp(place.segments.reshape(-1, 2), axis=0) + 1.0) / CELL).astype(int)[::-1], bool)
    for a, b in place.segments:
        on = a + np.linspace(0.0, 1.0, 2 + int(np.hypot(*(b - a)) / 0.02))[:, None] * (b - a)
        walls[tuple(np.floor((on - corner) / CELL).astype(int)[:, ::-1].T)] = True
    label, _ = ndimage.label(ndimage.distance_transform_edt(~walls) * CELL > ROOM)
    row, column = np.floor((place.start[:2] - corner)[::-1] / CELL).astype(int)
    rows, columns = np.nonzero(label == label[row, column])
    off = corner + (np.column_stack([columns, rows]) + 0.5) * CELL - place.start[:2]
    c, s = np.cos(place.start[2]), np.sin(place.start[2])
    at = np.floor((off @ np.array([[c, -s], [s, c]]) - made.origin) / CELL).astype(int)  # in the map's own frame
    inside = ((at >= 0) & (at < made.log_odds.shape[::-1])).all(axis=1)
    known = made.log_odds[at[inside, 1], at[inside, 0]] != 0.0
    return explorer.finished, known.sum() / len(rows), k * PERIOD


@pytest.mark.parametrize(("place", "seed", "most"), [(room, 0, 240.0), slow(floor_of, 0, 5e3), slow(floor_of, 1, 5e3)])
def test_a_room_or_building_is_seen_whole_and_that_is_the_end(place, seed, most):
    finished, share, _ = explored(place(seed), most)
    assert finished
    assert share > 0.98

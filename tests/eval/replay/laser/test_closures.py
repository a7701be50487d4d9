"""Loop closures are believed in pairs, and never two of one key pose: its scan may be wrong in both alike."""

from __future__ import annotations

import numpy as np

from association.scans.points import beams_of, scan_points
from data.se2 import between, dead_reckoned
from eval.replay.laser.closures import Closure, LoopCloser
from eval.replay.laser.parameters import LaserParameters
from tests.association.scans.rooms import SCANNER, scan

KEYS = 30
STEP = np.array([0.4, 0.0, 0.25])
"""Once around in 25 key poses."""


def closer(keys):
    room = np.array([[-9, -9, 9, -9], [9, -9, 9, 9], [9, 9, -9, 9], [-9, 9, -9, -9]], float)
    ranges = scan(np.zeros(3), room)
    found = LoopCloser(LaserParameters(), SCANNER)
    for _ in range(keys):
        found.add_key(ranges, scan_points(ranges, beams_of(SCANNER, 180), 20.0), STEP, 1e-4 * np.eye(3))
    motion = np.tile(STEP, (keys, 1))
    motion[0] = 0.0
    found._poses = dead_reckoned(np.zeros(3), motion)
    return found


def closure(found, key1, key2):
    return Closure(key1, key2, between(found._poses[key1], found._poses[key2]), 1e-4 * np.eye(3), 1.0)


def believe(found, *closures):
    newest = len(found._keys) - 1
    return found._believe(list(closures), found.edges.project(newest, newest + 1))


def test_two_of_the_same_key_pose_are_not_believed_though_they_agree():
    found = closer(KEYS)
    newest = KEYS - 1
    assert believe(found, closure(found, 2, newest), closure(found, 4, newest)) == []
    assert all(c.believed < 0 for c in found.looked_at)


def test_one_of_the_next_key_pose_that_agrees_makes_both_believed():
    found = closer(KEYS)
    first = Closure(1, KEYS - 2, between(found._poses[1], found._poses[KEYS - 2]), 1e-4 * np.eye(3), 1.0)
    found.looked_at.append(first)
    second = closure(found, 2, KEYS - 1)
    assert believe(found, second) == [first, second]
    assert first.believed == second.believed == KEYS - 1


def test_one_that_does_not_agree_is_not():
    found = closer(KEYS)
    found.looked_at.append(closure(found, 1, KEYS - 2))
    wrong = closure(found, 2, KEYS - 1)
    wrong.relative = wrong.relative + np.array([1.0, 0.0, 0.0])
    assert believe(found, wrong) == []

"""Lost estimators are detected without truth; healthy ones are not, whatever their stated noise."""

from __future__ import annotations

from functools import cache

import pytest

from data.log import Log
from data.logs import open_log
from eval.referee.lost import lost
from eval.replay.run import compare
from tests.eval.referee import wrecks
from tests.quick import slow


@cache
def world(name: str) -> Log:
    return open_log(name)


def found(log: Log, task: str, association: str, estimator: str = "ekf"):
    (run,) = compare(log.inputs(labels=association == "known"), task, [estimator], association)
    inputs = log.recorded if task == "localization" else log.recorded.without_map()
    return lost(run, inputs, log.granted if association == "known" else None)


@pytest.mark.parametrize("association", ["known", "jcbb"])
@pytest.mark.parametrize("way", wrecks.LOCALIZATION, ids=lambda f: f.__name__)
def test_localization_in_a_wrong_world_is_lost(way, association):
    assert found(way(world("arena:0")), "localization", association) is not None


@pytest.mark.parametrize("association", ["known", pytest.param("jcbb", marks=pytest.mark.slow)])
@pytest.mark.parametrize("way", wrecks.SLAM, ids=lambda f: f.__name__)
def test_slam_with_wrong_observations_is_lost(way, association):
    assert found(way(world("arena:0")), "slam", association) is not None


@pytest.mark.parametrize("way", [wrecks.map_rotated, wrecks.bearings_mirrored], ids=lambda f: f.__name__)
def test_a_smoother_of_wrong_pairings_is_lost(way):
    assert found(way(world("arena:0")), "localization", "jcbb", "batch") is not None


def test_a_kidnapped_robot_is_lost_from_there_on():
    log = wrecks.kidnapped(world("arena:0"))
    for task, association in (("localization", "jcbb"), ("slam", "jcbb"), ("localization", "known")):
        assert found(log, task, association).frame == 100


@pytest.mark.parametrize("factor", [slow(0.7), slow(1.0), 1.5])
@pytest.mark.parametrize("association", ["known", "jcbb", "nn"])
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_a_healthy_run_is_not_lost_whatever_its_stated_noise(task, association, factor):
    assert found(wrecks.stated(world("arena:1"), factor), task, association) is None


@pytest.mark.parametrize("name", [
    "corridor:1:people", *(pytest.param(name, marks=pytest.mark.slow) for name in ("corridor:0", "corridor:2:people"))
])  # fmt: skip
@pytest.mark.parametrize("association", ["known", "jcbb", "jcbb-hindsight"])
def test_new_places_and_people_in_the_way_are_no_reason_to_be_lost(name, association):
    assert found(world(name), "slam", association) is None


@pytest.mark.slow
def test_a_park_with_occluded_trees_is_not_lost():
    assert found(world("victoria-park"), "slam", "known") is None

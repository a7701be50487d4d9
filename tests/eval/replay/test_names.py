"""Estimators and ways of association are listed once; whoever gives a name a meaning agrees with the list."""

from __future__ import annotations

from typing import get_type_hints

import pytest

from association.decide import HINDSIGHT, METHODS
from association.scans.constraints import SCAN
from data.errors import UsageError
from data.worlds.arena import Arena, simulate
from eval.figures.style import STYLES
from eval.replay import settings
from eval.replay.batch import LOSSES
from eval.replay.estimators import OPTIONS, Estimator, make_estimator
from eval.replay.hindsight.localizing_frontend import Stretches
from eval.replay.run import compare
from graph import factors


def test_every_filter_has_its_options():
    assert tuple(OPTIONS) == settings.FILTERS


def test_every_batch_smoother_is_a_loss_that_the_graph_knows_or_gnc():
    assert (*LOSSES, "gnc") == settings.BATCH
    assert tuple(LOSSES.values()) == factors.LOSSES


def test_every_way_of_association_is_known_a_method_hindsight_or_of_scans():
    assert set(settings.ASSOCIATIONS) == {"known", *METHODS, HINDSIGHT, SCAN}
    assert len(settings.ASSOCIATIONS) == 3 + len(METHODS)


def test_every_estimator_has_a_style():
    assert set(settings.ESTIMATORS) <= set(STYLES)


@pytest.mark.parametrize("task", settings.TASKS)
def test_every_estimator_runs_by_its_name(task):
    inputs = simulate(Arena(frames=4), 0).inputs(labels=True)
    runs = compare(inputs, task, settings.ESTIMATORS)
    assert [run.estimator for run in runs] == list(settings.ESTIMATORS)


@pytest.mark.parametrize("task", settings.TASKS)
@pytest.mark.parametrize("name", settings.STEPPING)
def test_every_stepping_estimator_has_every_verb(name, task):
    inputs = simulate(Arena(frames=2), 0).inputs()
    estimator = make_estimator(name, inputs if task == "localization" else inputs.without_map())
    verbs = [verb for verb in vars(Estimator) if not verb.startswith("_")]
    assert [verb for verb in verbs if not hasattr(estimator, verb)] == []
    assert [verb for verb in verbs if not hasattr(Stretches, verb)] == []
    assert estimator.smooths == (name in settings.INCREMENTAL)
    assert (estimator.size > 0) == (name in settings.FILTERS)
    assert not len(estimator.parked)
    assert estimator.fixed_linearization == (name == "ekf-fej")
    assert get_type_hints(type(estimator).update)["innovations"] is bool


@pytest.mark.parametrize("task", settings.TASKS)
@pytest.mark.parametrize("name", settings.STEPPING)
def test_what_an_estimator_cannot_do_it_refuses(name, task):
    inputs = simulate(Arena(frames=2), 0).inputs()
    estimator = make_estimator(name, inputs if task == "localization" else inputs.without_map())
    slam_filter = task == "slam" and name in settings.FILTERS
    pose, covariance = estimator.estimate()
    if slam_filter or name in settings.INCREMENTAL:
        with pytest.raises(ValueError, match="pose"):
            estimator.reset(pose, covariance)
    for verb in (estimator.park, estimator.restore):
        with pytest.raises(ValueError, match=r"park|invariant"):
            verb(inputs.map.id[:1])
    if task == "localization":
        for ask in (lambda: estimator.remove(inputs.map.id[:1]), lambda: estimator.merge(*inputs.map.id[:2, None])):
            with pytest.raises(ValueError, match="map is given"):
                ask()


def test_an_unknown_name_is_told_those_that_work_step_by_step():
    with pytest.raises(UsageError, match=", ".join(settings.STEPPING[:-1])):
        make_estimator("batch", simulate(Arena(frames=2), 0).inputs())

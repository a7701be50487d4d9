"""Estimators and ways of association are listed once; whoever gives a name a meaning agrees with the list."""

from __future__ import annotations

from typing import get_type_hints

import pytest

from association.decide import PLAIN, SEARCHES
from association.names import SCAN
from data.errors import UsageError
from data.worlds.arena import Arena, simulate
from eval.replay import settings
from eval.replay.estimators import Estimator, capabilities, make_estimator
from eval.replay.hindsight.localizing_frontend import Stretches
from eval.replay.run import compare
from eval.replay.settings import HINDSIGHT
from graph import factors


def test_every_batch_smoother_is_a_loss_that_the_graph_knows_or_gnc():
    assert [settings.ESTIMATOR_TABLE[name].options["loss"] for name in settings.BATCH] == [*factors.LOSSES, "truncated"]


def test_every_way_of_association_is_known_a_method_hindsight_or_of_scans():
    assert {*settings.ASSOCIATIONS} - {*PLAIN, *SEARCHES} == {"known", HINDSIGHT, SCAN}


@pytest.mark.parametrize("task", settings.TASKS)
def test_every_estimator_runs_by_its_name(task):
    inputs = simulate(Arena(frames=4), 0).inputs(labels=True)
    runs = compare(inputs, task, settings.ESTIMATORS)
    assert [run.estimator for run in runs] == list(settings.ESTIMATORS)


@pytest.mark.parametrize("task", settings.TASKS)
@pytest.mark.parametrize("name", settings.STEPPING)
def test_every_stepping_estimator_has_the_core_and_capabilities_that_are_its_own(name, task):
    inputs = simulate(Arena(frames=2), 0).inputs()
    estimator = make_estimator(name, inputs if task == "localization" else inputs.without_map())
    verbs = [verb for verb in vars(Estimator) if not verb.startswith("_")]
    assert [verb for verb in verbs if not hasattr(estimator, verb)] == []
    assert [verb for verb in verbs if not hasattr(Stretches, verb)] == []
    smooths = name in settings.INCREMENTAL
    assert estimator.smooths == smooths
    assert get_type_hints(type(estimator).update)["innovations"] is bool
    can = capabilities(estimator)
    assert all(found in (None, estimator) for found in can)
    expected = {
        "timed": name == "fixed-lag",
        "stateful": not smooths,
        "calibrating": True,
        "parkable": not smooths and task == "slam",
        "removable": smooths or task == "slam",
        "revisable": smooths or task == "slam",
        "amendable": smooths,
        "inflatable": True,
        "resettable": not smooths and task == "localization",
        "looking": True,
        "delaying": smooths or task == "slam",
        "fixable": True,
        "closable": True,
    }
    assert {field: found is not None for field, found in can._asdict().items()} == expected


def test_an_unknown_name_is_told_those_that_work_step_by_step():
    with pytest.raises(UsageError, match=", ".join(settings.STEPPING[:-1])):
        make_estimator("batch", simulate(Arena(frames=2), 0).inputs())

"""Variants of a laser log with sparser graphs, as further rows of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from association.names import SCAN
from eval.plan.experiment import Experiment, Work
from eval.plan.flags.table import Options


def sparser(options: Options, experiments: Sequence[Experiment]) -> list[Experiment]:
    """Variants of laser logs with key poses further apart."""
    return [variant for experiment in experiments for variant in _sparser(experiment)]


def _sparser(experiment: Experiment) -> list[Experiment]:
    name, setup = experiment.log.name, experiment.setup
    work = tuple(Work(SCAN, ("isam2",)) for w in experiment.work if w.association == SCAN)
    if not work:
        return []
    return [
        Experiment(
            replace(experiment.log, name=f"{name}:keyframe-distance={d:g}"),
            experiment.task,
            work,
            replace(setup, keyframe_distance=d),
            name,
            f"the same log with key poses {d:g} m apart (`--keyframe-distance`)",
        )
        for d in (2.0 * setup.keyframe_distance, 4.0 * setup.keyframe_distance)
    ]

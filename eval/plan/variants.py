"""Variants of an experiment, as further rows of its log: sparser graphs, map maintenance."""

from __future__ import annotations

from dataclasses import replace

from eval.plan.experiment import Experiment, Work


def maintained(experiment: Experiment, work: tuple[Work, ...]) -> Experiment:
    """The variant with map maintenance."""
    name = experiment.log.name
    deciding = tuple(w for w in work if w.association != "known")
    log, setup = replace(experiment.log, name=f"{name}:maintain"), replace(experiment.setup, maintain=True)
    return Experiment(log, experiment.task, deciding, setup, name, "the same log with map maintenance (`--maintain`)")

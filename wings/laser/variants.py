"""Variants of a laser log with sparser graphs, as further rows of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from association.names import SCAN
from eval.plan.experiment import Experiment, Work
from eval.plan.flags.table import Options

SPARSE = 0.2
"""Least information of a key pose in a variant: removes three of five key poses of the Intel log, for 2 % of error."""


def sparser(options: Options, experiments: Sequence[Experiment]) -> list[Experiment]:
    """Variants of laser logs with fewer key poses: without those of little information, and further apart."""
    return [variant for experiment in experiments for variant in _sparser(experiment)]


def _sparser(experiment: Experiment) -> list[Experiment]:
    name, setup = experiment.log.name, experiment.setup
    work = tuple(Work(SCAN, ("isam2",)) for w in experiment.work if w.association == SCAN)
    if not work:
        return []
    settings = [
        (f"keyframe-distance={d:g}", replace(setup, keyframe_distance=d), f"with key poses {d:g} m apart")
        for d in (2.0 * setup.keyframe_distance, 4.0 * setup.keyframe_distance)
    ]
    if setup.least_information is None:
        about = f"without key poses whose scans have less than {SPARSE:g} of what is known of the places they see"
        settings.insert(0, (f"least-information={SPARSE:g}", replace(setup, least_information=SPARSE), about))
    return [
        Experiment(
            replace(experiment.log, name=f"{name}:{changed}"),
            experiment.task,
            work,
            other,
            name,
            f"the same log {about} (`--{changed.split('=')[0]}`)",
        )
        for changed, other, about in settings
    ]

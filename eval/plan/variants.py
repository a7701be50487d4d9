"""Variants of an experiment, as further rows of its log: sparser graphs, other noise, map maintenance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from association.scans.constraints import SCAN
from data.log import Log
from eval.plan.experiment import Experiment, Work

SPARSE = 0.2
"""Least information of a key pose in a variant: removes three of five key poses of the Intel log, for 2 % of error."""


def sparser(experiment: Experiment) -> list[Experiment]:
    """Variants of a laser log with fewer key poses: without those of little information, and further apart."""
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


def has_depth_noise(log: Log) -> bool:
    """Whether a camera log has detected pictures whose corners have a known depth noise."""
    found = None if log.evidence is None else log.evidence.found
    return found is not None and len(found.frame) > 0 and math.isfinite(found.depth_noise)


def with_depth_noise(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Variants with the same detections, whose covariances follow from their depth noise."""
    from data.visual.observations import with_noise

    about = "the same detections, each corner's covariance from the noise of its depth (`--corner-noise depth`)"
    names = dict.fromkeys(e.log.name for e in experiments)
    logs = {
        n: with_noise(next(e.log for e in experiments if e.log.name == n), "depth", f"{n}:depth-noise") for n in names
    }
    return [
        replace(
            e,
            log=logs[e.log.name],
            variant_of=e.log.name,
            about=about,
            work=tuple(Work(w.association, tuple(n for n in w.estimators if n != "dead-reckoning")) for w in e.work),
        )
        for e in experiments
    ]


def maintained(experiment: Experiment, work: tuple[Work, ...]) -> Experiment:
    """The variant with map maintenance."""
    name = experiment.log.name
    deciding = tuple(w for w in work if w.association != "known")
    log, setup = replace(experiment.log, name=f"{name}:maintain"), replace(experiment.setup, maintain=True)
    return Experiment(log, experiment.task, deciding, setup, name, "the same log with map maintenance (`--maintain`)")

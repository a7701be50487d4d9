"""Variants of logs with images: the same detections, with the noise of their depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from eval.plan.experiment import Experiment, Work
from eval.plan.flags.options import Options


def depth_noise_variants(options: Options, experiments: Sequence[Experiment]) -> list[Experiment]:
    """Variants whose covariances follow from the depth noise of their detections, unless all logs are read so."""
    with_images = [e for e in experiments if e.log.evidence is not None and len(e.log.evidence.found.frame)]
    seen = [e for e in with_images if e.log.evidence and math.isfinite(e.log.evidence.found.depth_noise)]
    if not seen or options.opening.corner_noise != "lab":
        return []
    from wings.camera.observations import with_noise

    about = "the same detections, each corner's covariance from the noise of its depth (`--corner-noise depth`)"
    names = dict.fromkeys(e.log.name for e in seen)
    logs = {n: with_noise(next(e.log for e in seen if e.log.name == n), "depth", f"{n}:depth-noise") for n in names}
    return [
        replace(
            e,
            log=logs[e.log.name],
            variant_of=e.log.name,
            about=about,
            work=tuple(Work(w.association, tuple(n for n in w.estimators if n != "dead-reckoning")) for w in e.work),
        )
        for e in seen
    ]

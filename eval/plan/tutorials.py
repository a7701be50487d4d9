"""The classic UTIAS tutorials' treatment of a recording, as one more row beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from data.errors import UsageError
from data.inputs import Prior
from data.log import Log
from data.motion.velocity import VelocityModel, VelocityNoise
from data.mrclam.calibration import Calibration
from data.mrclam.frames import Grid
from data.mrclam.load import load_mrclam
from data.result import Run
from ekf.filter import FilterOptions
from eval.plan.flags.variant import Variant
from eval.plan.tutorials.programs import GainFromBefore, RunningMinimum
from eval.referee.score import Trial
from eval.replay.frontend import FrontEnd
from eval.replay.plausible import with_doubt
from eval.replay.run import driven
from eval.replay.settings import Setup

ABOUT = "the same recording with a classic tutorial's numbers"


def is_tutorial(trial: Trial) -> bool:
    """Whether a trial is a variant of another one's recording."""
    return trial.about == ABOUT


def variant_log(log: Log, variant: Variant) -> Log:
    """The recording behind a log, converted with the variant's numbers; raises UsageError if it is not from MRCLAM."""
    s = log.source
    if s.get("kind") != "mrclam":
        raise UsageError(
            f"{variant.name}: log {log.name!r} does not come from a UTIAS MRCLAM recording; "
            "make one with python -m data.convert mrclam"
        )
    source = Path(str(s["path"]))
    if not source.exists():
        raise UsageError(
            f"{variant.name}: the recording behind log {log.name!r} is not at {source} any more; convert again"
        )
    window = {k: s.get(k) for k in ("start", "stop")}
    landmarks = s.get("landmarks")
    changed = load_mrclam(
        source,
        int(str(s["robot"])),
        start=_later(_seconds(window["start"]), variant.start),
        stop=_seconds(window["stop"]),
        landmarks=None if landmarks is None else Path(str(landmarks)),
        exclude_truth=_pairs(s.get("exclude_truth")),
        grid=Grid(variant.grid, variant.own_odometry, variant.gapless, variant.skip_led_by),
        calibration=Calibration(),
        motion=VelocityModel(VelocityNoise(variant.noise, alphas=variant.alphas), variant.model),
        sigma=variant.sigma,
    )
    shape = np.ones((3, 3)) if variant.filled_prior else np.eye(3)
    prior = Prior(changed.recorded.prior.mean, variant.prior_variance * shape)
    return replace(
        changed,
        name=f"{log.name}:{variant.name}",
        recorded=replace(changed.recorded, prior=prior),
        source={**changed.source, **_original(s, variant)},
        notes=(*changed.notes, *variant.notes),
    )


def tutorial_run(log: Log, variant: Variant) -> Run:
    """The EKF with the variant's update and its way of association."""
    known = variant.association == "known"
    inputs = log.inputs(labels=known)
    if variant.task == "slam":
        inputs = inputs.without_map()
    options = FilterOptions(
        each=variant.each, new_variance=variant.new_variance, new_variance_per_square=variant.new_variance_per_square
    )
    with threadpool_limits(1):  # as in `eval.replay.run.compare`
        setup = Setup(gate=variant.gate, new_gate=variant.new_gate, gate_known=None)
        kind = RunningMinimum if variant.running_minimum else FrontEnd
        front = kind("ekf", variant.association, inputs, setup, options)
        if variant.gain_before_prediction:
            assert inputs.map is not None
            front.estimator = GainFromBefore(inputs.prior, inputs.sensor, inputs.map, options)
        run = driven("ekf", front, inputs, variant.task, each=variant.each)
    return replace(with_doubt(run, inputs), notes=(*run.notes, *variant.notes))


def _original(source: Mapping[str, object], variant: Variant) -> dict[str, object]:
    """The original program's numbers, if the log is the whole recording that it was run on."""
    whole = source.get("start") is None and source.get("stop") is None
    here = f"{source.get('dataset')}, robot {source.get('robot')}"
    if variant.original is None or not whole or here != variant.original_log:
        return {}
    return {"original": list(variant.original)}


def original_of(trial: Trial) -> tuple[float, float] | None:
    """Sum of squared position errors [m^2] and RMSE [m] of the original program on a tutorial's recording, if known."""
    given = trial.log.source.get("original")
    return (float(given[0]), float(given[1])) if isinstance(given, list) else None


def _later(asked: float | None, variant: float | None) -> float | None:
    """The later of two beginnings, each of which may be left open."""
    return max((s for s in (asked, variant) if s is not None), default=None)


def _seconds(value: object) -> float | None:
    return None if value is None else float(str(value))


def _pairs(value: object) -> list[tuple[float, float]]:
    if not isinstance(value, (list, tuple)):
        return []
    return [(float(v[0]), float(v[1])) for v in value]

"""What the page shows of a log and its runs, as one chunk (see `eval.player.pack`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from association.expectation import gate_threshold
from association.scans.laser_run import LaserRun
from data.log import Log
from data.se2 import wrap_angle
from eval.figures.style import series, style_of
from eval.player.camera import add_camera
from eval.player.laser import add_loops, dashes
from eval.player.of_run import add_run
from eval.player.pack import Pack
from eval.player.watch import Watched, quantum_of, spread
from eval.referee.paths.given import log_of
from eval.referee.score import Trial
from eval.replay.settings import Setup

ANGLE = 1.0e-4
"""rad."""
FINER = 0.1
"""Poses and observations, of which there are few numbers, are kept to a tenth of the landmarks' quantum."""
MOST_TIME = 2**31 - 1


def scene(trials: Sequence[Trial], setup: Setup) -> dict[str, Any]:
    """The chunk of a log: its own arrays, then those of every run of the trials, which share its frames.

    `setup`: whose gates were used.
    """
    log = trials[0].log
    pack = Pack(0, len(log.recorded))
    quantum = quantum_of(log.recorded)
    _add_log(pack, log, quantum)
    camera = add_camera(pack, log)
    runs, left_out = list[dict[str, Any]](), list[str]()
    for trial in trials:
        styles = {(s.run.estimator, s.run.association): s.line for s in series([r for t in trials for r in t.runs])}
        for run in trial.runs:
            name = " ".join(part for part in (style_of(run.estimator).label, _way(run.association)) if part)
            if log_of(run, trial.log) is not trial.log:
                left_out.append(f"{name}: its poses have other stamps than the log's frames.")
                continue
            if run.failure is not None and run.failure.frame == 0:
                left_out.append(f"{name}: {run.failure.text}.")
                continue
            key = f"r{len(runs)}."
            entry = add_run(pack, key, run, trial, quantum, FINER)
            if isinstance(run, LaserRun):
                entry["loops"] = add_loops(pack, key, run, trial, quantum * FINER)
            line = styles[run.estimator, run.association]
            entry |= {
                "key": key, "name": name, "colour": style_of(run.estimator).colour, "task": trial.task,
                "dash": dashes(line), "beside": _beside(trial, log),
            }  # fmt: skip
            runs.append(entry)
    watched = [r.watched for t in trials for r in t.runs if isinstance(r.watched, Watched)]
    return pack.done({
        "name": log.name, "indexed": log.recorded.time_is_index, "quantum": quantum, "runs": runs,
        "left_out": left_out, "methods": list(watched[0].methods) if watched else [],
        "gate": _threshold(setup.gate), "new_gate": _threshold(setup.new_gate),
        "gates": [_percent(setup.gate), _percent(setup.new_gate)],
        "band": [gate_threshold(p, 3) for p in (0.025, 0.975)],
        "labels": log.label is not None or log.labels_are_sensed, "laser": log.recorded.scans is not None,
        "truth": bool(log.truth.known_poses), "camera": camera, "walls": not log.recorded.sensor.sees_points,
    })  # fmt: skip


def _threshold(probability: float | None) -> float | None:
    return None if probability is None else gate_threshold(probability)


def _percent(probability: float | None) -> str:
    return "none" if probability is None else f"{100.0 * probability:.10g} %"


def _way(association: str) -> str:
    return "" if association == "none" else association


def _beside(trial: Trial, log: Log) -> str:
    """What is different about a trial beside the log's own."""
    return trial.log.name.removeprefix(log.name).strip(":")


def _add_log(pack: Pack, log: Log, quantum: float) -> None:
    r, t = log.recorded, log.truth
    fine = quantum * FINER
    span = float(np.abs(r.time).max(initial=0.0))
    pack.add("time", r.time - r.time[0] if span > MOST_TIME * 1.0e-4 else r.time, 1.0e-4)
    pack.add("count", np.diff(r.start))
    points, covariance = r.sensor.body_points(r.observations.z, r.observations.R)
    pack.add("point", points, fine)
    pack.add_log("point_sigma", spread(covariance)[:, :2])
    pack.add("point_rho", spread(covariance)[:, 2], 0.001)
    if t.pose is not None:
        pack.add("truth", t.pose[:, :2], fine)
        pack.add("truth_theta", wrap_angle(t.pose[:, 2]), ANGLE)
    if t.landmark_of is not None:
        pack.add("true_id", t.landmark_of)
    granted = log.granted
    if log.label is not None and granted is not None:
        pack.add("label", granted)
    for name, known in (("true", t.landmarks), ("map", r.map)):
        if known is not None:
            pack.add(f"{name}_number", known.id)
            pack.add(f"{name}_xy", known.xy, fine)

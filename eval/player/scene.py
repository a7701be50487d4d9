"""What the page shows of a log and its runs, as one chunk (see `eval.player.pack`).

The camera's images in a log's chunk, and the corners found in them.

Key poses and loop closures of a laser run in a chunk.

One run in a chunk: its paths, consistency, decisions, and what an observer of it wrote down.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from association.expectation import gate_threshold
from association.scans.constraints import LaserRun
from data.log import Log
from data.result import Run
from data.se2 import Array, wrap_angle
from eval.figures.laser import FATES, fates
from eval.figures.style import Line, series, style_of
from eval.player.pack import FURTHEST, Pack
from eval.player.watch import Watched, quantum_of, spread
from eval.referee.errors import along
from eval.referee.given_runs import log_of
from eval.referee.laser import right_closures
from eval.referee.score import Trial, confusion_of
from eval.replay.settings import Setup

FINE = 0.25
"""px of the recorded image."""


def add_camera(pack: Pack, log: Log) -> dict[str, Any] | None:
    """Detections as arrays, one row each: frame, picture and corners (u, v) px; what the header says, None: no images.

    Images are small ones of some or all frames; `width` is that of the recorded image, to which the corners belong.
    """
    if log.evidence is None or not log.evidence.found.small:
        return None
    found, frames = log.evidence.found, len(log.recorded)
    kept = found.frame < frames
    pack.add("camera_frame", found.frame[kept])
    pack.add("camera_picture", found.picture[kept])
    pack.add("camera_corners", found.pixels[kept].reshape(int(np.sum(kept)), -1), FINE)
    whole = cv2.imdecode(np.frombuffer(found.tiles[0][1], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert whole is not None
    images = [(k, base64.b64encode(image).decode()) for k, image in found.small if k < frames]
    return {
        "width": whole.shape[1], "frames": [k for k, _ in images], "images": [image for _, image in images],
    }  # fmt: skip


def add_loops(pack: Pack, key: str, run: LaserRun, trial: Trial, step: float) -> list[dict[str, Any]]:
    """Arrays named `key` and a name; colour, line and name of each fate a loop closure can have."""
    if run.loops is None or run.chain is None or run.key_pose is None or not len(run.loops):
        return []
    truth = trial.log.truth.pose
    false = None if truth is None else ~right_closures(run.loops, truth[run.chain.frame])
    weight = np.ones(len(run.loops)) if run.weight is None else run.weight
    names = list(FATES)
    fate = fates(run.loops, weight, false)
    pack.add(f"{key}key_frame", run.chain.frame)
    pack.add(f"{key}key_xy", run.key_pose[:, :2], step)
    pack.add(f"{key}loop_keys", np.column_stack([run.loops.key1, run.loops.key2]))
    pack.add(f"{key}loop_fate", np.array([names.index(f) for f in fate]))
    return [
        {"name": name, "colour": colour, "dash": dashes(line)}
        for name, (colour, line, _) in FATES.items()
        if false is not None or name != names[-1]
    ]


def dashes(line: Line) -> list[float]:
    """Lengths of dash and gap in turn; none of a solid line."""
    return [] if line == "-" else list(line[1])


STEP_ANGLE, RHO = 1.0e-4, 1.0e-3


def add_run(pack: Pack, key: str, run: Run, trial: Trial, quantum: float, finer: float) -> dict[str, Any]:
    """Arrays named `key` and a name; what the header says of the run."""
    for phase in run.phases:
        trajectory = run.trajectory(phase)
        pack.add(f"{key}{phase}_xy", trajectory.pose[:, :2], quantum * finer)
        pack.add(f"{key}{phase}_theta", wrap_angle(trajectory.pose[:, 2]), STEP_ANGLE)
        sigma = np.sqrt(np.maximum(np.diagonal(trajectory.covariance, axis1=1, axis2=2), 0.0))
        pack.add_log(f"{key}{phase}_sigma", sigma)
        pack.add(f"{key}{phase}_rho", _unknown_with(spread(trajectory.covariance)[:, 2], sigma), RHO)
        path = along(run, phase, trial.log)
        if path is not None:
            pack.add_log(f"{key}{phase}_nees", path.nees["pose"])
    if run.innovations is not None:
        dof = run.innovations.dof
        per_dof = np.divide(run.innovations.nis, dof, out=np.full(len(dof), np.nan), where=dof > 0)
        pack.add_log(f"{key}nis", per_dof)
    scored = _add_decisions(pack, key, run, trial)
    if run.map is not None:
        usable = np.isfinite(run.map.xy).all(axis=1)
        pack.add(f"{key}map_number", run.map.number[usable])
        pack.add(f"{key}map_first", run.map.first_frame[usable])
        pack.add(f"{key}map_xy", run.map.xy[usable], 0.1 * quantum)
        _add_spread(pack, f"{key}map", spread(run.map.covariance[usable]))
    watched = run.watched if isinstance(run.watched, Watched) else None
    if watched is not None:
        _add_watched(pack, key, watched, run)
    return {
        "estimator": run.estimator, "association": run.association, "phases": list(run.phases), "status": run.status,
        "why": "" if run.flaw is None else run.flaw.text, "decides": f"{key}decision" in pack.names, "scored": scored,
        "history": watched is not None and len(watched.change_frame) > 0,
        "every": 0 if watched is None else watched.every, "certain": watched is not None and watched.certain,
        "candidates": watched is not None and len(watched.pair_row) > 0,
        "nis": run.innovations is not None, "nis_expected": run.gated[0],
    }  # fmt: skip


def _unknown_with(values: Array, sigma: Array) -> Array:
    return np.where(np.isfinite(sigma).all(axis=1), values, np.nan)


def _add_decisions(pack: Pack, key: str, run: Run, trial: Trial) -> bool:
    if run.association == "none" or isinstance(run, LaserRun) or not len(run.decisions):
        return False
    pack.add(f"{key}decision", run.decisions)
    pack.add(f"{key}final_decision", run.final_decisions)
    pack.add(f"{key}created", run.created)
    for phase, name in (("online", ""), ("final", "final_")):
        found = confusion_of(run, trial.log, phase)
        if found is None:
            return False
        pack.add(f"{key}{name}outcome", found.outcome)
        pack.add(f"{key}{name}right", found.ground_truth)
    return True


def _add_watched(pack: Pack, key: str, w: Watched, run: Run) -> None:
    """Changes of landmarks are differences from the same landmark's last one, which the page adds up.

    A landmark further off than integers reach (a thousand kilometres) is shown at that distance.
    """
    if len(w.change_frame):
        pack.add(f"{key}change_frame", w.change_frame)
        pack.add(f"{key}change_number", w.change_number)
        pack.add(f"{key}change_there", w.change_there)
        values = np.column_stack([
            np.round(np.clip(w.change_xy / w.quantum, -FURTHEST, FURTHEST)),
            np.round(np.log(np.maximum(w.change_sigma, 1.0e-9)) / COARSE),
            np.round(w.change_rho / ROUGH),
        ])  # fmt: skip
        pack.add_steps(f"{key}change", own_steps(w.change_number, values))
    pack.add(f"{key}seen_frame", w.seen_frame)
    pack.add(f"{key}seen_number", w.seen_number)
    pack.add(f"{key}seen_xy", w.seen_xy, w.quantum)
    _add_spread(pack, f"{key}seen", np.column_stack([w.seen_sigma, w.seen_rho]))
    pack.add(f"{key}pair_row", w.pair_row)
    pack.add(f"{key}pair_number", w.pair_number)
    pack.add_log(f"{key}pair_d2", w.pair_d2, 2.0e-4)
    pack.add_steps(f"{key}said", w.said - run.decisions[:, None])


COARSE, ROUGH = 0.01, 0.02
"""Landmarks' sigmas are kept to half a percent of themselves, their correlations to a hundredth."""


def own_steps(number: Any, values: Array) -> Array:
    """Rows (C, k) less the last row before them with the same number (C,); the first of each as it is."""
    order = np.argsort(number, kind="stable")
    sorted_rows, same = values[order], np.diff(number[order], prepend=-1) == 0
    steps = sorted_rows.copy()
    steps[1:] -= np.where(same[1:, None], sorted_rows[:-1], 0.0)
    own = np.empty_like(steps)
    own[order] = steps
    return own


def _add_spread(pack: Pack, name: str, values: Array) -> None:
    pack.add_log(f"{name}_sigma", values[:, :2])
    pack.add(f"{name}_rho", values[:, 2], RHO)


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
        "truth": bool(log.truth.known_poses), "camera": camera, "walls": _seen_from(log),
    })  # fmt: skip


def _seen_from(log: Log) -> float:
    """How far away [m] a wall was read, where landmarks are walls; 0 where they are points."""
    return 0.0 if log.recorded.sensor.sees_points else float(log.recorded.observations.z[:, 0].max(initial=1.0))


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

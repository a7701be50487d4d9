"""A log and its runs for the page, as one chunk (see `eval.player.pack`); those of a live page have the same arrays."""

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from PIL import Image

from association.expectation import gate_threshold
from data.inputs import IntArray
from data.log import Log
from data.pose_measurements import FixKind
from data.result import Run
from data.se2 import Array, wrap_angle
from data.wing import of_all
from eval.figures.style import Line, series, style_of
from eval.player.pack import ANGLE, FURTHEST, RHO, TIME, Pack
from eval.player.watch import Watched, quantum_of, spread
from eval.referee.errors import along
from eval.referee.given.runs import log_of
from eval.referee.score import Trial, confusion_of
from eval.replay.settings import Setup

PIXEL = 0.25  # resolution of corners in the recorded image
FINER = 0.1  # resolution of poses and observations over the landmarks' quantum
COARSE, ROUGH = 0.01, 0.02  # resolution of the logarithm of landmarks' sigmas, and of their correlations
MOST_TIME = 2**31 - 1


@dataclass(frozen=True)
class RunHead:
    """Header of a run, whose arrays have names that begin with `key`."""

    key: str
    name: str  # in lists
    estimator: str
    association: str
    colour: str
    dash: Sequence[float]  # lengths of dash and gap, empty for a solid line
    status: str
    why: str  # reason for a status that is not `ok`
    covariances: bool  # whether earlier landmarks have them
    task: str = "slam"
    phases: Sequence[str] = ("online",)
    variant: str = ""  # difference of its log
    decides: bool = True  # whether it has arrays about decisions, ...
    scored: bool = False  # ... outcomes, ...
    history: bool = True  # ... earlier landmarks, ...
    every: int = 1  # (after every so many frames)
    candidates: bool = False  # ... candidates, ...
    nis: bool = True  # ... and NIS
    nis_expected: float = 1.0  # per degree of freedom
    loops: Sequence[Mapping[str, Any]] = ()  # colour, line and name of each state of a loop closure


@dataclass(frozen=True)
class Head:
    """Header of a log."""

    name: str
    quantum: float  # m, of landmarks
    runs: Sequence[RunHead]
    walls: float  # m, largest range of a wall, 0 where landmarks are points
    indexed: bool = False  # time is the number of a frame
    left_out: Sequence[str] = ()  # runs that are not shown, with the reason
    methods: Sequence[str] = ()  # methods with decisions about each observation
    gate: float | None = None  # squared distance, None: no gate
    new_gate: float | None = None
    gates: tuple[str, str] = ("none", "none")  # both in percent
    band: tuple[float, float] = (0.0, 0.0)  # of the NEES, 95 %
    labels: bool = False
    laser: bool = False
    truth: bool = False
    camera: Mapping[str, Any] | None = None
    team: Mapping[str, Any] | None = None  # key, name and colour of each robot, if there are more than one


def add_camera(pack: Pack, log: Log) -> dict[str, Any] | None:
    """Add detections, one row each: frame, picture and corners (u, v) px; returns the header, None without images.
    Images are small ones of some or all frames; `width` is that of the recorded image, to which the corners belong.
    """
    if log.evidence is None or not log.evidence.found.small:
        return None
    found, frames = log.evidence.found, len(log.recorded)
    kept = found.frame < frames
    pack.add("camera_frame", found.frame[kept])
    pack.add("camera_picture", found.picture[kept])
    pack.add("camera_corners", found.pixels[kept].reshape(int(np.sum(kept)), -1), PIXEL)
    width = Image.open(io.BytesIO(found.tiles[0][1])).width
    images = {k: base64.b64encode(image).decode() for k, image in found.small if k < frames}
    return {"width": width, "frames": list(images), "images": list(images.values())}


def dashes(line: Line) -> list[float]:
    """Lengths of dash and gap, empty for a solid line."""
    return [] if line == "-" else list(line[1])


def add_path(pack: Pack, name: str, pose: Array, sigma: Array, rho: Array, step: float) -> None:
    """Poses (N, 3) with their sigmas (N, 3) and the correlation (N,) of x and y, unknown where a sigma is."""
    pack.add(f"{name}_xy", pose[:, :2], step)
    pack.add(f"{name}_theta", wrap_angle(pose[:, 2]), ANGLE)
    pack.add_log(f"{name}_sigma", sigma)
    pack.add(f"{name}_rho", np.where(np.isfinite(sigma).all(axis=1), rho, np.nan), RHO)


def add_points(pack: Pack, name: str, xy: Array, shape: Array, step: float) -> None:
    """Points (n, 2) with the `spread` (n, 3) of their covariances."""
    pack.add(name, xy, step)
    pack.add_log(f"{name.removesuffix('_xy')}_sigma", shape[:, :2])
    pack.add(f"{name.removesuffix('_xy')}_rho", shape[:, 2], RHO)


def add_changes(
    pack: Pack, key: str, frame: IntArray, number: IntArray, there: IntArray, xy: Array, shape: Array, quantum: float
) -> None:
    """Changes of landmarks (C,) as differences from their last one in the chunk: xy (C, 2) exact to half a quantum,
    shape (C, 3) as of `spread`; beyond the range of integers they are drawn at its end.
    """
    pack.add(f"{key}change_frame", frame)
    pack.add(f"{key}change_number", number)
    pack.add(f"{key}change_there", there)
    place = np.round(np.clip(xy / quantum, -FURTHEST, FURTHEST))
    sigma = np.round(np.log(np.maximum(shape[:, :2], 1.0e-9)) / COARSE)
    pack.add_steps(f"{key}change", own_steps(number, np.column_stack([place, sigma, np.round(shape[:, 2] / ROUGH)])))


def add_run(pack: Pack, key: str, run: Run, trial: Trial, quantum: float) -> None:
    """Add the arrays of a run, with names that begin with `key`."""
    for phase in run.phases:
        pose, covariance = run.trajectory(phase).pose, run.trajectory(phase).covariance
        sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        add_path(pack, f"{key}{phase}", pose, sigma, spread(covariance)[:, 2], quantum * FINER)
        path = along(run, phase, trial.log)
        if path is not None:
            pack.add_log(f"{key}{phase}_nees", path.nees["pose"])
    if run.innovations is not None:
        dof = run.innovations.dof
        pack.add_log(f"{key}nis", np.divide(run.innovations.nis, dof, out=np.full(len(dof), np.nan), where=dof > 0))
    _add_decisions(pack, key, run, trial)
    if run.map is not None:
        usable = np.isfinite(run.map.xy).all(axis=1)
        pack.add(f"{key}map_number", run.map.number[usable])
        pack.add(f"{key}map_first", run.map.first_frame[usable])
        add_points(pack, f"{key}map_xy", run.map.xy[usable], spread(run.map.covariance[usable]), 0.1 * quantum)
    if isinstance(run.watched, Watched):
        _add_watched(pack, key, run.watched, run)


def _add_decisions(pack: Pack, key: str, run: Run, trial: Trial) -> None:
    if not run.decides or not len(run.decisions):
        return
    pack.add(f"{key}decision", run.decisions)
    pack.add(f"{key}final_decision", run.final_decisions)
    pack.add(f"{key}created", run.created)
    for phase, name in (("online", ""), ("final", "final_")):
        if (found := confusion_of(run, trial.log, phase)) is not None:
            pack.add(f"{key}{name}outcome", found.outcome)
            pack.add(f"{key}{name}right", found.ground_truth)


def _add_watched(pack: Pack, key: str, w: Watched, run: Run) -> None:
    if len(w.changes):
        frame, number, there = w.changes[:, :3].astype(np.int64).T
        add_changes(pack, key, frame, number, there, w.changes[:, 3:5], w.changes[:, 5:], w.quantum)
    pack.add(f"{key}seen_frame", w.seen[:, 0])
    pack.add(f"{key}seen_number", w.seen[:, 1])
    add_points(pack, f"{key}seen_xy", w.seen[:, 2:4], w.seen[:, 4:], w.quantum)
    pack.add(f"{key}pair_row", w.pairs[:, 0])
    pack.add(f"{key}pair_number", w.pairs[:, 1])
    pack.add_log(f"{key}pair_d2", w.pairs[:, 2], 2.0e-4)
    pack.add_steps(f"{key}method_decision", w.method_decisions - run.decisions[:, None])


def own_steps(number: Any, values: Array) -> Array:
    """Rows (C, k) minus the last row before them with the same number (C,); the first of each unchanged."""
    order = np.argsort(number, kind="stable")
    sorted_rows, same = values[order], np.diff(number[order], prepend=-1) == 0
    steps = sorted_rows.copy()
    steps[1:] -= np.where(same[1:, None], sorted_rows[:-1], 0.0)
    own = np.empty_like(steps)
    own[order] = steps
    return own


def scene(trials: Sequence[Trial], setup: Setup, company: Any = None) -> dict[str, Any]:
    """The chunk of a log: its own arrays, then those of every run of the trials, which share its frames. `setup`: whose
    gates were used; `company`: other robots (`data.wing.Wing.company`).
    """
    log = trials[0].log
    pack = Pack(0, len(log.recorded))
    quantum = quantum_of(log.recorded)
    _add_log(pack, log, quantum)
    camera = add_camera(pack, log)
    runs, left_out, shown = list[RunHead](), list[str](), list[tuple[str, Trial, Run]]()
    for trial in trials:
        styles = {(s.run.estimator, s.run.association): s.line for s in series([r for t in trials for r in t.runs])}
        for run in trial.runs:
            name = f"{style_of(run.estimator).label} {'' if run.association == 'none' else run.association}".strip()
            if log_of(run, trial.log) is not trial.log:
                left_out.append(f"{name}: its poses have other stamps than the log's frames.")
                continue
            if run.failure is not None and run.failure.frame == 0:
                left_out.append(f"{name}: {run.failure.text}.")
                continue
            key = f"r{len(runs)}."
            shown.append((key, trial, run))
            add_run(pack, key, run, trial, quantum)
            loops = [s for add in of_all("player") for s in add(pack, key, run, trial, quantum * FINER)]
            runs.append(_head_of(pack, key, name, run, trial, log, styles[run.estimator, run.association], loops))
    watched = next((r.watched for t in trials for r in t.runs if isinstance(r.watched, Watched)), None)
    r, gates = log.recorded, (setup.gate, setup.new_gate)
    gate, new_gate = (None if p is None else gate_threshold(p) for p in gates)
    percent, new_percent = ("none" if p is None else f"{100.0 * p:.10g} %" for p in gates)
    head = Head(
        *(log.name, quantum, runs),
        walls=0.0 if r.sensor.sees_points else float(r.observations.z[:, 0].max(initial=1.0)), indexed=r.time_is_index,
        left_out=left_out, methods=() if watched is None else watched.methods, gate=gate,
        new_gate=new_gate, gates=(percent, new_percent),
        band=(gate_threshold(0.025, 3), gate_threshold(0.975, 3)),
        labels=log.label is not None or log.labels_are_sensed, laser=r.scans is not None,
        truth=bool(log.truth.known_poses), camera=camera,
        team=company.add(pack, shown, quantum * FINER) if company and shown else None,
    )  # fmt: skip
    return pack.done(asdict(head))


def _head_of(
    pack: Pack, key: str, name: str, run: Run, trial: Trial, log: Log, line: Line, loops: list[dict[str, Any]]
) -> RunHead:
    watched = run.watched if isinstance(run.watched, Watched) else None
    why = "" if run.flaw is None else run.flaw.text
    return RunHead(
        *(key, name, run.estimator, run.association, style_of(run.estimator).colour, dashes(line), run.status, why),
        covariances=watched is not None and watched.covariances, task=trial.task, phases=run.phases,
        variant=trial.log.name.removeprefix(log.name).strip(":"), decides=f"{key}decision" in pack.names,
        scored=f"{key}final_outcome" in pack.names, history=watched is not None and len(watched.changes) > 0,
        every=0 if watched is None else watched.every, candidates=watched is not None and len(watched.pairs) > 0,
        nis=run.innovations is not None, nis_expected=run.gated[0], loops=loops,
    )  # fmt: skip


def _add_log(pack: Pack, log: Log, quantum: float) -> None:
    r, t = log.recorded, log.truth
    fine = quantum * FINER
    pack.add("time", r.time - r.time[0] if float(np.abs(r.time).max(initial=0.0)) > MOST_TIME * TIME else r.time, TIME)
    pack.add("count", np.diff(r.start))
    points, covariance = r.sensor_of().body_points(r.observations.z, r.observations.R)
    add_points(pack, "point", points, spread(covariance), fine)
    if t.pose is not None:
        pack.add("truth", t.pose[:, :2], fine)
        pack.add("truth_theta", wrap_angle(t.pose[:, 2]), ANGLE)
    if r.fixes is not None:
        some = r.fixes.kind != FixKind.HEADING
        pack.add("fix_frame", r.fixes.frame[some])
        pack.add("fix_xy", r.fixes.z[some, :2], fine)
    if r.closures is not None:
        pack.add("closure_frames", np.column_stack([r.closures.earlier, r.closures.later]))
    if t.landmark_of is not None:
        pack.add("true_id", t.landmark_of)
    granted = log.granted
    if log.label is not None and granted is not None:
        pack.add("label", granted)
    for name, known in (("true", t.landmarks), ("map", r.map)):
        if known is not None:
            pack.add(f"{name}_number", known.id)
            pack.add(f"{name}_xy", known.xy, fine)

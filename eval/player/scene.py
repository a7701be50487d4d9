"""What the page shows of a log and its runs, as one chunk (see `eval.player.pack`).

The live page gets chunks with the same arrays and heads, so what is common stands here, too.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from association.expectation import gate_threshold
from association.scans.constraints import LaserRun
from data.inputs import IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array, wrap_angle
from eval.figures.laser import LOOP_STATES, loop_states
from eval.figures.style import Line, series, style_of
from eval.player.pack import ANGLE, FURTHEST, RHO, TIME, Pack
from eval.player.watch import Watched, quantum_of, spread
from eval.referee.errors import along
from eval.referee.given_runs import log_of
from eval.referee.laser import right_closures
from eval.referee.score import Trial, confusion_of
from eval.replay.settings import Setup

PIXEL = 0.25  # of the recorded image
FINER = 0.1  # poses and observations, of which there are few numbers, are kept to a tenth of the landmarks' quantum
COARSE, ROUGH = 0.01, 0.02
"""Landmarks' sigmas are kept to half a percent of themselves, their correlations to a hundredth."""
MOST_TIME = 2**31 - 1


@dataclass(frozen=True)
class RunHead:
    """What the page is told of a run beside its arrays, whose names begin with `key`.

    Attributes:
        beside: what is different about its log.
        decides, scored, candidates, nis, history: whether it has arrays about decisions, outcomes, candidates, NIS, and
            landmarks as they were, after every so many frames; certain: with their covariances.
        nis_expected: per degree of freedom. loops: colour, line and name of each fate a loop closure can have.
    """

    key: str
    name: str  # as in lists; why: it is not `ok`, in words; dash: lengths of dash and gap, none of a solid line
    estimator: str
    association: str
    colour: str
    dash: Sequence[float]
    status: str
    why: str
    certain: bool
    task: str = "slam"
    phases: Sequence[str] = ("online",)
    variant: str = ""
    decides: bool = True
    scored: bool = False
    history: bool = True
    every: int = 1
    candidates: bool = False
    nis: bool = True
    nis_expected: float = 1.0
    loops: Sequence[Mapping[str, Any]] = ()


@dataclass(frozen=True)
class Head:
    """What the page is told of a log.

    Attributes:
        indexed: time is the number of a frame; quantum: m, of landmarks; walls: m, how far away one was read, 0 where
            landmarks are points.
        left_out: runs that are not shown, with the reason; methods: that were asked about each observation.
        gate, new_gate: squared distances, None without; gates: both in percent; band: of the NEES, 95 %.
        labels, laser, truth: whether the log has them; camera: its images.
    """

    name: str
    quantum: float
    runs: Sequence[RunHead]
    walls: float
    indexed: bool = False
    left_out: Sequence[str] = ()
    methods: Sequence[str] = ()
    gate: float | None = None
    new_gate: float | None = None
    gates: tuple[str, str] = ("none", "none")
    band: tuple[float, float] = (0.0, 0.0)
    labels: bool = False
    laser: bool = False
    truth: bool = False
    camera: Mapping[str, Any] | None = None


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
    pack.add("camera_corners", found.pixels[kept].reshape(int(np.sum(kept)), -1), PIXEL)
    whole = cv2.imdecode(np.frombuffer(found.tiles[0][1], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert whole is not None
    images = {k: base64.b64encode(image).decode() for k, image in found.small if k < frames}
    return {"width": whole.shape[1], "frames": list(images), "images": list(images.values())}


def add_loops(pack: Pack, key: str, run: LaserRun, trial: Trial, step: float) -> list[dict[str, Any]]:
    """Arrays named `key` and a name; colour, line and name of each fate a loop closure can have."""
    if run.loops is None or run.chain is None or run.key_pose is None or not len(run.loops):
        return []
    truth = trial.log.truth.pose
    false = None if truth is None else ~right_closures(run.loops, truth[run.chain.frame])
    weight = np.ones(len(run.loops)) if run.weight is None else run.weight
    names = list(LOOP_STATES)
    loop_state = loop_states(run.loops, weight, false)
    pack.add(f"{key}key_frame", run.chain.frame)
    pack.add(f"{key}key_xy", run.key_pose[:, :2], step)
    pack.add(f"{key}loop_keys", np.column_stack([run.loops.key1, run.loops.key2]))
    pack.add(f"{key}loop_fate", np.array([names.index(f) for f in loop_state]))
    return [
        {"name": name, "colour": colour, "dash": dashes(line)}
        for name, (colour, line, _) in LOOP_STATES.items()
        if false is not None or name != names[-1]
    ]


def dashes(line: Line) -> list[float]:
    """Lengths of dash and gap in turn; none of a solid line."""
    return [] if line == "-" else list(line[1])


def add_path(pack: Pack, name: str, pose: Array, sigma: Array, rho: Array, step: float) -> None:
    """Poses (N, 3) with their sigmas (N, 3) and the correlation (N,) of x and y, unknown where a sigma is."""
    pack.add(f"{name}_xy", pose[:, :2], step)
    pack.add(f"{name}_theta", wrap_angle(pose[:, 2]), ANGLE)
    pack.add_log(f"{name}_sigma", sigma)
    pack.add(f"{name}_rho", np.where(np.isfinite(sigma).all(axis=1), rho, np.nan), RHO)


def add_points(pack: Pack, name: str, xy: Array, shape: Array, step: float) -> None:
    """Points (n, 2) with what `spread` says of their covariances (n, 3)."""
    pack.add(name, xy, step)
    pack.add_log(f"{name.removesuffix('_xy')}_sigma", shape[:, :2])
    pack.add(f"{name.removesuffix('_xy')}_rho", shape[:, 2], RHO)


def add_changes(
    pack: Pack, key: str, frame: IntArray, number: IntArray, there: IntArray, xy: Array, shape: Array, quantum: float
) -> None:
    """Changes of landmarks (C,), as differences from the same landmark's last one in the chunk, which the page adds up.

    xy: (C, 2) kept to half a quantum; shape: (C, 3) as of `spread`. A landmark further off than integers reach (a
    thousand kilometres) is shown at that distance.
    """
    pack.add(f"{key}change_frame", frame)
    pack.add(f"{key}change_number", number)
    pack.add(f"{key}change_there", there)
    place = np.round(np.clip(xy / quantum, -FURTHEST, FURTHEST))
    sigma = np.round(np.log(np.maximum(shape[:, :2], 1.0e-9)) / COARSE)
    values = np.column_stack([place, sigma, np.round(shape[:, 2] / ROUGH)])
    pack.add_steps(f"{key}change", own_steps(number, values))


def add_run(pack: Pack, key: str, run: Run, trial: Trial, quantum: float) -> None:
    """Arrays of a run, named `key` and a name."""
    for phase in run.phases:
        pose, covariance = run.trajectory(phase).pose, run.trajectory(phase).covariance
        sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        add_path(pack, f"{key}{phase}", pose, sigma, spread(covariance)[:, 2], quantum * FINER)
        path = along(run, phase, trial.log)
        if path is not None:
            pack.add_log(f"{key}{phase}_nees", path.nees["pose"])
    if run.innovations is not None:
        dof = run.innovations.dof
        per_dof = np.divide(run.innovations.nis, dof, out=np.full(len(dof), np.nan), where=dof > 0)
        pack.add_log(f"{key}nis", per_dof)
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
    if len(w.change_frame):
        shape = np.column_stack([w.change_sigma, w.change_rho])
        add_changes(pack, key, w.change_frame, w.change_number, w.change_there, w.change_xy, shape, w.quantum)
    pack.add(f"{key}seen_frame", w.seen_frame)
    pack.add(f"{key}seen_number", w.seen_number)
    add_points(pack, f"{key}seen_xy", w.seen_xy, np.column_stack([w.seen_sigma, w.seen_rho]), w.quantum)
    pack.add(f"{key}pair_row", w.pair_row)
    pack.add(f"{key}pair_number", w.pair_number)
    pack.add_log(f"{key}pair_d2", w.pair_d2, 2.0e-4)
    pack.add_steps(f"{key}said", w.said - run.decisions[:, None])


def own_steps(number: Any, values: Array) -> Array:
    """Rows (C, k) less the last row before them with the same number (C,); the first of each as it is."""
    order = np.argsort(number, kind="stable")
    sorted_rows, same = values[order], np.diff(number[order], prepend=-1) == 0
    steps = sorted_rows.copy()
    steps[1:] -= np.where(same[1:, None], sorted_rows[:-1], 0.0)
    own = np.empty_like(steps)
    own[order] = steps
    return own


def scene(trials: Sequence[Trial], setup: Setup) -> dict[str, Any]:
    """The chunk of a log: its own arrays, then those of every run of the trials, which share its frames.

    `setup`: whose gates were used.
    """
    log = trials[0].log
    pack = Pack(0, len(log.recorded))
    quantum = quantum_of(log.recorded)
    _add_log(pack, log, quantum)
    camera = add_camera(pack, log)
    runs, left_out = list[RunHead](), list[str]()
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
            add_run(pack, key, run, trial, quantum)
            loops = add_loops(pack, key, run, trial, quantum * FINER) if isinstance(run, LaserRun) else []
            line = styles[run.estimator, run.association]
            runs.append(_head_of(pack, key, name, run, trial, _beside(trial, log), dashes(line), loops))
    watched = next((r.watched for t in trials for r in t.runs if isinstance(r.watched, Watched)), None)
    head = Head(
        name=log.name,
        quantum=quantum,
        runs=runs,
        walls=_seen_from(log),
        indexed=log.recorded.time_is_index,
        left_out=left_out,
        methods=() if watched is None else watched.methods,
        gate=_threshold(setup.gate),
        new_gate=_threshold(setup.new_gate),
        gates=(_percent(setup.gate), _percent(setup.new_gate)),
        band=(gate_threshold(0.025, 3), gate_threshold(0.975, 3)),
        labels=log.label is not None or log.labels_are_sensed,
        laser=log.recorded.scans is not None,
        truth=bool(log.truth.known_poses),
        camera=camera,
    )
    return pack.done(asdict(head))


def _head_of(
    pack: Pack,
    key: str,
    name: str,
    run: Run,
    trial: Trial,
    variant: str,
    dash: list[float],
    loops: list[dict[str, Any]],
) -> RunHead:
    """Of a run whose arrays are in the pack."""
    watched = run.watched if isinstance(run.watched, Watched) else None
    return RunHead(
        key=key,
        name=name,
        estimator=run.estimator,
        association=run.association,
        colour=style_of(run.estimator).colour,
        dash=dash,
        status=run.status,
        why="" if run.flaw is None else run.flaw.text,
        certain=watched is not None and watched.certain,
        task=trial.task,
        phases=run.phases,
        variant=variant,
        decides=f"{key}decision" in pack.names,
        scored=f"{key}final_outcome" in pack.names,
        history=watched is not None and len(watched.change_frame) > 0,
        every=0 if watched is None else watched.every,
        candidates=watched is not None and len(watched.pair_row) > 0,
        nis=run.innovations is not None,
        nis_expected=run.gated[0],
        loops=loops,
    )


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
    pack.add("time", r.time - r.time[0] if span > MOST_TIME * TIME else r.time, TIME)
    pack.add("count", np.diff(r.start))
    points, covariance = r.sensor.body_points(r.observations.z, r.observations.R)
    add_points(pack, "point", points, spread(covariance), fine)
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

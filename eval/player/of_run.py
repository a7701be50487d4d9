"""One run in a chunk: its paths, consistency, decisions, and what an observer of it wrote down."""

from __future__ import annotations

from typing import Any

import numpy as np

from association.scans.laser_run import LaserRun
from data.result import Run
from data.se2 import Array, wrap_angle
from eval.player.pack import FURTHEST, Pack
from eval.player.watch import Watched, spread
from eval.referee.along import along
from eval.referee.score import Trial, confusion_of

ANGLE, RHO = 1.0e-4, 1.0e-3


def add_run(pack: Pack, key: str, run: Run, trial: Trial, quantum: float, finer: float) -> dict[str, Any]:
    """Arrays named `key` and a name; what the header says of the run."""
    for phase in run.phases:
        trajectory = run.trajectory(phase)
        pack.add(f"{key}{phase}_xy", trajectory.pose[:, :2], quantum * finer)
        pack.add(f"{key}{phase}_theta", wrap_angle(trajectory.pose[:, 2]), ANGLE)
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

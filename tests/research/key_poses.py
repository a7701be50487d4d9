"""Consistency of the log that `slamref convert laser` makes, on simulated plans with their true paths.

`python -m tests.research.key_poses 8` prints for `floorplan:0` to `7`, both motions, and loops, corners, or both: means
over plans of the pose's NEES over its expectation (mean of all frames) and of the RMSE [m], online (`ekf`) and final
(`batch`), and how many closures the filter left out. With the wheels as motion its gate is off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.command import Parser
from data.inputs import Inputs, IntArray, LabelledObservations
from data.result import Run
from data.se2 import Array, pose_error
from data.worlds.registry import named_log
from eval.compare import compare
from eval.replay.settings import Setup
from wings.laser.slam.key_log import MOTIONS, ODOMETRY, key_log

PARTS = ("loops", "corners", "both")
FIRST = 5  # frame; before it covariances are those of the prior, which is exact


def main() -> None:
    """Print a row for each motion, part and estimator."""
    p = Parser(prog="python -m tests.research.key_poses", description="Consistency of logs of key poses.")
    p.add_argument("plans", metavar="N", type=int, help="simulated plans, from the first on")
    plans = p.parse_args().plans
    for motion in MOTIONS:
        setup = Setup(gate_poses=None) if motion == ODOMETRY else Setup()
        rows: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
        for seed in range(plans):
            log = named_log(f"floorplan:{seed}")
            made = key_log(log.recorded, setup, motion=motion)
            assert log.truth.pose is not None
            for part in PARTS:
                for run in compare(only(made.inputs, made.label, part), "slam", ("ekf", "batch"), "known", setup):
                    rows.setdefault((part, run.estimator), []).append(scores(run, log.truth.pose[made.frame]))
        for (part, name), found in rows.items():
            nees, rmse, refused = np.mean(found, axis=0)
            print(f"{motion} {part} {name}: NEES {nees:.2f}, RMSE {rmse:.3f} m, {refused:.1f} closures left out")


def only(inputs: Inputs, label: IntArray, part: str) -> Inputs:
    """The inputs with labelled corners, or loops, or both; matches of neighbours stay."""
    o, c = inputs.observations, inputs.closures
    n = 0 if part == "loops" else len(o.frame)
    seen = LabelledObservations(o.frame[:n], o.z[:n], o.R[:n], label[:n], sensed=True)
    if part == "corners" and c is not None:
        k = np.flatnonzero(c.source != c.sources.index("loop"))
        left = replace(
            c, frame1=c.frame1[k], frame2=c.frame2[k], relative=c.relative[k], covariance=c.covariance[k],
            source=c.source[k],
        )  # fmt: skip
        c = left if len(left) else None
    return replace(inputs, observations=seen, closures=c)


def scores(run: Run, truth: Array) -> tuple[float, float, float]:
    """NEES over its expectation, RMSE [m], and closures left out of a run against true poses (F, 3)."""
    path = run.trajectory(run.phases[-1])
    assert path is not None
    error = pose_error(path.pose, truth)[FIRST:]
    square = np.einsum("ki,kij,kj->k", error, np.linalg.inv(path.covariance[FIRST:]), error)
    refused = 0.0 if run.closures is None else float((~run.closures.used).sum())
    return float(square.mean()) / 3.0, float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean())), refused


if __name__ == "__main__":
    main()

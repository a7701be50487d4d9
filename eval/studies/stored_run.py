"""A stored run of others replayed: their filters' NEES against ours step by step, our smoothers on the same inputs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.recordings.esde import StoredRun, load_esde, log_of
from data.result import Run
from eval.referee import consistency
from eval.referee.score import Trial
from eval.replay.names import FILTERS
from eval.replay.run import compare
from eval.studies.published import COLUMNS
from eval.studies.scenario import Scenario

FIRST_COMPARED = 2
"""The first step with an update has a singular covariance."""
FLOOR = 1e-10
"""m^2, rad^2. Added to the increments for the smoothers, which need the inverse."""

Rows = list[Mapping[str, object]]


def replay_stored(scenario: Scenario, path: Path) -> tuple[Trial, Rows]:
    """Every estimator of the scenario on the recording, and the rows of published.csv.

    In a row `difference_in_se` is the largest relative difference of any step's NEES over the scenario's tolerance.
    Filters get the increments as they are, smoothers with a floor under their singular covariances. DataError where the
    file is not the one that the scenario names.
    """
    stored = load_esde(path)
    wanted = dict(scenario.values).get("sha256", stored.sha256)
    if wanted != stored.sha256:
        raise DataError(f"{path}: sha256 {stored.sha256}; scenario {scenario.name} is about {wanted}")
    runs: list[Run] = []
    for m in scenario.members:
        floor = 0.0 if m.name in FILTERS else FLOOR
        stated = {str(k): str(v) for k, v in m.world}
        log = log_of(stored, scenario.name, floor=floor, **stated)
        runs += compare(log.inputs(labels=True), "slam", [m.name], "known", scenario.setup)
    log = log_of(stored, scenario.name)
    return Trial(log, "slam", tuple(runs)), [
        _row(scenario, stored, run, tolerance)
        for name, tolerance in (scenario.published.tolerance if scenario.published is not None else ())
        for run in runs
        if run.estimator == name
    ]


def _row(scenario: Scenario, stored: StoredRun, run: Run, tolerance: float) -> Mapping[str, object]:
    theirs = stored.nees[run.estimator]
    ours, difference = math.nan, math.inf
    if run.flaw is None and run.online is not None:
        log = log_of(stored, scenario.name)
        assert log.truth.pose is not None
        nees = consistency.nees(run.online.pose, run.online.covariance, log.truth.pose, "pose")
        ours = float(np.mean(nees[scenario.from_frame :]))
        difference = float(np.max(np.abs(nees[FIRST_COMPARED:] / theirs[FIRST_COMPARED:] - 1.0)))
    stored_mean = float(np.mean(theirs[scenario.from_frame :]))
    values = (
        scenario.name, run.estimator, "nees_pose", ours, math.nan, stored_mean, math.nan, difference / tolerance,
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))

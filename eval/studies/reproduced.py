"""Our numbers against published ones: the rows of published.csv, and statements about orderings.

For a stored run of others: their filters' NEES against ours step by step, our smoothers on the same inputs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.formats.recordings.esde import StoredRun, load_esde, log_of
from data.result import Run
from data.terminal import in_columns
from eval.compare import compare
from eval.referee import consistency
from eval.referee.result_files import PUBLISHED
from eval.referee.score import Trial
from eval.replay.settings import FILTERS
from eval.studies.montecarlo import Study
from eval.studies.scenario import Ordering, Row, Scenario

SQUARES = {"rmse_position_m": ("position", 1.0), "rmse_heading_deg": ("heading", 180.0 / np.pi)}


@dataclass(frozen=True)
class Estimate:
    """Our number with its standard error, from `runs` independent runs."""

    value: float
    se: float
    runs: int


def mean_of(values: Sequence[float]) -> Estimate:
    """Mean and its standard error."""
    x = np.asarray(values, float)
    return Estimate(float(x.mean()), float(x.std(ddof=1) / math.sqrt(len(x))) if len(x) > 1 else math.nan, len(x))


def rms_of(squares: Sequence[float], scale: float = 1.0) -> Estimate:
    """Pooled root mean square of each run's mean squared error; standard error to first order."""
    m = mean_of(squares)
    root = math.sqrt(m.value)
    return Estimate(scale * root, scale * m.se / (2.0 * root) if root > 0 else math.nan, m.runs)


def difference(ours: Estimate, published: float, se_published: float) -> float:
    """Difference in standard errors of the difference."""
    spread = math.hypot(ours.se, se_published)
    return (ours.value - published) / spread if spread > 0 else math.nan


def _row_of(scenario: str, row: Row, *ours: float) -> Mapping[str, object]:
    """A row of published.csv: our number, its standard error, and the difference."""
    who, (value, se, off) = (scenario, row.estimator, row.quantity), ours
    return dict(zip(PUBLISHED.names, (*who, value, se, row.value, row.se or math.nan, off), strict=True))


def published_rows(study: Study) -> list[Mapping[str, object]]:
    """Rows of published.csv for every published number of a study's scenario whose estimator ran."""
    p, rows = study.scenario.published, []
    for row in () if p is None else p.rows:
        if (ours := ours_of(study, row.estimator, row.quantity)) is not None:
            off = difference(ours, row.value, row.se)
            rows.append(_row_of(study.scenario.name, row, ours.value, ours.se, off))
    return rows


def ours_of(study: Study, estimator: str, quantity: str) -> Estimate | None:
    """Our value of a publishable quantity with its standard error; None if the estimator has no complete run.

    Filters are compared online, batch smoothers in their only phase.
    """
    found = [k for k in study.samples if k[1] == estimator]
    key = next((k for k in found if k[3] == "online"), found[0] if found else None)
    good = [] if key is None else study.good(key)
    if not good:
        return None
    if quantity in SQUARES:
        name, scale = SQUARES[quantity]
        return rms_of([s.squares[name] for s in good], scale)
    return mean_of([s.published[quantity.removeprefix("nees_")] for s in good])


def orderings(study: Study) -> list[tuple[Ordering, Estimate, Estimate]]:
    """Each published ordering with our numbers, of the smaller and of the larger."""
    p, found = study.scenario.published, []
    for o in () if p is None else p.orderings:
        smaller, larger = (ours_of(study, name, o.quantity) for name in (o.smaller, o.larger))
        if smaller is not None and larger is not None:
            found.append((o, smaller, larger))
    return found


def lines(rows: Sequence[Mapping[str, object]]) -> list[str]:
    """The rows as terminal text: ours, published, difference in standard errors."""
    if not rows:
        return []
    table = [("scenario", "estimator", "quantity", "ours", "published", "difference [SE]")]
    for r in rows:
        who = str(r["scenario"]), str(r["estimator"]), str(r["quantity"])
        both = _pair(r["ours"], r["se_ours"]), _pair(r["published"], r["se_published"])
        table.append((*who, *both, f"{float(str(r['difference_in_se'])):+.2f}"))
    return in_columns(table)


def _pair(value: object, se: object) -> str:
    v, s = float(str(value)), float(str(se))
    return f"{v:.4g} ± {s:.2g}" if np.isfinite(s) else f"{v:.6g}"


FIRST_COMPARED = 2  # the first step with an update has a singular covariance
FLOOR = 1e-10  # m^2, rad^2; added to the increments for smoothers, which need the inverse

Rows = list[Mapping[str, object]]


def replay_stored(scenario: Scenario, path: Path) -> tuple[Trial, Rows]:
    """Every estimator of the scenario on the recording, and the rows of published.csv.

    `difference_in_se` is the largest relative difference of any step's NEES over the scenario's tolerance. Smoothers
    get increments with a floor under their singular covariances. DataError if the file is not the one that the scenario
    names.
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
    row = Row(run.estimator, "nees_pose", stored_mean, 0.0)
    return _row_of(scenario.name, row, ours, math.nan, difference / tolerance)

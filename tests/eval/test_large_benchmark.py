"""The benchmark of large logs: what it measures, the exponent of growth, its file and its figure."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import pytest

from eval.benchmarks.growth import (
    BARE,
    LOG,
    RunCost,
    line_of,
    measure,
    measure_all,
    scaling_figure,
    slope,
    write_large,
)
from eval.figures.style import save


def test_the_exponent_of_growth_is_that_of_a_power_law():
    sizes = [1e3, 1e4, 1e5]
    assert slope(sizes, [3e-5 * n**1.5 for n in sizes]) == pytest.approx(1.5)


@pytest.mark.parametrize("estimator", ["ekf", "batch", "isam2", BARE])
def test_a_run_is_measured_with_its_size(estimator):
    m = measure(estimator, LOG.format(60))
    assert (m.estimator, m.frames, m.status) == (estimator, 60, "ok")
    assert 0.0 < m.seconds <= m.with_start + 1e-3
    assert m.peak_mb >= m.log_mb > 50.0
    assert m.rmse_m < 1.0
    assert estimator in line_of(m)


def test_measurements_are_written_and_drawn(tmp_path):
    found = [
        RunCost(e, n, n // 10, 1e-4 * n, 2e-4 * n, 100.0 + n / 50, 100.0, 1.0, "ok")
        for e in ("ekf", BARE)
        for n in (1000, 10_000, 100_000)
    ]
    write_large(found, tmp_path / "large.csv")
    with (tmp_path / "large.csv").open() as file:
        assert [row["frames"] for row in csv.DictReader(file)] == ["1000", "10000", "100000"] * 2
    assert [p.name for p in save(scaling_figure(found), tmp_path, "large", ("png",))] == ["large.png"]


def test_each_estimator_is_measured_in_a_process_of_its_own_the_small_logs_first(monkeypatch):
    asked = []

    def run(command, **how):
        asked.append(command[-2:])
        m = RunCost(command[-2], 5, 1, 0.1, 0.2, 90.0, 80.0, 0.5, "ok")
        return SimpleNamespace(stdout=f"words before\n{json.dumps(m)}\n")

    monkeypatch.setattr("eval.benchmarks.growth.subprocess.run", run)
    found = list(measure_all((10, 20), ("ekf", "batch")))
    assert [m.estimator for m in found] == ["ekf", "batch"] * 2
    assert all((m.status, m.peak_mb) == ("ok", 90.0) for m in found)
    assert asked == [[e, LOG.format(n)] for n in (10, 20) for e in ("ekf", "batch")]

"""Which errors are estimated: those asked for, else those that the log names, else all."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data.errors import UsageError
from data.inputs import Observations, Scanner, Scans
from data.motion.priors import PRIORS
from data.pose_measurements import Fixes, FixKind, FixSource
from data.worlds.registry import named_log
from eval.plan import calibrate
from eval.plan.calibrate import ALL, ASKED, NAMED, check_calibrated, settle
from eval.plan.experiment import Experiment, Unfinished, Work
from eval.plan.flags.options import options_of
from eval.run_all import main

LOG = named_log("arena:0:frames=20")


def settled(monkeypatch, asked, names=()):
    """An experiment and its calibration as settled, where the log names these."""
    monkeypatch.setattr(calibrate, "plainly", lambda log, task, association, setup: ((), names))
    options = options_of({"calibrate": asked, "jobs": 1})
    e = Experiment(LOG, "slam", (Work("known", ("ekf",)),), options.setup)
    (found,), made = settle([e], options.execution, Unfinished(1))
    return found, made


def test_errors_that_are_asked_for_are_estimated_with_the_sigma_stated(monkeypatch):
    e, (made,) = settled(monkeypatch, "curvature,scale=0.03", names=("left",))
    assert made.why == ASKED
    assert e.log.recorded.systematic.names == ("scale", "curvature") == made.systematic.names
    assert e.log.recorded.systematic.sigma.tolist() == [0.03, PRIORS["curvature"].wide]
    assert e.log.inputs(labels=True).systematic is e.log.recorded.systematic


def test_errors_that_the_log_names_are_estimated_with_wide_priors(monkeypatch):
    e, (made,) = settled(monkeypatch, "auto", names=("left", "right"))
    assert made.why == NAMED
    assert e.setup.calibrate == ("left=0.1", "right=0.1")


def test_where_the_log_names_none_all_are_estimated_with_tight_priors(monkeypatch):
    _, (made,) = settled(monkeypatch, "auto")
    assert made.why == ALL
    assert made.systematic.names == tuple(n for n in PRIORS if n != "range")  # SLAM
    assert made.systematic.sigma.tolist() == [p.tight for n, p in PRIORS.items() if n != "range"]


def test_without_the_flag_nothing_is_looked_at(monkeypatch):
    e, made = settled(monkeypatch, False)
    assert made == ()
    assert e.log is LOG


def test_a_laser_log_has_nothing_to_be_calibrated_by():
    o, scans = LOG.recorded.observations, Scans(Scanner(-1.0, 0.1, 10.0, 0.01), np.arange(20), np.ones((20, 5)))
    scanned = replace(
        LOG,
        recorded=replace(LOG.recorded, scans=scans, observations=Observations(*(a[:0] for a in (o.frame, o.z, o.R)))),
    )
    with pytest.raises(UsageError, match="is a laser log"):
        check_calibrated(scanned, ("auto",), ())
    check_calibrated(scanned, (), ())
    check_calibrated(LOG, ("auto",), ())


@pytest.mark.parametrize(("fixed", "asked", "said"), [
    (True, "scale", ""), (True, "auto", ""), (True, "bearing", "no landmarks; range and bearing need points"),
    (False, "auto", "has none of them; landmarks, fixes or closures"),
])  # fmt: skip
def test_fixes_tell_the_errors_of_the_odometry_and_nothing_tells_none(monkeypatch, fixed, asked, said):
    r, n = LOG.recorded, len(LOG.recorded)
    P = np.tile(np.diag([0.01, 0.01, 0.0]), (n, 1, 1))
    kind, source = np.full(n, FixKind.POSITION), np.zeros(n, int)
    fixes = Fixes(np.arange(n), kind, source, LOG.truth.pose * [1, 1, 0], P, (FixSource("gps"),)) if fixed else None
    bare = replace(r, observations=r.observations.only(slice(0)), fixes=fixes)
    bare = replace(LOG, recorded=bare, truth=replace(LOG.truth, landmark_of=None))
    monkeypatch.setattr(sys.modules[__name__], "LOG", bare)
    _, (made,) = settled(monkeypatch, asked) if fixed else (None, (None,))
    asked = options_of({"calibrate": asked}).setup.calibrate
    if said:
        with pytest.raises(UsageError, match=said):
            check_calibrated(bare, asked, ())
    else:
        check_calibrated(bare, asked, ())
        assert set(made.systematic.names) <= {"scale", "curvature", "left", "right", "drift"}


@pytest.mark.slow
def test_a_log_that_errs_is_objected_to_before_and_not_after(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--log", "arena:0:curvature=0.05", "--task", "slam", "--calibrate", "--estimator", "ekf,isam2,batch"]
    assert main([*arguments, "--no-plots", "-q", "--jobs", "1", "--out", "r"]) == 0
    report = Path("r/report.md").read_text(encoding="utf-8")
    assert "**Battery after** (with these errors estimated): none of" in report
    for name, phase in (("ekf", "online"), ("isam2", "online"), ("isam2", "final"), ("batch", "final")):
        (file,) = Path("r/runs").glob(f"*/slam-{name}-known/{phase}.csv")
        last = pd.read_csv(file).iloc[-1]
        assert abs(last["curvature"] - 0.05) < 3.0 * last["sigma_curvature"] < 0.02, name
    metrics = pd.read_csv("r/metrics.csv")
    assert np.allclose(metrics["nis"].dropna(), 1.0, atol=0.06)

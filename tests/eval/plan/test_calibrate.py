"""Which systematic errors are estimated: asked for, named by the log, or all."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data.errors import UsageError
from data.inputs import Observations, Scanner, Scans
from data.motion.priors import PRIORS, systematic
from data.notice import stopped
from data.origin import Origin
from data.pose_measurements import Fixes, FixKind, FixSource
from data.result import Failure
from data.worlds.registry import named_log
from eval.plan import calibrate
from eval.plan.experiment import Experiment, Unfinished, Work
from eval.plan.flags.options import options_of
from eval.referee.attribution import NOISE, Finding
from eval.referee.residuals import used_by
from eval.replay.run import compare
from eval.replay.settings import Setup
from eval.run_all import main
from eval.studies.twins import inputs_of, source_of, twin
from tests.quick import slow

LOG = named_log("arena:0:frames=20")


def settled(monkeypatch, asked, names=()):
    """An experiment, and where its errors come from, as settled, where the log names these."""
    monkeypatch.setattr(calibrate, "plainly", lambda log, task, association, setup: names)
    options = options_of({"calibrate": asked, "jobs": 1})
    e = Experiment(LOG, "slam", (Work("known", ("ekf",)),), options.setup)
    (found,) = calibrate.settle([e], options.execution, Unfinished(1))
    return found, found.log.origins.get("systematic_errors")


def test_errors_asked_for_named_by_the_log_or_all_are_estimated_with_their_priors(monkeypatch):
    e, origin = settled(monkeypatch, "curvature,scale=0.03", names=("left",))
    assert origin is Origin.GIVEN
    assert e.log.recorded.systematic.names == ("scale", "curvature")
    assert e.log.recorded.systematic.sigma.tolist() == [0.03, PRIORS["curvature"].wide]
    assert e.log.inputs(labels=True).systematic is e.log.recorded.systematic
    e, origin = settled(monkeypatch, "auto", names=("left", "right"))
    assert origin is Origin.INFERRED
    assert e.setup.calibrate == ("left=0.1", "right=0.1")
    e, origin = settled(monkeypatch, "auto")
    assert origin is Origin.ASSUMED
    assert e.log.recorded.systematic.names == tuple(n for n in PRIORS if n != "range")  # SLAM
    assert e.log.recorded.systematic.sigma.tolist() == [p.tight for n, p in PRIORS.items() if n != "range"]
    e, origin = settled(monkeypatch, False)
    assert origin is None
    assert e.log is LOG


def test_a_laser_log_has_nothing_to_be_calibrated_by():
    o, scans = LOG.recorded.observations, Scans(Scanner(-1.0, 0.1, 10.0, 0.01), np.arange(20), np.ones((20, 5)))
    scanned = replace(
        LOG,
        recorded=replace(LOG.recorded, scans=scans, observations=Observations(*(a[:0] for a in (o.frame, o.z, o.R)))),
    )
    with pytest.raises(UsageError, match="is a laser log"):
        calibrate.check_calibrated(scanned, ("auto",), ())
    calibrate.check_calibrated(scanned, (), ())
    calibrate.check_calibrated(LOG, ("auto",), ())


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
    e, _ = settled(monkeypatch, asked)
    asked = options_of({"calibrate": asked}).setup.calibrate
    if said:
        with pytest.raises(UsageError, match=said):
            calibrate.check_calibrated(bare, asked, ())
    else:
        calibrate.check_calibrated(bare, asked, ())
        assert set(e.log.recorded.systematic.names) <= {"scale", "curvature", "left", "right", "drift"}


@pytest.mark.slow
def test_a_log_that_errs_has_its_error_estimated(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--log", "arena:0:curvature=0.05", "--task", "slam", "--calibrate", "--estimator", "ekf,isam2,batch"]
    assert main([*arguments, "--no-plots", "-q", "--jobs", "1", "--out", "r"]) == 0
    for name, phase in (("ekf", "online"), ("isam2", "online"), ("isam2", "final"), ("batch", "final")):
        (file,) = Path("r/runs").glob(f"*/slam-{name}-known/{phase}.csv")
        last = pd.read_csv(file).iloc[-1]
        assert abs(last["curvature"] - 0.05) < 3.0 * last["sigma_curvature"] < 0.02, name
    assert np.allclose(pd.read_csv("r/metrics.csv")["nis"].dropna(), 1.0, atol=0.06)


def found(*names, other=()):
    return [Finding(NOISE, "systematic", name, 0.1, other=other) for name in names]


@pytest.fixture(scope="module")
def inputs():
    return named_log("arena:0:frames=20").inputs()


@pytest.mark.parametrize(("names", "expected"), [
    (("odometry_x_scale",), ("scale",)),
    (("odometry_theta_left", "odometry_theta_curvature"), ("curvature", "left", "right")),
    (("odometry_y_distance",), ("bearing",)), (("z2_constant", "z1_range"), ("range", "bearing")),
    (("z2_range", "odometry_theta_time", "z1_speed"), ()),
])  # fmt: skip
def test_findings_stand_for_errors_in_their_order(inputs, names, expected):
    assert calibrate.named(found(*names), wandering=False, inputs=inputs) == expected


def test_what_cannot_be_told_apart_or_has_another_sensor_is_named_by_what_it_is(inputs):
    points = named_log("arena:0:frames=20+sensor=relative_point").inputs()
    assert calibrate.named(found("z2_range"), wandering=False, inputs=points) == ("bearing",)
    assert calibrate.named(found("z2_constant"), wandering=False, inputs=points) == ()
    like = found("odometry_theta_time", other=("z1_speed", "odometry_theta_curvature", "odometry_x_scale"))
    assert calibrate.named(like, wandering=False, inputs=inputs) == ("curvature",)
    slam = inputs.without_map()
    assert calibrate.named(found("z1_range"), wandering=True, inputs=slam) == ("scale", "drift")
    assert "range" in calibrate.every(inputs)
    assert "range" not in calibrate.every(slam)


def test_a_unit_of_an_error_adds_to_the_odometry_what_a_world_with_that_error_reports():
    plain, small = named_log("arena:3:frames=60"), 1e-6
    (run,) = compare(plain.inputs(labels=True), "localization", ("dead-reckoning",))
    motion = plain.inputs().increments.mean
    path = [plain.inputs().prior.mean]  # where the odometry has no noise
    for m in motion[1:]:
        c, s = np.cos(path[-1][2]), np.sin(path[-1][2])
        path.append(path[-1] + np.array([c * m[0] - s * m[1], s * m[0] + c * m[1], m[2]]))
    columns = {
        e.name: e.motion for e in calibrate.hypotheses(plain.inputs(), np.array(path), used_by(run, plain.inputs()))
    }
    for name, error in (("x_scale", "scale"), ("theta_curvature", "curvature"), ("theta_left", "left")):
        there = named_log(f"arena:3:frames=60+{error}={small}").inputs().increments.mean
        np.testing.assert_allclose(columns[f"odometry_{name}"], (there - motion) / small, atol=2e-5)


@pytest.mark.parametrize(("keys", "expected"), [
    ("", ()), (":curvature=0.03+scale=-0.1", ("scale", "curvature")),
    pytest.param(":bearing_error=0.05", ("bearing",), marks=pytest.mark.slow),
])  # fmt: skip
def test_a_log_names_its_errors_without_any_twin(keys, expected):
    assert calibrate.plainly(named_log(f"arena:1{keys}"), "localization", "known", Setup()) == expected


def test_what_one_log_in_twenty_shows_by_chance_is_not_named(monkeypatch):
    log = named_log("arena:115")  # its turns to the left err by 3.2 standard errors
    names = []
    for share in (0.05, 0.01):
        monkeypatch.setattr("eval.plan.calibrate.WRONGLY", share)
        names.append(calibrate.plainly(log, "localization", "known", Setup()))
    assert names == [("left", "right"), ()]


def test_without_a_smoother_or_motion_nothing_is_named(inputs):
    log = named_log("arena:0:frames=20")
    (run,) = compare(log.inputs(labels=True), "localization", ("dead-reckoning",))
    assert calibrate.names_of(log.inputs(), replace(run, failure=Failure("diverged", 3, stopped("no")))) == ()
    assert not calibrate.wanders(inputs, named_log("arena:0:frames=20").truth.pose)


def test_nothing_is_asked_of_turns_that_are_noise():
    park, arena = (named_log(name).inputs() for name in ("park:0:frames=1000", "arena:0"))
    assert [calibrate.turned(park, n) for n in ("left", "right", "scale")] == [True, False, True]
    assert calibrate.turned(arena, "left")
    assert calibrate.turned(arena, "right")
    assert "right" not in calibrate.every(park)
    assert "right" not in calibrate.plainly(named_log("park:0:frames=400+left=-0.2"), "localization", "known", Setup())


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_a_curvature_wanders_that_comes_and_goes_and_none_that_stays(seed):
    def says(keys):
        log = named_log(f"park:{seed}:frames=1500{keys}")
        return calibrate.wanders(log.inputs(), log.truth.pose)

    assert says("+drift=0.004")
    assert not says("+curvature=0.01+scale=0.05")
    assert not says("")


@pytest.fixture(scope="module", params=["localization", "slam"])
def smoothed(request):
    """A log whose wheels err, and batch's plain run and the one that estimates the errors, each with its log."""
    log = named_log("arena:0:scale=-0.1+curvature=0.05+frames=250")
    aware = calibrate.with_systematic(log, systematic(("scale", "curvature")))
    return [(each, _batch(each, request.param)) for each in (log, aware)]


def _batch(log, task):
    (run,) = compare(inputs_of(log, task, "known"), task, ("batch",), "known")
    return run


def test_twins_have_no_errors_and_estimate_them_all_the_same(smoothed):
    log, run = smoothed[1]
    drawn = twin(source_of(log, run, (), Setup()), 0)
    assert drawn.recorded.systematic is log.recorded.systematic
    found = _batch(drawn, run.task).errors_final
    assert np.all(np.abs(found.mean[-1]) < 4.0 * found.sigma[-1])
    # odometry as of a robot without errors: what is stated is the way but for noise
    driven = np.hypot(*np.diff(run.final.pose[:, :2], axis=0).T).sum()
    assert np.hypot(*drawn.recorded.increments.mean[:, :2].T).sum() == pytest.approx(driven, rel=0.02)

"""Fixes and closures through the front end: what a run records of them, their gate, hindsight, and other estimators."""

from dataclasses import replace

import numpy as np
import pytest

from data.notice import Code
from data.pose_measurements import FixSource
from data.result import Run
from data.se2 import pose_error
from data.worlds.mixed import Mixed, simulate
from eval.replay.estimators import OPTIONS
from eval.replay.external.adapter import ForeignError, pose_updated_of
from eval.replay.hindsight.localizing_frontend import LocalizingFrontEnd
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Beginning, Setup

SHORT = Mixed(frames=60, closure_gap=5.0, closure_period=1.0, closure_radius=9.0)
OPEN = Setup(gate_poses=None)


def blind(log, task="slam"):
    inputs = log.inputs(labels=True)
    return replace(
        inputs if task == "localization" else inputs.without_map(), observations=inputs.observations.only(slice(0))
    )


def off(run: Run, log):
    return float(np.sqrt(((run.online.pose[:, :2] - log.truth.pose[:, :2]) ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def log():
    return simulate(SHORT, 3)


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("task", ["slam", "localization"])
def test_a_run_records_every_fix_and_every_closure(log, name, task):
    inputs = log.inputs(labels=True)
    with_all, reckoned = compare(inputs, task, [name, "dead-reckoning"], setup=OPEN)
    assert with_all.failure is None
    assert off(with_all, log) < off(reckoned, log)
    assert reckoned.fixes is None is reckoned.closures
    fixes, closures = with_all.fixes, with_all.closures
    assert fixes.used.all()
    assert closures.used.all()
    assert fixes.dof.tolist() == [{0: 2, 1: 1, 2: 3}[k] for k in inputs.fixes.kind.tolist()]
    assert closures.dof.tolist() == [3] * len(inputs.closures)
    for done in (fixes, closures):
        np.testing.assert_allclose(np.nansum(done.white**2, axis=1), done.nis)
        assert np.array_equal(np.isfinite(done.white).sum(axis=1), done.dof)
        assert done.gate is None
    used = int((with_all.decisions >= 0).sum())  # landmark observations have innovations of their own
    assert with_all.total_nis[1] == 2 * used == with_all.innovations.dof.sum()
    assert compare(replace(inputs, fixes=None, closures=None), task, [name])[0].fixes is None


def test_the_gate_leaves_out_what_truth_calls_false():
    log = simulate(replace(SHORT, jumps=True, false_closures=True, outliers=0.1), 5)
    gated, all_used = (compare(log.inputs(labels=True), "localization", ["ekf"], setup=s)[0] for s in (Setup(), OPEN))
    np.testing.assert_array_equal(gated.fixes.used, log.truth.fix_inlier == 1)
    np.testing.assert_array_equal(gated.closures.used, log.truth.closure_inlier == 1)
    assert np.isfinite(gated.fixes.nis).all(), "also of those outside the gate"
    assert off(gated, log) < 0.5 * off(all_used, log)


def test_a_filter_that_fails_leaves_the_rest_blank(log):
    inputs = blind(log)
    covariance = inputs.fixes.covariance.copy()
    late = int(np.searchsorted(inputs.fixes.frame, 30))
    covariance[late] *= -1e6
    (run,) = compare(replace(inputs, fixes=replace(inputs.fixes, covariance=covariance)), "slam", ["ekf"])
    assert (run.failure.status, run.failure.frame) == ("diverged", int(inputs.fixes.frame[late]))
    assert run.fixes.used[:late].all()
    assert np.isnan(run.fixes.nis[late:]).all()
    assert not run.closures.used[inputs.closures.later >= 30].any()


def test_parking_is_off_beside_closures(log):
    inputs = log.inputs(labels=True).without_map()
    setup = Setup(deactivate_after=2.0)
    with_closures, without = (
        step_by_step("ekf", inputs, "slam", setup=setup),
        step_by_step("ekf", replace(inputs, closures=None), "slam", setup=setup),
    )
    assert [n.code for n in with_closures.notes] == [Code.NOT_PARKED]
    assert [n.code for n in without.notes] == [Code.PARKED]
    np.testing.assert_array_equal(
        with_closures.online.pose, step_by_step("ekf", inputs, "slam", setup=Setup()).online.pose
    )


def test_an_estimator_without_the_methods_says_so(log, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\nfrom data.se2 import compose\n"
        "class Mine:\n"
        "    def __init__(self, prior, sensor, known_map, options):\n        self.mean = prior.mean.copy()\n"
        "    def predict(self, increment):\n        self.mean = compose(self.mean, increment.mean)\n"
        "    def update(self, observations, decisions):\n        pass\n"
        "    def estimate(self):\n        return self.mean, 0.01 * np.eye(3)\n"
        "class Fixed(Mine):\n"
        "    def fix(self, fixes, sources, gate):\n        return {'used': fixes.kind == 0}\n"
    )
    inputs = log.inputs(labels=True)
    mine, fixed = compare(inputs, "localization", [f"{path}:Mine", f"{path}:Fixed"])
    unused = {
        run.estimator: dict(next(n for n in run.notes if n.code == Code.POSES_UNUSED).values) for run in (mine, fixed)
    }
    assert unused["Mine"] == {"fixes": len(inputs.fixes), "closures": len(inputs.closures)}
    assert unused["Fixed"] == {"fixes": 0, "closures": len(inputs.closures)}
    assert mine.fixes is None is mine.closures is fixed.closures
    np.testing.assert_array_equal(fixed.fixes.used, inputs.fixes.kind == 0)
    assert np.isnan(fixed.fixes.nis).all()


@pytest.mark.parametrize(("returned", "words"), [
    (3, "int; None, a data.pose_measurements.PoseUpdated"), ({"us": 1}, "PoseUpdated, or a dict"),
    ({"used": np.ones(3, bool)}, r"bool \(2,\) is needed"), ({"nis": np.ones(3)}, "nis"),
])  # fmt: skip
def test_what_an_update_cannot_return_is_said(returned, words):
    with pytest.raises(ForeignError, match=words):
        pose_updated_of("Mine.fix", returned, [2, 3])


@pytest.mark.parametrize("name", ["ekf", pytest.param("isam2", marks=pytest.mark.slow)])
@pytest.mark.parametrize("task", ["slam", "localization"])
def test_hindsight_uses_each_once(task, name):
    log = simulate(replace(SHORT, frames=30, sigma_gps=0.1), 6)
    inputs = log.inputs()
    (run,) = compare(inputs, task, [name], "jcbb-hindsight")
    plain = compare(replace(inputs, fixes=None, closures=None), task, [name], "jcbb-hindsight")[0]
    assert run.failure is None
    assert run.fixes.used.mean() > 0.95
    if name == "ekf" or task == "slam":
        assert run.closures.used.mean() > 0.95
    e = pose_error(run.online.pose, log.truth.pose)
    nees = np.einsum("ni,ni->n", e, np.linalg.solve(run.online.covariance, e[..., None])[..., 0])
    assert nees.mean() < 6.0, "none is used twice"
    assert np.trace(run.online.covariance[-1]) < np.trace(plain.online.covariance[-1])


def test_a_fix_decides_between_hypotheses():
    """Two landmarks that look alike: where the robot is depends on the fix alone."""
    inputs = simulate(SHORT, 2).inputs()
    given = Beginning(inputs.prior, inputs.sensor, inputs.map, fixes=inputs.fixes)
    localizer = LocalizingFrontEnd("ekf", "jcbb-hindsight", given, Setup())
    leader = localizer.bank.members[0]
    other = type(leader)(leader.mean + [3.0, 0.0, 0.0], leader.P.copy(), leader.weight + 1.0)
    localizer.bank.members = [other, leader]
    true = inputs.prior.mean[:2]
    fixes = inputs.fixes.of(0)
    z = fixes.z.copy()
    z[0, :2] = true
    frame = inputs.frame(0)._replace(fixes=replace(fixes, z=z), closures=None)
    localizer.poses._fixes = replace(inputs.fixes, sources=(FixSource("gps"), FixSource("compass")))
    localizer.use_poses(frame)
    assert np.hypot(*(localizer.bank.estimate().mean[:2] - true)) < 0.5

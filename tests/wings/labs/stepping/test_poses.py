"""Fixes and closures of a step: what is printed is what the estimator computed, and the truth is the log's."""

from __future__ import annotations

import numpy as np
import pytest

from data.log import shortened
from data.logs import open_log
from data.pose_measurements import MEASURED, FixKind, expected_fix
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from wings.labs.stepping.command import main
from wings.labs.stepping.text import of_run, poses_block, rows_of, run_text

WORLD = "mixed:7:jumps=true+closure_gap=2+closure_period=1"


def run_of(estimator="ekf", frames=40, gate=0.99, **changes):
    log = shortened(open_log(WORLD), frames)
    inputs = log.inputs(labels=True)
    return log, step_by_step(estimator, inputs, "localization", setup=Setup(gate_poses=gate), **changes)


@pytest.mark.parametrize("estimator", ["ekf", "ekf-iterated", "isam2", "fixed-lag"])
def test_the_first_fixes_innovation_and_covariance_are_those_of_the_prior(estimator):
    log, run = run_of(estimator, frames=2)
    steps, _ = of_run(log, run, 0)
    inputs, mean, P = log.recorded, log.recorded.prior.mean, log.recorded.prior.covariance
    rows = list(MEASURED[FixKind.POSITION])
    z_hat, H = expected_fix(mean, FixKind.POSITION, inputs.fixes.sources[0])
    S = H @ P @ H.T + inputs.fixes.covariance[0][np.ix_(rows, rows)]
    assert (steps[0].name, steps[0].source, steps[0].used) == ("fix 0", "gps", True)
    np.testing.assert_allclose(steps[0].nu, [*(inputs.fixes.z[0, :2] - z_hat), np.nan], atol=1e-12)
    np.testing.assert_allclose(steps[0].S[:2, :2], S, rtol=1e-9)
    assert np.isnan(steps[0].S[2]).all()


@pytest.mark.parametrize("estimator", ["ekf", "isam2"])
def test_nis_is_that_of_the_innovation_and_its_covariance_and_the_gate_decides(estimator):
    log, run = run_of(estimator)
    each = [s for k in range(len(log.recorded)) for s in of_run(log, run, k)[0]]
    closures = [s for s in each if s.ends]
    assert closures
    assert {len(s.ends) for s in each} == {0, 2}
    for s in each:
        m = np.isfinite(s.nu)
        assert s.nu[m] @ np.linalg.solve(s.S[np.ix_(m, m)], s.nu[m]) == pytest.approx(s.nis)
        assert s.used == (s.nis < {1: 6.635, 2: 9.210, 3: 11.345}[s.dof])
    assert {s.decided for s in each} == {"accepted", "rejected"}
    wrong = [s for s in each if s.inlier == 0]
    assert wrong
    assert all(s.right == (not s.used) for s in wrong)


def test_the_rows_are_a_column_per_measurement_with_blanks_where_nothing_is_measured():
    log, run = run_of()
    k = next(k for k in range(40) if len(of_run(log, run, k)[0]) == 3)
    steps, gate = of_run(log, run, k)
    rows = dict(rows_of(steps, gate))
    assert rows["measurement"] == ["fix 0", "fix 1", "closure 0"]
    assert rows["source"] == ["gps", "compass", "loops"]
    assert [bool(cell) for cell in rows["innovation x [m]"]] == [True, False, True]
    assert [bool(cell) for cell in rows["covariance xθ [m rad]"]] == [False, False, True]
    assert rows["gate 0.99"] == ["9.21", "6.63", "11.3"]
    assert rows["frames"][2] == f"{steps[2].ends[0]} to {k}"
    assert "gate 0.99" not in dict(rows_of(steps, None))
    assert poses_block(k, steps, gate).startswith(f"step {k}: 2 fixes and 1 closure\nmeasurement")
    assert poses_block(k, [], gate) == ""


def test_the_walk_prints_them_before_the_observations_and_as_the_run_says(capsys):
    assert main([WORLD, "--frames", "30", "--association", "known", "--run-through", "--gate-poses", "0.99"]) == 0
    out = capsys.readouterr().out
    log, run = run_of(frames=30)
    assert out.split("\n", 1)[1].startswith(run_text(log, run).split("whole run")[0])
    assert out.index("step 0: 2 fixes") < out.index("step 0: 3 observations")
    assert main([WORLD, "--frames", "30", "--association", "known", "--run-through", "--lab-text"]) == 0
    assert "fix" not in capsys.readouterr().out


def test_an_estimator_without_fixes_has_none_and_says_so(capsys, tmp_path):
    (tmp_path / "plain.py").write_text(
        "from ekf.localizer import EkfLocalizer\n"
        "class Plain:\n"
        "    tasks = ('localization',)\n"
        "    def __init__(self, *given):\n"
        "        self.f = EkfLocalizer(*given[:3])\n"
        "    def predict(self, i): self.f.predict(i)\n"
        "    def update(self, o, d): self.f.update(o, d)\n"
        "    def estimate(self): return tuple(self.f.estimate())\n"
    )
    named = f"{tmp_path}/plain.py:Plain"
    assert main([WORLD, "--frames", "5", "--association", "known", "--run-through", "--estimator", named]) == 0
    out = capsys.readouterr().out
    assert "step 0: 3 observations" in out
    assert "step 0: 2 fixes" not in out
    assert "fixes" in out.split("NIS per")[-1]

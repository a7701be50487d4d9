"""Twins of logs with fixes and closures: every source is drawn anew, and a fault of one is put down to it."""

from dataclasses import replace

import numpy as np
import pytest

from data.logs import open_log
from data.pose_measurements import expected_closure, expected_fix
from data.se2 import wrap_angle
from eval.compare import compare
from eval.judgement.causes import side_of
from eval.referee import residuals
from eval.referee.explanations import evidence_of
from eval.referee.sources import of_sources, source_in
from eval.replay.settings import Setup
from eval.studies.diagnosis import _best, with_all_sources
from eval.studies.twins import inputs_of, source_of, twin

NAME = "mixed:{}:frames=60+landmarks=12+closure_gap=10+radius=3+swing=0+closure_radius=1.5+closure_period=1+side=14"


def solved(log):
    inputs = inputs_of(log, "localization", "known")
    (run,) = compare(inputs, "localization", ("batch",), "known")
    return inputs, run


@pytest.fixture(scope="module")
def log():
    return open_log(NAME.format(3))


@pytest.fixture(scope="module")
def source(log):
    return source_of(log, solved(log)[1], (), Setup())


def test_fixes_and_closures_of_twins_scatter_about_the_path_as_stated(source):
    path, fixes, closures = source.path, source.log.recorded.fixes, source.log.recorded.closures
    drawn = [twin(source, seed).recorded for seed in range(60)]
    gps = np.flatnonzero(fixes.source == 0)
    exact = np.array([expected_fix(path[fixes.frame[i]], 0, fixes.sources[0])[0] for i in gps])
    u = np.array([(r.fixes.z[gps, :2] - exact) / 0.3 for r in drawn])
    assert np.abs(u.mean(axis=0)).max() < 5.0 / np.sqrt(len(drawn))
    assert u.var() == pytest.approx(1.0, abs=0.05)
    exact = np.array([expected_closure(path[a], path[b])[0] for a, b in zip(closures.frame1, closures.frame2)])
    u = np.array([r.closures.relative - exact for r in drawn])
    u[..., 2] = wrap_angle(u[..., 2])
    np.testing.assert_allclose(u.std(axis=(0, 1)), np.sqrt(np.diag(closures.covariance[0])), rtol=0.1)
    assert drawn[0].fixes.covariance.tobytes() == fixes.covariance.tobytes()


def test_no_twin_has_outliers_even_if_its_log_has(log):
    bad = open_log(NAME.format(3) + "+jumps+false-closures")
    source = source_of(bad, solved(bad)[1], (), Setup())
    drawn = twin(source, 0)
    used = residuals.Used(np.full(len(drawn.recorded.observations.frame), -1), np.empty((0, 2)), np.empty(0))
    every = replace(used, fixes=drawn.truth.fix_inlier == 1, closures=drawn.truth.closure_inlier == 1)
    assert every.fixes.all()
    assert every.closures.all()
    for of in of_sources(drawn.recorded, source.path, every):
        assert not (of.squared > of.outlying).any()


def blamed(log):
    """The best explanation of a log, and whom the first page names."""
    inputs, run = solved(log)
    run = with_all_sources(run, inputs)
    best = _best(evidence_of(inputs, run.final.pose, residuals.used_by(run, inputs)), run, [])
    return None if best is None else (best[0][0], side_of(best[0][0]))


def with_fixes(log, change):
    fixes = log.recorded.fixes
    return replace(log, recorded=replace(log.recorded, fixes=change(fixes, (fixes.source == 0)[:, None])))


@pytest.mark.slow
def test_a_sound_log_needs_no_explanation(log):
    assert blamed(log) is None


def test_a_bias_of_gps_is_named_with_its_size(log):
    finding, side = blamed(with_fixes(log, lambda f, gps: replace(f, z=f.z + gps * np.array([0.0, 0.6, 0.0]))))
    assert (finding.kind, finding.name, side) == ("systematic", "position:gps/y", "gps")
    assert finding.size == pytest.approx(0.6, abs=4.0 * finding.error)


@pytest.mark.slow
def test_a_sigma_stated_three_times_too_small_is_named_with_its_factor(log):
    finding, side = blamed(
        with_fixes(log, lambda f, gps: replace(f, covariance=np.where(gps[:, None], 1 / 9, 1) * f.covariance))
    )
    assert (finding.kind, finding.name, side) == ("sigma", "position:gps", "gps")
    assert finding.size == pytest.approx(3.0, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("option", "key", "named"), [
    ("jumps", "position:gps", "gps"), ("false-closures", "closure:loops", "loops"),
])  # fmt: skip
def test_outliers_are_counted_and_their_source_is_named(option, key, named):
    bad = open_log(f"{NAME.format(3)}+{option}")
    finding, side = blamed(bad)
    assert (finding.kind, finding.name, side) == ("outliers", key, named)
    inlier = bad.truth.fix_inlier if named == "gps" else bad.truth.closure_inlier
    assert finding.outliers == (inlier == 0).sum()


def test_components_of_sources_are_told_from_all_others():
    assert source_in("position:gps/lever_x") == "gps"
    assert source_in("heading:imu/my_compass") == "imu/my_compass"
    assert source_in("odometry_x_distance") is None
    assert source_in("z1") is None

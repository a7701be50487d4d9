"""The world of several sensors: noise as stated, outliers as truth says, and the arena beneath unchanged."""

import numpy as np
import pytest

from data.logs import open_log
from data.pose_measurements import FixKind, expected_closure, expected_fix
from data.se2 import wrap_angle

SEEDS = range(12)


def squares(log):
    """Squared distances of fixes by source, and of closures, from what the true path says: the stated law."""
    fixes, closures, truth = log.recorded.fixes, log.recorded.closures, log.truth.pose
    found = {}
    for i in range(len(fixes)):
        source = fixes.sources[fixes.source[i]]
        z_hat, _ = expected_fix(truth[fixes.frame[i]], fixes.kind[i], source)
        rows = {0: [0, 1], 1: [2], 2: [0, 1, 2]}[int(fixes.kind[i])]
        off = fixes.z[i][rows] - z_hat
        if fixes.kind[i] != FixKind.POSITION:
            off[-1] = wrap_angle(off[-1])
        found.setdefault(source.name, []).append(off @ np.linalg.solve(fixes.covariance[i][np.ix_(rows, rows)], off))
    for i in range(len(closures)):
        off = closures.relative[i] - expected_closure(truth[closures.frame1[i]], truth[closures.frame2[i]])[0]
        off[2] = wrap_angle(off[2])
        found.setdefault("loops", []).append(off @ np.linalg.solve(closures.covariance[i], off))
    return {name: np.array(values) for name, values in found.items()}


def test_fixes_and_closures_scatter_about_the_true_path_as_stated():
    each = [squares(open_log(f"mixed:{seed}")) for seed in SEEDS]
    for name, dof in (("gps", 2), ("compass", 1), ("loops", 3)):
        pooled = np.concatenate([e[name] for e in each])
        assert abs(pooled.mean() - dof) < 4.0 * np.sqrt(2.0 * dof / len(pooled)), name


@pytest.mark.parametrize(("option", "source", "truth"), [
    ("jumps", "gps", "fix_inlier"), ("false-closures", "loops", "closure_inlier"),
])  # fmt: skip
def test_outliers_are_those_that_the_truth_names(option, source, truth):
    log, sound = open_log(f"mixed:7:{option}"), open_log("mixed:7")
    inlier = getattr(log.truth, truth)
    if truth == "fix_inlier":
        assert inlier[log.recorded.fixes.source == 1].all()
        inlier = inlier[log.recorded.fixes.source == 0]
    far = squares(log)[source] > 30.0
    assert np.array_equal(far, inlier == 0)
    assert far.sum() == max(1, round(0.05 * len(far)))
    assert getattr(sound.truth, truth).all()


def test_beneath_is_the_arena_of_the_same_parameters():
    log, arena = open_log("mixed:3:landmarks=20"), open_log("arena:3:landmarks=20")
    assert np.array_equal(log.truth.pose, arena.truth.pose)
    assert np.array_equal(log.recorded.observations.z, arena.recorded.observations.z)
    assert np.array_equal(log.recorded.increments.mean, arena.recorded.increments.mean)
    assert np.array_equal(log.recorded.prior.mean, arena.recorded.prior.mean)


def test_a_period_of_zero_leaves_a_sensor_out():
    assert open_log("mixed:0:closure_period=0").recorded.closures is None
    assert [s.name for s in open_log("mixed:0:gps_period=0").recorded.fixes.sources] == ["compass"]
    assert open_log("mixed:0:gps_period=0+compass_period=0").recorded.fixes is None

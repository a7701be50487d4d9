"""However gross an error is, the factor that has it is named first: nothing ties where p values underflow."""

import re

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

import slamref
from data.tails import log_below, log_tail
from tests.quick import slow
from wings.audit.command import main
from wings.audit.examined import Scale, shown_tables
from wings.audit.files import optimized

SIGMA = {False: np.array([0.05, 0.05, 0.01]), True: np.array([0.01, 0.01, 0.01, 0.05, 0.05, 0.05])}
POSES, APART = 120, 40


def looped(false, sigmas, seed, *, spatial, together=False):
    """Three rounds with a loop at every fourth pose, `false` further ones off by `sigmas`; graph, guess, false ones."""
    rng, sigma = np.random.default_rng(seed), SIGMA[spatial]
    angle, noise = 6.0 * np.pi * np.arange(POSES) / POSES, gtsam.noiseModel.Diagonal.Sigmas(sigma)
    x, y = 5.0 * np.cos(angle), 5.0 * np.sin(angle)
    if spatial:
        true = [gtsam.Pose3(gtsam.Rot3.Yaw(a), np.array([x[k], y[k], 0.1 * a])) for k, a in enumerate(angle)]
        between, prior, place = gtsam.BetweenFactorPose3, gtsam.PriorFactorPose3, slice(3, 6)
    else:
        true = [gtsam.Pose2(x[k], y[k], a) for k, a in enumerate(angle)]
        between, prior, place = gtsam.BetweenFactorPose2, gtsam.PriorFactorPose2, slice(0, 2)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(prior(0, true[0], noise))
    values.insert(0, true[0])

    def measured(i, j, off=0.0):
        error, way = rng.normal(0.0, sigma), np.zeros(len(sigma))
        way[place] = rng.normal(size=len(way[place]))
        return true[i].between(true[j]).retract(error + off * sigma * way / max(np.linalg.norm(way), 1e-9))

    at = true[0]
    for i in range(POSES - 1):
        step = measured(i, i + 1)
        graph.add(between(i, i + 1, step, noise))
        at = at.compose(step)
        values.insert(i + 1, at)
    for i in range(0, POSES - APART, 4):
        graph.add(between(i, i + APART, measured(i, i + APART), noise))
    graph.add(between(POSES - 1 - 2 * APART, POSES - 1, measured(POSES - 1 - 2 * APART, POSES - 1), noise))
    first, some = graph.size(), rng.choice(POSES - 60, false, replace=False)
    for n in range(false):
        i, j = (20 + n, 75 + n) if together else (int(some[n]), int(some[n]) + int(rng.integers(15, 58)))
        graph.add(between(i, j, measured(i, j, sigmas), noise))
    return graph, values, list(range(first, first + false))


@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize(("false", "together"), [(1, False), slow(3, False), slow(10, False), (3, True)])
@pytest.mark.parametrize("sigmas", [30.0, slow(1e3), 1e6])
def test_the_false_loops_and_no_others_are_wrong_at_the_optimum_that_they_bent_and_at_the_guess(
    sigmas, false, together, spatial
):
    """Seen: an innocent factor named with T = 6982, while a false loop had T = 23 670; and all 136 called wrong."""
    graph, guess, wrong = looped(false, sigmas, 0, spatial=spatial, together=together)
    for values in (optimized(graph, guess), guess):
        report = slamref.audit(graph, values, draws=0)
        assert report.audit.wrong.tolist() == wrong
        assert set(report.worst().index[:false]) == set(wrong)


def test_the_false_loop_is_named_in_words():
    graph, guess, (loop,) = looped(1, 100.0, 1, spatial=True)
    assert f"Factor {loop} " in slamref.audit(graph, optimized(graph, guess), draws=0).words()


def test_the_logarithms_of_both_tails_never_tie():
    x = np.array([1e-12, 1.0, 50.0, 600.0, 1300.0])
    for dof in (1, 2, 3, 6, 12):
        np.testing.assert_allclose(log_tail(x, dof), chi2.logsf(x, dof), rtol=1e-6)
        low = x < 2.0 * dof
        below = np.append(chi2.logcdf(x[low], dof), np.log1p(-chi2.sf(x[~low], dof)))
        np.testing.assert_allclose(log_below(x, dof), below, rtol=1e-6, atol=1e-300)
        far, close = log_tail(np.geomspace(1e-14, 1e15, 400), dof), log_below(np.geomspace(1e-300, 1e-3, 200), dof)
        assert (np.diff(far) < 0.0).all()
        assert np.isfinite(far).all()
        assert (np.diff(close) > 0.0).all()
    near = log_tail(np.linspace(1320.0, 1345.0, 400), 6)  # where the probability underflows
    assert (np.diff(near) < 0.0).all()
    np.testing.assert_allclose(np.diff(near), np.diff(near).mean(), rtol=0.02)


def test_what_a_person_sees_has_neither_rounding_errors_nor_empty_tables_nor_a_p_value_of_zero(tmp_path, capsys):
    """Seen: a redundancy of -2.22e-16, `Empty DataFrame`, and p = 0."""
    (tmp_path / "g.g2o").write_text("EDGE_SE2 0 1 1 0 0\nEDGE_SE2 1 2 1 0 0.1\nEDGE_SE2_XY 2 7 1 2\n")
    assert main([str(tmp_path / "g.g2o"), "--out", str(tmp_path / "out"), "--draws", "0"]) == 0
    text = capsys.readouterr().out + (tmp_path / "out" / "factors.csv").read_text()
    text += (tmp_path / "out" / "components.csv").read_text() + (tmp_path / "out" / "report.html").read_text()
    assert not re.search(r"Empty|DataFrame|\d\.\d+e-\d\d\b|np\.|array\(", text)
    graph, guess, (loop,) = looped(1, 1e6, 0, spatial=False)
    worst = shown_tables(slamref.audit(graph, guess, draws=0))["factors"].set_index("factor")
    assert re.fullmatch(r"\d\.\d{3}e-\d{4,}", worst["p"][loop])


def test_of_wrong_scales_the_one_on_the_side_of_the_misfit_is_told_first():
    x, theta = Scale("x", "odometry", 0.05, 0.002, 0.22), Scale("theta", "odometry", 9.8, 0.4, 3.1)
    assert [max((x, theta), key=lambda s, large=large: s.told(large)) for large in (True, False)] == [theta, x]

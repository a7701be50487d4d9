"""Leverage, redundancy and deleted residuals equal those of a dense solution without the factor."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from hypothesis import given, settings, strategies as st
from scipy.stats import chi2, ncx2

from data.errors import DataError
from tests.quick import examples
from tests.wings.audit import graphs, oracle
from wings.audit.factors import directions, examine, holm, noncentrality
from wings.audit.linear import factorize, linearize, ordering

METRES = {3: [0, 1], 6: [3, 4, 5]}


def examined(graph, values):
    system = linearize(graph, values)
    f = factorize(system, ordering(system))
    seen = directions(f)
    return system, f, seen, examine(f, seen, [np.array(METRES.get(int(d), []), int) for d in system.dim])


def check(graph, values):
    system, f, _, t = examined(graph, values)
    parts = oracle.rows(graph, values)
    _x, C, _, rank = oracle.solve(parts)
    assert f.rank == rank
    whole = np.vstack([np.sqrt(w) * A for A, _, w in parts])
    s = np.linalg.svd(whole / np.sqrt((whole**2).sum(0) + 1e-300), compute_uv=False)
    loss = 1e-13 / s[s > oracle.RANK * s[0]].min() ** 2  # of double precision, where a variable is hardly determined
    assert np.nansum(t.redundancy) == pytest.approx(system.rows - rank, abs=1e-8)
    for i, (A, r, w) in enumerate(parts):
        R = np.eye(len(r)) - w * A @ C @ A.T
        assert t.redundancy[i] == pytest.approx(np.trace(R), abs=1e-8 + loss)
        assert t.chi2[i] == pytest.approx(r @ r, rel=1e-10)
        T, freedom = oracle.deleted(parts, i)
        if freedom == t.rank[i]:  # else a redundancy at the limit
            seen = np.linalg.eigvalsh(R)  # T divides by it: a small redundancy magnifies rounding of both solutions
            least = min(seen[seen > 1e-6], default=1.0)
            assert t.deleted[i] == pytest.approx(T, rel=1e-8 + 1e-9 / least + loss, abs=1e-8 + loss)
        else:
            smallest = np.abs(np.linalg.eigvalsh(R))  # one that should be zero is rounding, of either sign
            assert ((smallest > 1e-9) & (smallest < 1e-4 + loss)).any()


@settings(max_examples=examples(100), deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_in_the_plane(seed):
    check(*graphs.planar(seed))


@settings(max_examples=examples(80), deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_in_space(seed):
    check(*graphs.spatial(seed))


@settings(max_examples=examples(20), deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_inertial(seed):
    check(*graphs.inertial(seed))


def chain(loops=True, sigma=0.1):
    noise = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
    graph, values, rng = gtsam.NonlinearFactorGraph(), gtsam.Values(), np.random.default_rng(0)
    for k in range(8):
        values.insert(X(k), gtsam.Pose2(k, 0, 0))
        if k:
            z = gtsam.Pose2(1, 0, 0).retract(rng.normal(0, sigma, 3))
            graph.add(gtsam.BetweenFactorPose2(X(k - 1), X(k), z, noise))
    if loops:
        graph.add(gtsam.BetweenFactorPose2(X(0), X(5), gtsam.Pose2(5, 0.3, 0), noise))
        graph.add(gtsam.BetweenFactorPose2(X(2), X(7), gtsam.Pose2(5, 0, 0.1), noise))
    return graph, gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()


def test_influence_is_that_of_a_solution_without_the_factor():
    graph, values = chain()
    _system, f, _seen, t = examined(graph, values)
    parts = oracle.rows(graph, values)
    anchor = [A for A, *_ in parts]
    anchored = np.zeros((3, anchor[0].shape[1]))
    last = max(f.dropped) // 3  # the pose that keeps its value
    variable = int(np.flatnonzero(f.at == 3 * last)[0])
    anchored[:, 3 * variable : 3 * variable + 3] = 1e3 * np.eye(3)
    parts.append((anchored, np.zeros(3), 1.0))
    x0 = oracle.solve(parts)[0].reshape(-1, 3)
    for i in range(graph.size()):
        x, _, N, _ = oracle.solve(parts, i)
        if not N.shape[1]:
            assert t.moved[i] == pytest.approx(np.hypot(*(x.reshape(-1, 3) - x0)[:, :2].T).max(), rel=1e-6)


def test_a_chain_without_loops_checks_nothing():
    _, _, _, t = examined(*chain(loops=False))
    assert np.allclose(t.redundancy, 0.0, atol=1e-9)
    assert (t.rank == 0).all()
    assert np.isnan(t.log_p).all()
    assert np.isinf(t.minimal_error).all()


def test_a_minimal_error_is_found_with_the_stated_power_and_missed_it_moves_its_own_poses_as_stated():
    graph, values = chain()
    system, f, seen, t = examined(graph, values)
    s, g, i = seen[0], system.groups[0], 7
    k = int(np.argmin(np.where(s.R[i] > 0, s.R[i] ** 2 * s.gain[i], np.inf)))
    shift = s.R[i, k] * t.minimal_error[i] * s.V[i, :, k]
    assert ncx2.sf(chi2.isf(1e-3, t.rank[i]), t.rank[i], s.tested(shift[None, :, None].repeat(len(s.h), 0))[i, 0]) == (
        pytest.approx(0.8, abs=1e-6)
    )
    assert noncentrality(1) == pytest.approx(17.075, abs=1e-3)  # Baarda
    parts = oracle.rows(graph, values)
    first = 3 * int(np.flatnonzero(f.at == max(f.dropped) // 3 * 3)[0])
    A = np.vstack([A for A, *_ in parts])
    keep = np.setdiff1d(np.arange(A.shape[1]), np.arange(first, first + 3))
    e = np.zeros(len(A))
    e[3 * i : 3 * i + 3] = t.minimal_error[i] * s.V[i, :, k]
    x = np.zeros(A.shape[1])
    x[keep] = np.linalg.lstsq(A[:, keep], e, rcond=None)[0]
    assert t.missed[i] == pytest.approx(np.hypot(*x.reshape(-1, 3)[g.variables[i], :2].T).max(), rel=1e-6)


def test_weak_priors_keep_leverages_exact_and_constraints_are_exact():
    graph, values = chain()
    _, _, _, free = examined(graph, values)
    graph.add(gtsam.PriorFactorPose2(X(0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e5)))
    _, _, _, t = examined(graph, values)
    assert np.allclose(t.redundancy[:-1], free.redundancy, atol=1e-9)
    graph, values = chain()
    graph.add(gtsam.PriorFactorPose2(X(0), values.atPose2(X(0)), gtsam.noiseModel.Constrained.All(3)))
    graph.add(
        gtsam.PriorFactorPose2(X(4), values.atPose2(X(4)).retract(np.ones(3)), gtsam.noiseModel.Constrained.All(3))
    )
    system, f, _, t = examined(graph, values)
    assert np.allclose(t.redundancy[-2:], 0.0, atol=1e-6)
    assert np.nansum(t.redundancy) == pytest.approx(system.rows - f.rank, abs=1e-6)


def test_empty_slots_keep_their_number():
    graph, values = chain()
    before = examined(graph, values)[3]
    graph.remove(8)
    _, _, _, t = examined(graph, values)
    assert np.isnan(t.chi2[8])
    assert t.chi2[7] == before.chi2[7]


def test_holm_of_few():
    assert np.exp(holm(np.log([0.01, np.nan, 0.04, 0.03])))[0] == pytest.approx(0.03)
    assert np.exp(holm(np.log([0.01, np.nan, 0.04, 0.03])))[2:] == pytest.approx([0.06, 0.06])


@pytest.mark.parametrize(("to", "x", "named"), [(99, 0.0, "factor 9: x99 has no value"), (3, np.nan, "factor 9")])
def test_a_variable_without_value_or_a_residual_that_is_not_finite_is_named(to, x, named):
    graph, values = chain()
    graph.add(gtsam.BetweenFactorPose2(X(0), X(to), gtsam.Pose2(x, 0, 0), gtsam.noiseModel.Unit.Create(3)))
    with pytest.raises(DataError, match=named):
        examined(graph, values)


def test_a_factor_that_its_robust_noise_ignores_is_tested_with_its_stated_noise():
    graph, values = chain()
    far = gtsam.BetweenFactorPose2(X(1), X(6), gtsam.Pose2(9, 0, 0), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    tukey = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Tukey.Create(2.0), far.noiseModel())
    plain = gtsam.NonlinearFactorGraph(graph)
    graph.add(far.cloneWithNewNoiseModel(tukey))
    _, _, _, t = examined(graph, values)
    _, _, _, without = examined(plain, values)
    assert np.allclose(t.deleted[:9], without.deleted, atol=1e-6)
    assert t.deleted[9] == pytest.approx(oracle.deleted(oracle.rows(graph, values), 9)[0], rel=1e-6)
    assert t.log_p[9] < np.log(1e-20)

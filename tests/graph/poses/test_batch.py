"""The optimum of a pose graph against dense algebra, and against loop closures that are false."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from data.se2 import dead_reckoned, pose_error
from graph.optimum import NotConvergedError
from graph.poses import batch, robust
from graph.poses.batch import CAUCHY, CUT, HUBER, evaluate, smooth_poses
from graph.poses.robust import gnc_poses, squares
from tests.graph.poses.worlds import corridors, random_false, structured_false


def dense_residuals(world, prior, flat):
    """All whitened residuals, SE(2) as complex numbers: x + iy is V(w) v with V = (e^iw - 1) / iw for the logarithm."""
    pose = flat.reshape(-1, 3)
    out = [np.linalg.inv(np.linalg.cholesky(prior)) @ (pose[0] - world.truth[0])]
    chain = zip(range(len(pose) - 1), range(1, len(pose)), world.motion[1:], world.covariance[1:])
    at, turn = pose[:, 0] + 1j * pose[:, 1], np.exp(1j * pose[:, 2])
    for a, b, m, C in [*chain, *zip(*world[3:])]:
        start = np.exp(1j * m[2])
        w = np.angle(turn[b] / turn[a] / start)
        t = ((at[b] - at[a]) / turn[a] - (m[0] + 1j * m[1])) / start
        v = t * 1j * w / (np.exp(1j * w) - 1.0) if w else t
        B = np.array([[start.real, -start.imag, 0.0], [start.imag, start.real, 0.0], [0.0, 0.0, 1.0]])
        out.append(np.linalg.solve(np.linalg.cholesky(B.T @ C @ B), [v.real, v.imag, w]))
    return np.concatenate(out)


def dense_jacobian(world, prior, flat):
    steps = 1e-6 * np.eye(len(flat))
    return np.array(
        [(dense_residuals(world, prior, flat + s) - dense_residuals(world, prior, flat - s)) / 2e-6 for s in steps]
    ).T


def start(world):
    return dead_reckoned(world.truth[0], world.motion)


def test_optimum_and_covariances_are_those_of_dense_least_squares():
    world = corridors(3, 10, loops=6, side=1.5, blocks=1)._replace(key1=np.array([0, 2, 5]), key2=np.array([6, 9, 8]))
    rng = np.random.default_rng(0)
    world = world._replace(relative=rng.normal(0, 0.5, (3, 3)), loop_covariance=np.tile(0.04 * np.eye(3), (3, 1, 1)))
    root = rng.normal(0, 0.1, (3, 3))
    prior = root @ root.T
    found = smooth_poses(world.problem(prior), start(world))
    r, J = dense_residuals(world, prior, found.pose.ravel()), dense_jacobian(world, prior, found.pose.ravel())
    P = np.linalg.inv(J.T @ J)
    assert np.abs(P @ J.T @ r / np.sqrt(np.diag(P))).max() < 1e-4
    assert found.cost == pytest.approx(r @ r, rel=1e-9)
    assert found.dof == len(r) - len(found.pose) * 3 == 9
    for k in range(10):
        own = P[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        np.testing.assert_allclose(found.covariance[k], own, rtol=1e-4, atol=1e-5 * np.abs(own).max())


def test_a_first_pose_that_is_known_exactly_stays_and_has_no_covariance():
    world = corridors(0, 60, loops=20, blocks=1)
    found = smooth_poses(world.problem(), start(world) + 0.3)
    np.testing.assert_allclose(found.pose[0], world.truth[0], atol=1e-12)
    assert np.abs(found.covariance[0]).max() == 0.0
    assert np.linalg.eigvalsh(found.covariance[1:]).min() > 0.0


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_a_robust_optimum_is_where_the_sum_of_losses_is_least_and_converges_from_afar(loss):
    world = corridors(1, 80, loops=30, drift=3.0, blocks=1)
    problem = world.problem()
    found = smooth_poses(problem, start(world), loss=loss)

    def cost(pose):
        square = (problem.residuals(pose) ** 2).sum(1)
        d = np.sqrt(square[79:])
        if loss == "huber":
            loops = np.where(d < HUBER, d**2, 2.0 * HUBER * d - HUBER**2)
        else:
            loops = CAUCHY**2 * np.log1p(np.minimum(d, CUT) ** 2 / CAUCHY**2)
        return square[:79].sum() + loops.sum()

    assert found.cost == pytest.approx(cost(found.pose), rel=1e-9)
    rng = np.random.default_rng(0)
    sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    for _ in range(20):
        step = 1e-4 * sigma * rng.normal(0, 1, found.pose.shape)
        assert abs(cost(found.pose + step) - cost(found.pose - step)) < 1e-7
        assert cost(found.pose + 1000 * step) > found.cost
    assert found.last_step < 1e-3


@pytest.mark.parametrize("false", [random_false, structured_false])
def test_as_many_false_loop_closures_as_half_the_true_ones_change_the_robust_paths_by_less_than_5_percent(false):
    before = {"gaussian": [], "cauchy": [], "gnc": []}
    after = {"gaussian": [], "cauchy": [], "gnc": []}
    for seed in range(2):
        world = corridors(seed, 110, loops=50, drift=3.0, blocks=2)
        wrong = world.with_loops(*false(world, np.random.default_rng(seed), 25))
        for w, errors in ((world, before), (wrong, after)):
            for loss in ("gaussian", "cauchy"):
                errors[loss].append(world.rmse(smooth_poses(w.problem(), start(w), loss=loss).pose))
            found, believed = gnc_poses(w.problem(), start(w))
            errors["gnc"].append(world.rmse(found.pose))
            assert not believed[50:].any()
            assert (found.weight == believed).all()
            assert believed[:50].mean() > 0.9
    for loss in ("cauchy", "gnc"):
        np.testing.assert_allclose(after[loss], before[loss], rtol=0.05)
    assert min(after["gaussian"]) > 5.0 * max(before["gaussian"])


def test_from_some_of_the_right_loops_all_of_them_are_found(monkeypatch):
    world = corridors(0, 110, loops=50, drift=3.0, blocks=2)
    wrong = world.with_loops(*random_false(world, np.random.default_rng(0), 25))
    problem, n = wrong.problem(), len(world.key1)
    some = np.arange(len(wrong.key1)) % 2 == 0
    some[n:] = False
    monkeypatch.setattr("graph.poses.robust._graduate", lambda problem, pose, threshold: (pose, some, 0))
    found, believed = gnc_poses(problem, start(wrong))
    assert believed[:n].mean() > 0.9
    assert not believed[n:].any()
    assert ((squares(problem, found.pose) < chi2.ppf(0.99, 3)) == believed).all()


def counted_step(problem, pose, weight, monkeypatch):
    """Where a step of GNC leads; how often it looks at the cost is counted, so that it has an end in any case."""
    asked = []

    def counted(problem, pose, loss):
        asked.append(pose)
        assert len(asked) < 30, "no end to the search for a shorter step"
        return evaluate(problem, pose, loss)

    monkeypatch.setattr(robust, "evaluate", counted)
    return robust._step(problem, pose, weight)


@pytest.mark.parametrize(("seed", "share"), [(205, 1.0), (226, 0.5), (288, 0.5), (262, 0.25), (372, 0.25)])
def test_a_step_of_gnc_that_leads_too_far_is_halved_until_the_cost_falls(seed, share, monkeypatch):
    """Far from the optimum; what the cost is of any part of the step is said by dense residuals."""
    world = corridors(3, 10, loops=6, side=1.5, blocks=1)._replace(key1=np.array([0, 2, 5]), key2=np.array([6, 9, 8]))
    rng = np.random.default_rng(seed)
    world = world._replace(relative=rng.normal(0, 0.5, (3, 3)), loop_covariance=np.tile(0.04 * np.eye(3), (3, 1, 1)))
    weight = rng.uniform(0.0, 1.0, 3)
    pose = world.truth + rng.normal(0, [1.0, 1.0, 1.5], world.truth.shape)
    pose[0] = world.truth[0]
    problem = world.problem()

    def cost(pose):
        square = dense_residuals(world, np.eye(3), pose.ravel()).reshape(-1, 3) ** 2
        return float(square[:-3].sum() + weight @ square[-3:].sum(axis=1))

    moved = counted_step(problem, pose, weight, monkeypatch)
    delta = problem.step(pose, weight).delta
    np.testing.assert_allclose(moved, pose + share * delta, atol=1e-12)
    assert cost(moved) < cost(pose)
    assert share == 1.0 or cost(pose + 2.0 * share * delta) > cost(pose)


def test_a_step_of_gnc_from_the_optimum_leads_nowhere(monkeypatch):
    """Key poses in a row, each where it was measured: no cost is below none."""
    world = corridors(0, 10, loops=0, side=1.5, blocks=1)
    truth = np.zeros((10, 3))
    truth[:, 0] = np.arange(10)
    motion = np.diff(truth, axis=0, prepend=0.0)
    chain = world._replace(truth=truth, motion=motion, **{name: getattr(world, name)[:0] for name in world._fields[3:]})
    closed = chain._replace(
        key1=np.array([0]), key2=np.array([9]), relative=truth[9:], loop_covariance=0.01 * np.eye(3)[None]
    )
    for w in (chain, closed):
        moved = counted_step(w.problem(), truth, np.ones(len(w.key1)), monkeypatch)
        np.testing.assert_array_equal(moved, truth)


def test_a_search_that_is_cut_short_is_said_not_to_have_converged(monkeypatch):
    world = corridors(0, 60, loops=20, drift=3.0, blocks=1)
    monkeypatch.setattr(batch, "MOST", 1)
    with pytest.raises(NotConvergedError, match=r"after 1 steps .* sigma are left at key pose \d+, cost"):
        smooth_poses(world.problem(), start(world))


def test_a_chain_without_loops_is_its_dead_reckoning_and_bad_starts_are_refused():
    world = corridors(0, 30, loops=0, blocks=1)
    chain = world._replace(**{name: getattr(world, name)[:0] for name in world._fields[3:]})
    found = smooth_poses(chain.problem(), chain.truth)
    np.testing.assert_allclose(pose_error(found.pose, start(chain)), 0.0, atol=1e-9)
    assert gnc_poses(chain.problem(), chain.truth)[0].cost == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ValueError, match="not a finite pose"):
        smooth_poses(chain.problem(), np.full((30, 3), np.nan))
    with pytest.raises(ValueError, match="'tukey'; known: gaussian"):
        smooth_poses(chain.problem(), chain.truth, loss="tukey")


@pytest.mark.slow
@pytest.mark.parametrize("false", [random_false, structured_false])
def test_as_many_false_loop_closures_as_true_ones_do_no_more(false):
    errors = []
    for seed in range(6):
        world = corridors(seed, 300, loops=120, drift=3.0, blocks=2)
        wrong = world.with_loops(*false(world, np.random.default_rng(seed), len(world.key1)))
        errors.append(
            [
                [w.rmse(smooth_poses(w.problem(), start(w), loss="cauchy").pose) for w in (world, wrong)],
                [w.rmse(gnc_poses(w.problem(), start(w))[0].pose) for w in (world, wrong)],
            ]
        )
    clean, changed = np.sqrt(np.mean(np.square(errors), axis=0)).T
    np.testing.assert_allclose(changed, clean, rtol=0.05)

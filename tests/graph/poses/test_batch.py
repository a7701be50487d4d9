"""The optimum of a pose graph against dense algebra, and against loop closures that are false."""

from __future__ import annotations

import numpy as np
import pytest

from data.se2 import dead_reckoned, pose_error
from graph import batch
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
    found = world.optimum(start(world), prior)
    r, J = (
        dense_residuals(world, prior, found.trajectory.pose.ravel()),
        dense_jacobian(world, prior, found.trajectory.pose.ravel()),
    )
    P = np.linalg.inv(J.T @ J)
    assert np.abs(P @ J.T @ r / np.sqrt(np.diag(P))).max() < 1e-4
    assert found.cost == pytest.approx(r @ r, rel=1e-9)
    assert found.dof == len(r) - len(found.trajectory.pose) * 3 == 9
    for k in range(10):
        own = P[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        np.testing.assert_allclose(found.trajectory.covariance[k], own, rtol=1e-4, atol=1e-5 * np.abs(own).max())


def test_a_first_pose_that_is_known_exactly_stays_and_has_no_covariance():
    world = corridors(0, 60, loops=20, blocks=1)
    found = world.optimum(start(world)).trajectory
    np.testing.assert_allclose(found.pose[0], world.truth[0], atol=1e-12)
    assert np.abs(found.covariance[0]).max() == 0.0
    assert np.linalg.eigvalsh(found.covariance[1:]).min() > 0.0


@pytest.mark.parametrize("false", [random_false, structured_false])
def test_as_many_false_loop_closures_as_half_the_true_ones_change_the_robust_paths_by_less_than_5_percent(false):
    before = {"gaussian": [], "cauchy": [], "gnc": []}
    after = {"gaussian": [], "cauchy": [], "gnc": []}
    for seed in range(2):
        world = corridors(seed, 110, loops=50, drift=3.0, blocks=2)
        wrong = world.with_loops(*false(world, np.random.default_rng(seed), 25))
        for w, errors in ((world, before), (wrong, after)):
            for loss in ("gaussian", "cauchy"):
                errors[loss].append(world.rmse(w.optimum(start(w), loss=loss).trajectory.pose))
            found, believed = w.graduated(start(w))
            errors["gnc"].append(world.rmse(found.trajectory.pose))
            assert not believed[50:].any()
            assert believed[:50].mean() > 0.9
    for loss in ("cauchy", "gnc"):
        np.testing.assert_allclose(after[loss], before[loss], rtol=0.05)
    assert min(after["gaussian"]) > 5.0 * max(before["gaussian"])


def test_from_cauchys_optimum_on_closures_far_off_have_no_weight(monkeypatch):
    world = corridors(0, 110, loops=50, drift=3.0, blocks=2)
    wrong = world.with_loops(*structured_false(world, np.random.default_rng(0), 50))
    cut = wrong.optimum(start(wrong), loss="cauchy")
    monkeypatch.setattr(batch, "CUT", np.inf)
    whole = wrong.optimum(start(wrong), loss="cauchy")
    none_false = world.optimum(start(world), loss="cauchy").trajectory.pose
    off = [np.abs(pose_error(each.trajectory.pose, none_false)).max() for each in (cut, whole)]
    assert off[0] < 0.2 * off[1]
    for found in (cut, whole):  # no gate rejects any
        assert found.closures.used.all()


def test_a_chain_without_loops_is_its_dead_reckoning_and_bad_starts_are_refused():
    world = corridors(0, 30, loops=0, blocks=1)
    chain = world._replace(**{name: getattr(world, name)[:0] for name in world._fields[3:]})
    found = chain.optimum(chain.truth)
    np.testing.assert_allclose(pose_error(found.trajectory.pose, start(chain)), 0.0, atol=1e-9)
    with pytest.raises(ValueError, match="not a finite pose"):
        chain.optimum(np.full((30, 3), np.nan))

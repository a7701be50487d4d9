"""What all other pairings of a frame say about one, and what the observations of a landmark say about it."""

import numpy as np
import pytest

from association.conditional import conditional_expectation, conditional_innovations, jcbb_conditional
from association.expectation import Expectation, SingularInnovationError
from association.jcbb import jcbb
from data.result import DISCARD, NEW
from tests.association.problems import problem

GATE, NEW_GATE = 0.99, 0.99999
EYE = np.eye(2)


def turned(sigma=0.035, turn=0.0, noise=0.01, shift=None):
    """Eight points around a robot whose heading has this sigma [rad] and is off by `turn`; noise [m] of a point."""
    angle = np.linspace(-1.5, 1.5, 8)
    z_hat = np.stack([np.cos(angle), np.sin(angle)], 1) * np.array([2.0, 3.0, 4.0, 5.0] * 2)[:, None]
    across = np.stack([-z_hat[:, 1], z_hat[:, 0]], 1).reshape(-1, 1)
    joint = sigma**2 * across @ across.T + noise**2 * np.eye(16)
    z = z_hat + turn * across.reshape(-1, 2)
    if shift is not None:
        z[shift[0]] += shift[1]
    return Expectation.from_arrays(z, z_hat, joint, np.tile(noise**2 * EYE, (8, 1, 1)))


@pytest.mark.parametrize("seed", range(4))
def test_an_innovation_given_the_others_is_that_of_conditioning_on_them(seed):
    e = problem(seed, 5, 5, clutter=0.0)
    every = np.arange(5)
    S = e.joint(every)
    for i in range(5):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += e.R[i]
    nu = e.residual(e.z, e.z_hat).ravel()
    found = conditional_innovations(e, every, every)
    for j in range(5):
        own, rest = np.arange(2 * j, 2 * j + 2), np.delete(np.arange(10), [2 * j, 2 * j + 1])
        gain = S[np.ix_(own, rest)] @ np.linalg.inv(S[np.ix_(rest, rest)])
        innovation, covariance = nu[own] - gain @ nu[rest], S[np.ix_(own, own)] - gain @ S[np.ix_(rest, own)]
        np.testing.assert_allclose(found.innovation[j], innovation, atol=1e-9)
        np.testing.assert_allclose(found.information[j], np.linalg.inv(covariance), rtol=1e-7, atol=1e-6)
        assert found.distance[j] == pytest.approx(innovation @ np.linalg.inv(covariance) @ innovation)


def test_a_singular_joint_covariance_is_named():
    e = Expectation.from_arrays([[0.0, 0.0]], [[0.0, 0.0]], np.zeros((2, 2)), np.zeros((1, 2, 2)), number=np.array([7]))
    with pytest.raises(SingularInnovationError, match=r"\[7\] is singular"):
        conditional_innovations(e, np.array([0]), np.array([0]))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_given_the_pairings_is_what_a_linear_update_expects(seed):
    e = problem(seed, 4, 6, clutter=0.0)
    decisions = np.array([2, NEW, 0, DISCARD])
    rows, chosen = np.array([0, 2]), np.array([2, 0])
    H = np.zeros((4, 12))
    for k, c in enumerate(chosen):
        H[2 * k : 2 * k + 2, 2 * c : 2 * c + 2] = EYE
    P, R = e.joint(np.arange(6)), np.zeros((4, 4))
    R[:2, :2], R[2:, 2:] = e.R[0], e.R[2]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    mean = e.z_hat.ravel() + K @ (e.z[rows] - e.z_hat[chosen]).ravel()
    after = P - K @ H @ P
    some = np.array([5, 2, 1])
    g = conditional_expectation(e, decisions, some)
    index = (2 * some[:, None] + np.arange(2)).ravel()
    assert g.number.tolist() == some.tolist()
    np.testing.assert_allclose(g.z_hat.ravel(), mean[index], atol=1e-12)
    np.testing.assert_allclose(g.joint(np.arange(3)), after[np.ix_(index, index)], atol=1e-12)
    np.testing.assert_allclose(g.HPHt[1], after[4:6, 4:6], atol=1e-12)


def test_a_common_error_outside_every_single_gate_hides_nothing():
    e = turned(turn=4.0 * 0.035)
    assert (jcbb(e, GATE) >= 0).sum() <= 1
    assert jcbb_conditional(e, GATE, NEW_GATE)[0].tolist() == list(range(8))


def test_a_step_aside_that_passes_the_joint_test_is_undone_and_founds_a_landmark():
    e = turned(shift=(3, np.array([0.05, 0.03])))
    assert jcbb(e, GATE)[3] == 3
    decisions, complete, *_ = jcbb_conditional(e, GATE, 0.999)
    assert complete
    assert decisions.tolist() == [0, 1, 2, NEW, 4, 5, 6, 7]
    assert jcbb_conditional(e, GATE, NEW_GATE)[0][3] == DISCARD

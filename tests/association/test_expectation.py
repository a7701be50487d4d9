"""What is said of pairings with an expectation: their innovations together, and the likelihood of these."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from association.expectation import Expectation, SingularInnovationError
from tests.association.problems import problem


@pytest.mark.parametrize("pairs", [[(0, 2)], [(2, 0), (0, 3)], [(0, 1), (1, 3), (3, 0)]])
def test_the_likelihood_of_pairings_is_their_joint_gaussian_density(pairs):
    e = problem(11, 4, 5)
    rows, chosen = np.array(pairs).T
    nis, dof, likelihood = e.innovation_statistics(rows, chosen)
    full, S = e.joint(np.arange(5)), np.empty((2 * len(pairs),) * 2)
    for a, (i, j) in enumerate(pairs):
        for b, (_, k) in enumerate(pairs):
            S[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] = full[2 * j : 2 * j + 2, 2 * k : 2 * k + 2] + (a == b) * e.R[i]
    nu = np.concatenate([e.z[i] - e.z_hat[j] for i, j in pairs])
    assert dof == 2 * len(pairs)
    assert nis == pytest.approx(nu @ np.linalg.inv(S) @ nu)
    assert likelihood == pytest.approx(multivariate_normal.logpdf(nu, np.zeros(dof), S))


def test_pairings_that_cannot_differ_are_an_error_that_names_their_landmarks():
    e = Expectation.from_arrays(
        np.zeros((2, 2)), np.zeros((2, 2)), np.tile(np.eye(2), (2, 2)), np.zeros((2, 2, 2)), number=np.array([4, 7])
    )
    with pytest.raises(SingularInnovationError, match=r"landmarks \[7, 4\] is singular"):
        e.innovation_statistics(np.array([0, 1]), np.array([1, 0]))

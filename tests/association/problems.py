"""Association problems for the tests, and an exhaustive search to compare branch and bound with."""

import itertools

import numpy as np
from scipy.stats import chi2

from association.expectation import Expectation

GATE = 0.99


def problem(seed, m, n, *, ambiguity=1.0, clutter=0.2, correlation=1.0, sigma=0.1, **more):
    """m observations, n candidates in Cartesian coordinates, with a common error; `ambiguity`: how many sigma apart."""
    rng = np.random.default_rng(seed)
    side = max(n, 1) ** 0.5 * sigma * (1.0 + 3.0 / ambiguity if ambiguity else 0.0)
    z_hat = rng.uniform(0.0, side, (n, 2))
    A = rng.normal(0.0, sigma, (2 * n, 2 * n + 2)) / np.sqrt(2 * n + 2)
    common = np.tile(np.eye(2), (n, 1)) * sigma * correlation
    joint = A @ A.T + common @ common.T
    error = np.linalg.cholesky(joint + 1e-12 * np.eye(2 * n)) @ rng.normal(size=2 * n) if n else np.empty(0)
    seen = z_hat + error.reshape(n, 2)
    noise = 0.3 * sigma * rng.uniform(0.5, 1.5, (m, 2, 2))
    R = noise @ noise.transpose(0, 2, 1) + (0.1 * sigma) ** 2 * np.eye(2)
    z = rng.uniform(0.0, max(side, sigma), (m, 2))
    order = rng.permutation(n)
    for i in range(m):
        if i < n and rng.random() > clutter:
            z[i] = seen[order[i]] + np.linalg.cholesky(R[i]) @ rng.normal(size=2)
    return Expectation.from_arrays(z, z_hat, joint, R, **more)


def joint_distances(e, hypotheses):
    """Squared joint distance of hypotheses (h, k, 2) of (observation, candidate) pairs, by the inverse."""
    h, k, _ = hypotheses.shape
    full = e.joint(np.arange(len(e.number)))
    obs, cand = hypotheses[..., 0], hypotheses[..., 1]
    nu = e.residual(e.z[obs], e.z_hat[cand]).reshape(h, 2 * k)
    rows = (2 * cand[..., None] + np.arange(2)).reshape(h, 2 * k)
    S = full[rows[:, :, None], rows[:, None, :]]
    for a in range(k):
        S[:, 2 * a : 2 * a + 2, 2 * a : 2 * a + 2] += e.R[obs[:, a]]
    return np.einsum("hi,hi->h", nu, np.linalg.solve(S, nu[..., None])[..., 0])


def exhaustive(e, gate=GATE):
    """Pairings and squared joint distance of the best one-to-one hypothesis, by looking at all of them."""
    m, n = len(e.z), len(e.number)
    single = {(i, j) for i in range(m) for j in range(n) if e.frame[j] == e.observed_frame[i]}
    if gate is not None:
        single = {p for p in single if joint_distances(e, np.array([[p]]))[0] < chi2.ppf(gate, 2)}
    for k in range(min(m, n), 0, -1):
        hypotheses = [
            list(zip(some, who))
            for some in itertools.combinations(range(m), k)
            for who in itertools.permutations(range(n), k)
            if all(p in single for p in zip(some, who))
        ]
        if hypotheses:
            d2 = joint_distances(e, np.array(hypotheses))
            if gate is None or d2.min() < chi2.ppf(gate, 2 * k):
                return k, d2.min()
    return 0, 0.0


def distance_of(e, decisions):
    pairs = [(i, int(np.flatnonzero(e.number == d)[0])) for i, d in enumerate(decisions) if d >= 0]
    return (len(pairs), joint_distances(e, np.array([pairs]))[0]) if pairs else (0, 0.0)


def shuffled(e, order):
    order = np.asarray(order, np.int64)
    full = e.joint(np.arange(len(e.number)))
    rows = (2 * order[:, None] + np.arange(2)).ravel()
    return Expectation.from_arrays(
        e.z, e.z_hat[order], full[np.ix_(rows, rows)], e.R, e.residual,
        number=e.number[order], frame=e.frame[order], observed_frame=e.observed_frame,
    )  # fmt: skip

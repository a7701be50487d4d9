"""Variance components: by which factor the stated variances of each kind of factor are wrong.

With the residuals r of kind k, its component is  theta_k = r_k' r_k / trace R_k,  the almost-unbiased estimate
(Förstner, "Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten", AVN 86, 1979), repeated with the weights
that follow. Its fixed point is that of restricted maximum likelihood and of Rao's MINQUE. Near it a step of Fisher's
scoring,  S theta = q,  S_kl = tr(R D_k R D_l),  converges faster; 2 S^-1 is the covariance. S is estimated by probes of
random signs (Hutchinson, Communications in Statistics 18, 1989), whose relative error is below sqrt(2 / probed rows).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.tails import log_below, log_tail
from wings.audit.linear import PART, Factored, factorize, solved, step

ROWS = 6000  # probed rows of an axis: 2 % of the entries of S
MOST, POOLED = 12, 2  # iterations; those where axes share a component: if they differ there is no fixed point
CLOSE = 0.3  # change in standard errors that ends them
NEAR = 0.02  # least step of scoring
SMALLEST, NONE = 1e-8, 0.5  # least component; redundancy below which there is no estimate
ZERO = 1e-8  # sum of squares over redundancy below which residuals are zero: nothing was drawn, or it is stated twice
VAGUE = 1e-4  # leverage of a row below which a sigma that is too large spoils nothing


@dataclass(frozen=True, eq=False)
class Components:
    """Arrays (K,): component, its standard error, redundancy at the stated weights; NaN where nothing is redundant.

    `ratio` is the sum of squares over the redundancy, both at the stated weights; `freedom` that of its chi-square.
    `vague`: sigmas so wide that its rows move nothing, as those of a prior that only states a gauge.
    """

    component: Array
    error: Array
    redundancy: Array
    ratio: Array
    freedom: Array
    vague: BoolArray

    @property
    def zero(self) -> BoolArray:
        """Whether all residuals are zero, though others check them."""
        return (self.redundancy > NONE) & (self.ratio < ZERO)

    @property
    def log_p(self) -> Array:
        """Logarithms of p values of the component 1: the larger of two two-sided tests by a chi-square (Satterthwaite).

        The sum of squares at the stated weights has the right size, but answers to the noise of other kinds; the
        estimate does not, but is no chi-square where it has few degrees of freedom. The larger p has both virtues.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            own = _two_sided(self.component, 2.0 * (self.component / self.error) ** 2)
            tested = np.isfinite(self.component) & ~(self.vague & (self.component < 1.0))
            return np.where(tested, np.fmax(own, _two_sided(self.ratio, self.freedom)), np.nan)


def _two_sided(ratio: Array, freedom: Array) -> Array:
    x = ratio * freedom
    out: Array = np.minimum(np.log(2.0) + np.minimum(log_tail(x, freedom), log_below(x, freedom)), 0.0)
    return out


def weighted_rows(f: Factored, scale: Sequence[Array] | None = None) -> csr_matrix:
    """Coefficients (rows, N) of the system as it is solved: with roots of weights, and scales."""
    values, columns, counts = [], [], []
    for k, g in enumerate(f.system.groups):
        n, d, c = g.A.shape
        factor = np.sqrt(g.weight)[:, None] * (np.ones((n, d)) if scale is None else scale[k])
        values.append((g.A * factor[:, :, None]).ravel())
        columns.append(np.repeat(f.index(g), d, axis=0).ravel())
        counts.append(np.full(n * d, c))
    start = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    return csr_matrix((np.concatenate(values), np.concatenate(columns), start), (len(start) - 1, f.columns))


def residuals(f: Factored, A: csr_matrix, e: Array) -> Array:
    """Residuals (I - H) e of errors e (rows, c) of the rows as they are solved."""
    out = np.empty_like(e)
    for first in range(0, e.shape[1], PART):
        part = slice(first, first + PART)
        out[:, part] = e[:, part] - A @ solved(f, np.asarray(A.T @ e[:, part]))
    return out


def _probes(size: int, count: int, rng: np.random.Generator) -> Array:
    """Probes (size, m) of random signs, or all unit vectors where these are fewer: exact."""
    out: Array = np.sqrt(size) * np.eye(size) if size <= count else rng.choice([-1.0, 1.0], (size, count))
    return out


class Estimator:
    """Estimates the components of the rows of a system, by axis of a kind and by kind."""

    def __init__(
        self, f: Factored, order: IntArray, of: Sequence[IntArray], kind: IntArray, rng: np.random.Generator
    ) -> None:
        """`of`: per group, (n, d) the axis of each row, -1: of none; `kind`: (K,) of each axis."""
        self._f, self._order, self._of, self._kind = f, order, of, kind
        self._row = np.concatenate([each.ravel() for each in of])
        self._size = np.bincount(self._row[self._row >= 0], minlength=len(kind))
        probes = np.clip(np.ceil(ROWS / np.maximum(self._size, 1)), 2, 400).astype(int)
        self._signs = [_probes(n, m, rng) for n, m in zip(self._size.tolist(), probes.tolist(), strict=True)]
        self._axes: Components | None = None
        self._stated = self._equations(np.ones(len(kind)), f)

    def by_axis(self) -> Components:
        """Each axis has its own component."""
        if self._axes is None:
            self._axes = self._estimate(np.eye(len(self._kind)))
        return self._axes

    def by_kind(self) -> Components:
        """All axes of a kind share a component."""
        if len(self._kind) == self._kind.max() + 1:
            return self.by_axis()
        return self._estimate((self._kind[:, None] == np.arange(self._kind.max() + 1)).astype(float))

    def _equations(self, theta: Array, f: Factored | None = None) -> tuple[Array, Array]:
        """S (K, K) and q (K,) of rows whose variances are multiplied by `theta` (K,)."""
        system, row, count = self._f.system, self._row, len(self._kind)
        scale = [np.where(each < 0, 1.0, 1.0 / np.sqrt(theta)[each]) for each in self._of]
        f = factorize(system, self._order, scale) if f is None else f
        A, x = weighted_rows(f, scale), step(f)
        b = np.concatenate(
            [(np.sqrt(g.weight)[:, None] * s * g.r).ravel() for g, s in zip(system.groups, scale, strict=True)]
        )
        used = row >= 0
        q = np.bincount(row[used], ((b + A @ x) ** 2)[used], count).astype(float)
        S = np.zeros((count, count))
        for k, signs in enumerate(self._signs):
            if len(signs):
                e = np.zeros((len(row), signs.shape[1]))
                e[row == k] = signs
                square = np.sum(residuals(f, A, e) ** 2, 1)
                S[:, k] = np.bincount(row[used], square[used], count) / signs.shape[1]
        return 0.5 * (S + S.T), q

    def _estimate(self, share: Array) -> Components:
        """Components of unions of axes, `share` (K, C)."""
        theta, (S, q) = np.ones(share.shape[1]), self._stated
        S, q = share.T @ S @ share, share.T @ q
        redundancy = S.sum(1)
        live = (redundancy > NONE) & (q > ZERO * redundancy)
        vague = redundancy > (1.0 - VAGUE) * (self._size @ share)
        stated, freedom = q / np.maximum(redundancy, NONE), redundancy**2 / np.maximum(np.diagonal(S), NONE**2)
        error = np.full(len(theta), np.nan)
        if not live.any():
            return Components(error, error, redundancy, stated, freedom, vague)
        for turn in range(most := MOST if len(theta) == len(share) else POOLED):
            # Fisher's scoring; where that leads too far, the almost-unbiased estimate
            part = np.ix_(live, live)
            scored, unbiased = np.ones(len(theta)), np.ones(len(theta))
            scored[live] = np.linalg.lstsq(S[part], (q - S[:, ~live].sum(1))[live], rcond=None)[0]
            unbiased[live] = q[live] / S.sum(1)[live]
            ratio = np.where(scored > NEAR, scored, unbiased)
            before, theta = theta, np.maximum(theta * ratio, SMALLEST)
            size = np.sqrt(np.maximum(np.diagonal(S), np.finfo(float).tiny))[live]  # a vanishing component has little
            inverse = np.linalg.pinv(S[part] / size[:, None] / size, rcond=1e-6, hermitian=True)
            error[live] = theta[live] * np.sqrt(2.0 * np.maximum(np.diagonal(inverse), 0.0)) / size
            r = theta / before / np.exp(np.mean(np.log((theta / before)[live])))  # a common factor changes no estimate
            if turn + 1 == most or np.all(np.abs(r - 1.0)[live] * theta[live] < CLOSE * error[live]):
                break
            S, q = self._equations(share @ theta)
            S, q = share.T @ S @ share, share.T @ q
        return Components(np.where(live, theta, np.nan), error, redundancy, stated, freedom, vague)

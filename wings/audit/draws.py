"""Twins of a graph: residuals of its own noise, r* = (I - H) e, and the family-wise p value of its largest test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from data.se2 import Array
from wings.audit.components import residuals, weighted_rows
from wings.audit.factored import PART, Factored
from wings.audit.factors import Directions


def smallest_p(f: Factored, seen: Sequence[Directions], count: int, rng: np.random.Generator) -> Array:
    """Smallest p value of all factors in each of `count` draws on the linear model.

    The rows of a robust noise are drawn as stated, and weighted as at the values.
    """
    A = weighted_rows(f)
    root = np.concatenate([np.repeat(np.sqrt(g.weight), g.r.shape[1]) for g in f.system.groups])[:, None]
    out = np.ones(count)
    for first in range(0, count, PART):
        part = slice(first, min(count, first + PART))
        e = rng.standard_normal((A.shape[0], part.stop - part.start))
        r = residuals(f, A, root * e) / root
        largest: dict[int, Array] = {}
        at = 0
        for g, s in zip(f.system.groups, seen, strict=True):
            n, d = g.r.shape
            T = s.tested(r[at : at + n * d].reshape(n, d, -1))
            rank = np.sum(s.R > 0.0, 1)
            for k in np.unique(rank[rank > 0]).tolist():
                most = T[rank == k].max(0)
                largest[k] = np.maximum(largest[k], most) if k in largest else most
            at += n * d
        for k, most in largest.items():
            out[part] = np.minimum(out[part], chi2.sf(most, k))
    return out


def independent(smallest: Array) -> float:
    """Number of independent tests whose least p value is distributed as those drawn, where it is small.

    It is exponential in -log(1 - p); the maximum-likelihood rate from the lower half, the rest is censored.
    """
    y = -np.log1p(-np.sort(smallest))
    k = (len(y) + 1) // 2
    return float(k / max(y[:k].sum() + (len(y) - k) * y[k - 1], 1e-300))


def family(p: Array, smallest: Array) -> Array:
    """Family-wise p values (F,) of p values, from the smallest of each draw; NaN stays."""
    below = np.searchsorted(np.sort(smallest), p, side="right")
    return np.where(np.isfinite(p), (1.0 + below) / (1.0 + len(smallest)), np.nan)

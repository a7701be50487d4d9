"""Whether samples have the mean and the standard deviation that a world states."""

import math

import numpy as np

LIMIT = 4.5
"""Standard errors by which a mean or a standard deviation may miss."""


def agrees(values: np.ndarray, sigma: float, mean: float = 0.0) -> bool:
    """Whether normal samples have that mean and standard deviation, each within `LIMIT` standard errors."""
    n = values.size
    off = abs(values.mean() - mean) / (sigma / math.sqrt(n))
    wide = abs(values.std(ddof=1) / sigma - 1.0) * math.sqrt(2 * n)
    return bool(off < LIMIT and wide < LIMIT)

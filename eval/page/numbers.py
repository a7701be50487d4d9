"""Numbers as a reader wants them."""

from __future__ import annotations

import math


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, without exponent between 1e-4 and 1e6."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    rounded = float(f"{value:.{digits - 1}e}")  # 99.96 has the digits of 100
    return f"{value:.{max(digits - 1 - math.floor(math.log10(abs(rounded))), 0)}f}"

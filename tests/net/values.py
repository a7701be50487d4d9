"""Two result folders compared value by value, with a tolerance."""

import math
from collections.abc import Iterator, Mapping

from tests.net.digest import Columns, numbers


def differences(
    here: Mapping[str, Columns], there: Mapping[str, Columns], tolerance: float
) -> Iterator[tuple[str, str, str]]:
    """File, column, and what is different: what has vanished, other words, numbers that are farther apart, relative to
    the largest absolute value of the column as it was there.
    """
    for name, columns in there.items():
        if name not in here:
            yield name, "", "vanished"
            continue
        for column, cells in columns.items():
            if column not in here[name]:
                yield name, column, "vanished"
            elif what := _apart(here[name], column, cells, tolerance):
                yield name, column, what


def _apart(here: Columns, column: str, before: list[str], tolerance: float) -> str:
    now = here[column]
    if now == before:
        return ""
    if len(now) != len(before):
        return f"{len(now)} rows were {len(before)}"
    a, b = numbers(now), numbers(before)
    if a is None or b is None:
        return f"{sum(x != y for x, y in zip(now, before, strict=True))} of {len(now)} words are others"
    blank = sum(math.isfinite(x) != math.isfinite(y) for x, y in zip(a, b, strict=True))
    if blank:
        return f"{blank} of {len(now)} are blank in one of the two"
    pairs = [(x, y) for x, y in zip(a, b, strict=True) if math.isfinite(x)]
    scale = max(abs(y) for _, y in pairs) or 1.0
    off = [abs(x - y) / scale for x, y in pairs]
    largest = max(range(len(off)), key=off.__getitem__)
    if off[largest] <= tolerance:
        return ""
    changed = sum(o > tolerance for o in off)
    x, y = pairs[largest]
    return f"{changed} of {len(now)} off, the most by {off[largest]:.2g} of the column's scale: {x!r} was {y!r}"

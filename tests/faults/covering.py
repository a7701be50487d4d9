"""Combinations of levels in which every pair of levels of two factors occurs, as few as a greedy search finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

TRIED = 30
"""Rows that compete for each place."""


def pairwise(factors: Mapping[str, Sequence[str]], rng: np.random.Generator) -> list[dict[str, str]]:
    """Rows that cover all pairs (the greedy way of AETG, Cohen et al., IEEE TSE 23(7), 1997)."""
    names = list(factors)
    left = {((a, x), (b, y)) for a, b in combinations(names, 2) for x in factors[a] for y in factors[b]}
    rows: list[dict[str, str]] = []
    while left:
        best: tuple[int, dict[str, str]] = (-1, {})
        for _ in range(TRIED):
            first = sorted(left)[int(rng.integers(len(left)))]
            row = dict(first)
            for name in rng.permutation([n for n in names if n not in row]).tolist():
                levels = rng.permutation(factors[name]).tolist()
                row[name] = max(levels, key=lambda level: _gained(row, name, level, names, left))
            count = sum(pair in left for pair in _pairs(row, names))
            best = max(best, (count, row), key=lambda found: found[0])
        rows.append({name: best[1][name] for name in names})
        left -= set(_pairs(best[1], names))
    return rows


def _pairs(row: Mapping[str, str], names: Sequence[str]) -> list[tuple[tuple[str, str], tuple[str, str]]]:
    return [((a, row[a]), (b, row[b])) for a, b in combinations(names, 2)]


def _gained(row: Mapping[str, str], name: str, level: str, names: Sequence[str], left: set[object]) -> int:
    count = 0
    for other, value in row.items():
        a, b = sorted([(name, level), (other, value)], key=lambda pair: names.index(pair[0]))
        count += (a, b) in left
    return count

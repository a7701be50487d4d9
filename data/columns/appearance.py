"""Appearance in an open log folder, format 2: descriptors and classes of observations and landmarks.

    observations.csv    descriptor, blank where not measured [descriptor_sigma]; class, a word, blank where not read
                        [class_error]
    landmarks.csv       descriptor, class: as known, blank where not
    [sensor]            descriptor_sigma, class_error: defaults for the rows of a sensor

A class is read wrongly with probability class_error, above 0 and below 0.5, as each other class of the log alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from data.appearance import UNREAD, Appearance, joined
from data.columns.named import column, is_name
from data.csv_table import Table
from data.inputs import IntArray
from data.se2 import Array
from data.toml_table import TomlTable, positive

DESCRIPTOR, CLASS = "descriptor", "class"
SIGMA, ERROR = "descriptor_sigma", "class_error"
NUMBERS = (DESCRIPTOR, SIGMA, ERROR)
"""Columns of observations.csv beside the class, which may be blank; the noise may be stated in `KEYS`."""
KEYS = (SIGMA, ERROR)


class Noise(NamedTuple):
    """Of a sensor's descriptors, and the probability of a wrong class; None: not stated."""

    sigma: float | None = None
    error: float | None = None


def _is_error(value: float) -> bool:
    return 0.0 < value < 0.5


def noise_of(table: TomlTable) -> Noise:
    """As the table of a sensor states it."""
    sigma = table.number(SIGMA, -1.0, "a number > 0", positive)
    error = table.number(ERROR, -1.0, "a probability above 0 and below 0.5", _is_error)
    return Noise(sigma if SIGMA in table else None, error if ERROR in table else None)


def of_observations(table: Table, number: IntArray | None, stated: Sequence[tuple[str, Noise]]) -> Appearance | None:
    """Appearance of the rows (M,) of observations.csv, None without columns of it; `number` (M,): row of the sensor
    among `stated`, names with their noise.
    """
    words = table.texts.get(CLASS)
    if DESCRIPTOR not in table and words is None:
        return None
    which = np.zeros(len(table), np.int64) if number is None else number
    table.require_finite([n for n in NUMBERS if n in table], blank=True)
    descriptor = column(table, DESCRIPTOR)
    sigma = _noise(table, SIGMA, which, [n.sigma for _, n in stated])
    table_sigma = column(table, SIGMA)
    table.require(np.isnan(table_sigma) | (table_sigma > 0.0), SIGMA, "{} is no standard deviation > 0")
    _require(table, np.isnan(descriptor) | ~np.isnan(sigma), which, stated, DESCRIPTOR, SIGMA)
    error, own = _noise(table, ERROR, which, [n.error for _, n in stated]), column(table, ERROR)
    table.require(np.isnan(own) | _is_error_of(own), ERROR, "{} is no probability above 0 and below 0.5")
    given = [""] * len(table) if words is None else list(words)
    for row, word in enumerate(given):
        if word and not is_name(word):
            raise table.error(row, CLASS, f"{word!r} holds a quote; a plain name is needed")
    read = np.array([bool(word) for word in given], bool)
    _require(table, ~read | ~np.isnan(error), which, stated, CLASS, ERROR)
    names, category = _numbered(given)
    sigma, error = np.where(np.isnan(descriptor), 1.0, sigma), np.where(read, error, 0.5)
    return Appearance(descriptor, sigma, category, error, names)


def _is_error_of(values: Array) -> Any:
    return (values > 0.0) & (values < 0.5)


def _noise(table: Table, name: str, which: IntArray, stated: Sequence[float | None]) -> Array:
    """The noise of each row (M,): its own, else the sensor's, else NaN."""
    default = np.array([np.nan if s is None else s for s in stated] or [np.nan])
    own = column(table, name)
    return np.where(np.isnan(own), default[which], own)


def _require(
    table: Table, fine: Any, which: IntArray, stated: Sequence[tuple[str, Noise]], name: str, noise: str
) -> None:
    """Raise at the first row whose noise is stated nowhere."""
    if fine.all():
        return
    row = int(np.argmin(fine))
    label = stated[int(which[row])][0] if stated else ""
    named = f"[[sensor]] {label!r}" if label else "[sensor]"
    raise table.error(row, name, f"a value, but no {noise} here or in {named} of log.toml; one of them is needed")


def _numbered(words: Sequence[str]) -> tuple[tuple[str, ...], IntArray]:
    """The classes in alphabetical order, and that of each word."""
    names = tuple(sorted({word for word in words if word}))
    row = {name: k for k, name in enumerate(names)}
    return names, np.array([row.get(word, UNREAD) for word in words], np.int64)


def of_landmarks(table: Table) -> Appearance | None:
    """Known appearance of the rows (L,) of landmarks.csv, None without columns of it."""
    words = table.texts.get(CLASS)
    if DESCRIPTOR not in table and words is None:
        return None
    if DESCRIPTOR in table:
        table.require_finite((DESCRIPTOR,), blank=True)
    given = [""] * len(table) if words is None else list(words)
    for row, word in enumerate(given):
        if word and not is_name(word):
            raise table.error(row, CLASS, f"{word!r} holds a quote; a plain name is needed")
    names, category = _numbered(given)
    zero = np.zeros(len(table))
    return Appearance(column(table, DESCRIPTOR), zero, category, zero, names)


def together(seen: Appearance | None, known: Appearance | None) -> tuple[Appearance | None, Appearance | None]:
    """Observations and landmarks with the same classes."""
    names = tuple(sorted({*(seen.names if seen else ()), *(known.names if known else ())}))
    return _named(seen, names), _named(known, names)


def every(parts: Sequence[Appearance | None], counts: Sequence[int]) -> Appearance | None:
    """Appearance of all rows of parts with so many each, None where no part has one; blank where a part has none."""
    if all(part is None for part in parts):
        return None
    names = tuple(sorted({name for part in parts if part is not None for name in part.names}))
    return joined([_named(p, names) or _blank(n, names) for p, n in zip(parts, counts, strict=True)])


def _blank(count: int, names: tuple[str, ...]) -> Appearance:
    return Appearance(np.full(count, np.nan), np.ones(count), np.full(count, UNREAD), np.full(count, 0.5), names)


def _named(looks: Appearance | None, names: tuple[str, ...]) -> Appearance | None:
    if looks is None or looks.names == names:
        return looks
    row = np.array([*(names.index(n) for n in looks.names), UNREAD], np.int64)  # UNREAD is the last
    return replace(looks, category=row[looks.category], names=names)


def columns_of(looks: Appearance, *, known: bool = False) -> dict[str, list[Any]]:
    """Columns by name, as they are read; `known`: of landmarks, which have no noise."""
    columns: dict[str, list[Any]] = {}
    if looks.measures:
        there = np.isfinite(looks.descriptor).tolist()
        columns[DESCRIPTOR] = _or_blank(looks.descriptor.tolist(), there)
        if not known:
            columns[SIGMA] = _or_blank(looks.sigma.tolist(), there)
    if looks.classifies:
        read = (looks.category >= 0).tolist()
        columns[CLASS] = [looks.names[c] if c >= 0 else "" for c in looks.category.tolist()]
        if not known:
            columns[ERROR] = _or_blank(looks.error.tolist(), read)
    return columns


def _or_blank(values: list[Any], there: list[bool]) -> list[Any]:
    return [value if yes else "" for value, yes in zip(values, there, strict=True)]

"""Appearance in an open log folder, format 2: descriptors and classes of observations and landmarks."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from data.appearance import UNREAD, Appearance, joined
from data.columns.named import or_blank
from data.csv_table import Table
from data.inputs import IntArray
from data.toml_table import TomlTable, positive

DESCRIPTOR, CLASS = "descriptor", "class"
SIGMA, ERROR = KEYS = ("descriptor_sigma", "class_error")
NUMBERS = (DESCRIPTOR, SIGMA, ERROR)  # Columns beside the class, which may be blank; the noise may be stated in `KEYS`


class Noise(NamedTuple):
    """Of a sensor's descriptors, and the probability of a wrong class; None: not stated."""

    sigma: float | None = None
    error: float | None = None


def noise_of(table: TomlTable) -> Noise:
    """As the table of a sensor states it."""
    sigma = table.number(SIGMA, -1.0, "a number > 0", positive)
    error = table.number(ERROR, -1.0, "a probability above 0 and below 0.5", lambda v: 0.0 < v < 0.5)
    return Noise(sigma if SIGMA in table else None, error if ERROR in table else None)


def of_observations(table: Table, number: IntArray | None, stated: Sequence[tuple[str, Noise]]) -> Appearance | None:
    """Appearance of the rows (M,) of observations.csv or None; `number` (M,): row of the sensor among `stated`."""
    if DESCRIPTOR not in table and CLASS not in table.texts:
        return None
    which = np.zeros(len(table), np.int64) if number is None else number
    table.require_finite([n for n in NUMBERS if n in table], blank=True)
    descriptor, sigma, error = (table.get(name) for name in NUMBERS)
    table.require(np.isnan(sigma) | (sigma > 0.0), SIGMA, "{} is no standard deviation > 0")
    fine = np.isnan(error) | ((error > 0.0) & (error < 0.5))
    table.require(fine, ERROR, "{} is no probability above 0 and below 0.5")
    names, category = _classes(table)
    noise = []
    rows = (DESCRIPTOR, SIGMA, sigma, ~np.isnan(descriptor)), (CLASS, ERROR, error, category != UNREAD)
    for (name, key, own, there), by_sensor in zip(rows, zip(*(n for _, n in stated), strict=True), strict=True):
        values = np.where(np.isnan(own), np.array([np.nan if s is None else s for s in by_sensor])[which], own)
        lacking = there & np.isnan(values)
        if lacking.any():
            row = int(np.argmax(lacking))
            label = stated[int(which[row])][0]
            named = f"[[sensor]] {label!r}" if label else "[sensor]"
            raise table.error(row, name, f"a value, but no {key} here or in {named} of log.toml; one of them is needed")
        noise.append(np.where(there, values, 1.0 if key == SIGMA else 0.5))
    return Appearance(descriptor, noise[0], category, noise[1], names)


def of_landmarks(table: Table) -> Appearance | None:
    """Known appearance of the rows (L,) of landmarks.csv, None without columns of it."""
    if DESCRIPTOR not in table and CLASS not in table.texts:
        return None
    table.require_finite([n for n in (DESCRIPTOR,) if n in table], blank=True)
    names, category = _classes(table)
    zero = np.zeros(len(table))
    return Appearance(table.get(DESCRIPTOR), zero, category, zero, names)


def _classes(table: Table) -> tuple[tuple[str, ...], IntArray]:
    """The classes in alphabetical order, and that of each row (K,)."""
    table.require_names(CLASS)
    words = table.texts.get(CLASS, [""] * len(table))
    names = tuple(sorted({word for word in words if word}))
    row = {name: k for k, name in enumerate(names)}
    return names, np.array([row.get(word, UNREAD) for word in words], np.int64)


def together(parts: Sequence[Appearance | None]) -> list[Appearance | None]:
    """Appearance of several tables, with one common list of classes."""
    names = tuple(sorted({name for part in parts if part is not None for name in part.names}))
    return [None if part is None else _named(part, names) for part in parts]


def every(parts: Sequence[Appearance | None], counts: Sequence[int]) -> Appearance | None:
    """Appearance of all rows of parts with so many each, None where no part has one; blank where a part has none."""
    if all(part is None for part in parts):
        return None
    found = together([_blank(n) if part is None else part for part, n in zip(parts, counts, strict=True)])
    return joined([part for part in found if part is not None])


def _blank(count: int) -> Appearance:
    return Appearance(np.full(count, np.nan), np.ones(count), np.full(count, UNREAD), np.full(count, 0.5))


def _named(looks: Appearance, names: tuple[str, ...]) -> Appearance:
    row = np.array([*(names.index(n) for n in looks.names), UNREAD], np.int64)  # UNREAD is the last
    return replace(looks, category=row[looks.category], names=names)


def columns_of(looks: Appearance, *, known: bool = False) -> dict[str, list[Any]]:
    """Columns by name, as they are read; `known`: of landmarks, which have no noise."""
    columns: dict[str, list[Any]] = {}
    there, read = np.isfinite(looks.descriptor), looks.category >= 0
    if looks.measures:
        columns |= {DESCRIPTOR: or_blank(looks.descriptor, there), SIGMA: or_blank(looks.sigma, there)}
    if read.any():
        columns[CLASS] = [looks.names[c] if c >= 0 else "" for c in looks.category.tolist()]
        columns[ERROR] = or_blank(looks.error, read)
    return {name: values for name, values in columns.items() if not (known and name in KEYS)}

"""Values of flags, as text: pairs KEY=VALUE, numbers with units, standard deviations, one word of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from data.errors import UsageError, unknown
from data.formats.tables.files import SECOND, quantity_with_unit
from data.se2 import Array

Given = Mapping[str, object]
"""Texts by flag (without leading dashes); flags of pairs as text or as a table of texts."""
POSE = ("length", "length", "angle")
TRAVEL = ("length", "length", "angle", "angle")
STAMPED = ("odometry", "observations", "truth", "fixes", "closures", SECOND)
"""Roles of files with stamps, beside the names of sensors."""


def pairs(value: object, flag: str) -> dict[str, str]:
    """`a=b,c=d` (or several such texts, or a table) as a dict."""
    if isinstance(value, Mapping):
        return {str(k): str(v) for k, v in value.items()}
    texts = value if isinstance(value, list) else [str(value)]
    found: dict[str, str] = {}
    for part in [p.strip() for text in texts for p in str(text).split(",") if p.strip()]:
        key, equals, name = part.partition("=")
        if not (key.strip() and equals and name.strip()):
            right = "KEY=NAME is needed, as in t=stamp (names with commas: in a mapping file)"
            if flag == "time-offset":
                right = f"PART=SECONDS is needed, as in truth=-0.5, of {', '.join(STAMPED)}"
            raise UsageError(f"--{flag} {part}: {right}")
        if key.strip() in found:
            raise UsageError(f"--{flag}: {key.strip()} is named twice")
        found[key.strip()] = name.strip()
    return found


def numbers(text: object, dimensions: Sequence[str], flag: str, what: str) -> Array:
    """Numbers with or without units, one for each dimension; `what` describes them in a message."""
    parts = [p for p in str(text).replace(",", " ").split() if p]
    if len(parts) != len(dimensions):
        raise UsageError(f"--{flag} {text}: {len(dimensions)} numbers are needed: {what}")
    return np.array([quantity_with_unit(p, d, f"--{flag}") for p, d in zip(parts, dimensions, strict=True)])


def sigmas(text: object, dimensions: Sequence[str], flag: str, what: str, *, zero: bool = True) -> Array:
    """Numbers that are standard deviations; `zero`: may be 0."""
    found = numbers(text, dimensions, flag, what)
    if (found < 0.0).any() or (not zero and (found == 0.0).any()):
        raise UsageError(f"--{flag} {text}: must be {'0 or more' if zero else 'more than 0'}")
    return found


def one_of(given: Given, flag: str, known: Sequence[str]) -> str:
    """The word of a flag, by default the first that is known."""
    value = str(given.get(flag, known[0]))
    if value not in known:
        raise UsageError(f"--{flag} {value}: {unknown(value, known)}")
    return value


def words(text: object) -> list[str]:
    """The parts of a list with commas or spaces."""
    return str(text).replace(",", " ").split()

"""Checks that simulated worlds share: parameters of the right type, finite, in range; one line says what is wrong."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Any

from data.errors import UsageError


def check_parameters(
    world: str,
    values: Any,
    *,
    positive: Collection[str],
    not_negative: Collection[str] = (),
    choices: Mapping[str, Collection[str]] | None = None,
) -> None:
    """Check every field of a dataclass: numbers against the two lists of names, words against their `choices`.

    The type of a field's default is the field's type (any number will do for a float); a default of None stands for a
    number that may be left out.

    Raises:
        UsageError: naming world, key and value.
    """
    for f in fields(values):
        value = getattr(values, f.name)
        where = f"{world}: {f.name} = {value!r}"
        if isinstance(f.default, str):
            known = (choices or {})[f.name]
            if value not in known:
                raise UsageError(f"{where}; known: {', '.join(known)}")
            continue
        if isinstance(f.default, bool):
            if not isinstance(value, bool):
                raise UsageError(f"{where}; on or off is needed")
            continue
        if f.default is None and value is None:
            continue
        whole = isinstance(f.default, int)
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            raise UsageError(f"{where}; a {'whole ' if whole else ''}number is needed")
        if not math.isfinite(value):
            raise UsageError(f"{where}; a finite number is needed")
        if f.name in positive and not value > 0:
            raise UsageError(f"{where}; {'at least 1' if whole else 'a positive number'} is needed")
        if f.name in not_negative and value < 0:
            raise UsageError(f"{where}; must not be negative")

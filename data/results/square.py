"""The header of SQUARE files, `#%KEY value` lines, and what it declares; the columns of a pose."""

from __future__ import annotations

from dataclasses import dataclass

from data.errors import DataError
from data.results.lines import Text
from data.results.path import LEFT, LOCAL

POSE = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
CONVENTIONS = {"right_perturbation": LOCAL, "left_perturbation": LEFT}
ORDERS = ("translation_rotation", "rotation_translation")


@dataclass(frozen=True)
class Header:
    """What `#%KEY value` lines say, by key, each with its line."""

    values: dict[str, tuple[int, str]]

    def one_of(self, text: Text, key: str, allowed: tuple[str, ...]) -> str | None:
        """A value that must be one of a few; None: not said."""
        line, value = self.values.get(key, (0, ""))
        if key not in self.values:
            return None
        if value not in allowed:
            raise DataError.at(text.path, f"{key} {value!r}; one of {', '.join(allowed)} is needed", line=line)
        return value


def header_of(text: Text) -> Header:
    """The header of a SQUARE file or of a file of covariances; empty where there is none."""
    found: dict[str, tuple[int, str]] = {}
    for line, comment in text.comments:
        if comment.startswith("#%"):
            key, _, value = comment[2:].strip().partition(" ")
            if key.upper() in found:
                raise DataError.at(text.path, f"{key} is said twice", line=line)
            found[key.upper()] = line, value.strip()
    return Header(found)


def tangent(text: Text, header: Header) -> tuple[str | None, str | None]:
    """Frame and order that a header declares."""
    convention = header.one_of(text, "TANGENT_CONVENTION", tuple(CONVENTIONS))
    return None if convention is None else CONVENTIONS[convention], header.one_of(text, "TANGENT_ORDER", ORDERS)

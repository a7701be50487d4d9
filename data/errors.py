"""Errors that a user can cause: one line that names the place, the value, and what would be right."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike

LARGEST = 1e15  # Largest accepted value in SI units: products stay finite, and whole numbers exact
LONGEST = 800  # Most characters of a message; keys, names and values come from files
SHORTEST = 3  # Fewest letters of a word that is taken for a part of a name


def printable(text: str) -> str:
    """The text with its middle cut where it is too long, and control characters escaped."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class SlamrefError(Exception):
    """Base of every error that ends a command with one line and exit status 2."""

    def __init__(self, message: str = "") -> None:
        super().__init__(printable(message))


class DataError(SlamrefError):
    """Bad input data: `file:line: column C: what is wrong; what would be right`."""

    @classmethod
    def at(
        cls, path: str | PathLike[str], what: str, *, line: int | None = None, column: str | None = None
    ) -> DataError:
        """The error at a place in a file; `line` counts from 1, the header included."""
        place = str(path) if line is None else f"{path}:{line}"
        return cls(f"{place}: {what}" if column is None else f"{place}: column {column}: {what}")


class UsageError(SlamrefError):
    """A wrong or contradictory combination of options."""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known name that an unknown word probably means, whatever its case and dashes; empty if none is near."""
    from difflib import SequenceMatcher, get_close_matches

    plain = {name.lower().replace("_", "-"): name for name in known}
    asked = word.strip().lower().replace("_", "-")
    near = [asked] if asked in plain else get_close_matches(asked, plain)
    # of names as near: a letter too many, rather than another one
    near.sort(key=lambda name: (-SequenceMatcher(None, name, asked).ratio(), not asked.startswith(name)))
    within = [name for name in plain if len(asked) >= SHORTEST and asked in name]
    return next((plain[name] for name in [*near, *within]), "")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """` (did you mean NAME?)`, or nothing if no known name is near."""
    names = list(known)
    near = next((name for name in names if name.startswith((f"{word}_", f"{word}."))), nearest(word, names))
    return f" (did you mean {near}?)" if near else ""


def unknown(word: str, known: Iterable[str]) -> str:
    """What is wrong with an unknown name: the nearest known one, and all of them."""
    names = list(known)
    return f"unknown{did_you_mean(word, names)}; known: {', '.join(names)}"

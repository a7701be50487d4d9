"""The errors a user can cause: one line that names the place, the value, and what would be right."""

from __future__ import annotations

from os import PathLike

LARGEST = 1e15
"""No quantity in SI units is larger; beyond, squares and products overflow and whole numbers are not exact."""
LONGEST = 800
"""Characters of a message; keys, names and values come from files."""


def printable(text: str) -> str:
    """The same, its middle left out where it is too long, other characters escaped."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class SlamrefError(Exception):
    """Base of every error that ends a command with one clear line and exit status 2."""

    def __init__(self, message: str = "") -> None:
        """Keep the message in one line of bearable length, whatever a file or its name holds."""
        super().__init__(printable(message))


class DataError(SlamrefError):
    """Bad input data. The message reads `file: line N, column C: what is wrong; what would be right`."""

    @classmethod
    def at(
        cls, path: str | PathLike[str], what: str, *, line: int | None = None, column: str | None = None
    ) -> DataError:
        """Build the message for a place in a file; `line` counts from 1, the header included."""
        place = str(path)
        if line is not None:
            place += f": line {line}"
        if column is not None:
            place += f", column {column}" if line is not None else f": column {column}"
        return cls(f"{place}: {what}")


class UsageError(SlamrefError):
    """A wrong or senseless combination of options."""

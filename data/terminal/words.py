"""Counted things in words, and rows of text in columns."""

from __future__ import annotations

from collections.abc import Sequence


def counted(n: int | float, thing: str, things: str = "") -> str:
    """`1 landmark`, `2 landmarks`; `things`: the plural, where it is not made with an s."""
    return f"{n:.0f} {thing if n == 1 else things or f'{thing}s'}"


def in_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """A line for each row, its cells below those of the row before."""
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]

"""Counted things in words."""

from __future__ import annotations


def counted(n: int | float, thing: str, things: str = "") -> str:
    """`1 landmark`, `2 landmarks`; `things`: the plural, where it is not made with an s."""
    return f"{n:.0f} {thing if n == 1 else things or f'{thing}s'}"

"""Text that was written once and is to stay as it is: compared word by word, numbers within a thousandth.

`KEEP=1 pytest tests/kept` writes the files anew, where numbers or words change on purpose; the difference is for the
reviewer to read.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

KEPT = Path(__file__).parent / "said"
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
CLOSE = 1e-3
"""Relative difference of two numbers that are the same: another processor rounds otherwise."""
NOTHING = 1e-6
"""Two numbers this close to zero are the same."""
SHOWN = 40


def differences(text: str, kept: str) -> list[str]:
    """Lines that say something else than those that were kept, as a reader is to see them."""
    here, there = text.splitlines(), kept.splitlines()
    found = [
        f"line {k}: {a!r} was {b!r}" for k, (a, b) in enumerate(zip(here, there, strict=False), 1) if not same(a, b)
    ]
    if len(here) != len(there):
        found.append(f"{len(here)} lines were {len(there)}")
    return found


def same(line: str, kept: str) -> bool:
    """Whether two lines have the same words, the same whole numbers, and decimal numbers that are close."""
    if line == kept:
        return True
    if NUMBER.sub("#", line) != NUMBER.sub("#", kept):
        return False
    pairs = zip(NUMBER.findall(line), NUMBER.findall(kept), strict=True)
    return all(a == b or close(a, b) for a, b in pairs)


def close(a: str, b: str) -> bool:
    """Whether two numbers as they are printed are the same but for rounding; whole numbers never are."""
    if not any(sign in number for number in (a, b) for sign in ".e"):
        return False
    x, y = (float(number.replace("−", "-")) for number in (a, b))
    return math.isclose(x, y, rel_tol=CLOSE, abs_tol=NOTHING)


def assert_kept(name: str, text: str) -> None:
    """The text is the one that was kept under a name."""
    path = KEPT / f"{name}.txt"
    if os.environ.get("KEEP"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    found = differences(text, path.read_text(encoding="utf-8"))
    assert not found, "\n".join([f"{name}: {len(found)} differences", *found[:SHOWN]])

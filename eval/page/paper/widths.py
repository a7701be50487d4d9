"""How wide a table will be in LaTeX, from the widths of Computer Modern's letters, which Times stays below.

cmr8, the face of 8 pt text, is 17/16 as wide as cmr10 scaled down (Knuth's metric files; the digits 0.531 em for 0.5).
"""

from __future__ import annotations

from functools import cache

from matplotlib.font_manager import FontProperties, findfont
from matplotlib.ft2font import FT2Font, LoadFlags

WIDTHS = {"column": 252.0, "page": 516.0}
"""pt (1/72.27 in). A column and both of an IEEE journal: 21 and 43 picas."""
EM = {"footnotesize": 8.0, "scriptsize": 7.0}
"""pt. Type sizes where the text is 10 pt."""
SMALL_FACE = 17.0 / 16.0
"""Of small faces beside cmr10 scaled down, at 8 pt; at 7 pt they are 9/8 as wide."""
SMALLER_FACE = 9.0 / 8.0
GAP = 6.0
"""pt between columns: twice the \\tabcolsep that the tables set."""
SPECIAL = {
    " ": 0.334, "−": 0.778, "–": 0.5, "—": 1.0, "±": 0.778, "×": 0.778, "σ": 0.572, "χ": 0.626, "²": 0.45, "°": 0.45,
    "≤": 0.778, "≥": 0.778, "<": 0.778, ">": 0.778, "|": 0.278, "_": 0.45, "…": 0.5, "\u00a0": 0.334,
}  # fmt: skip
"""em of cmr10, cmmi10 and cmsy10 (superscripts: of the 7 pt face), of what is not in the text font, or elsewhere."""
WIDEST = 1.028
"""em. Letters that nobody thought of are taken for a W."""


@cache
def _face() -> FT2Font:
    font = FT2Font(findfont(FontProperties(family="cmr10")))
    font.set_size(1000.0, 72.0)
    return font


@cache
def _letter(c: str) -> float:
    """Em."""
    if c in SPECIAL:
        return SPECIAL[c]
    if not " " < c < "\x7f":
        return WIDEST
    return _face().load_char(ord(c), flags=LoadFlags.NO_HINTING).linearHoriAdvance / 65536.0 / 1000.0


def text_width(text: str, size: str = "footnotesize") -> float:
    """Width [pt] of a text that is not broken, at most (kerning and ligatures make it narrower)."""
    return EM[size] * (SMALL_FACE if size == "footnotesize" else SMALLER_FACE) * sum(_letter(c) for c in text)

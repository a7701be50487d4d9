"""Numbers on pages: `claims.toml` says where each stands, `measured.json` what its command gave.

A claim is a line of a page with `{result.name:format}` in place of numbers. `make docs` writes the stored numbers into
the pages; `make docs ARGS='--measure arena,intel'` runs the commands of these results anew first, which takes minutes.
"""

import json
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
CLAIMS, STORE = Path(__file__).with_name("claims.toml"), Path(__file__).with_name("measured.json")
PLACE = re.compile(r"\{([\w.]+):([^}]+)\}")
NUMBER = r"[−-]?\d[\d .]*(?: ?%)?"


def shown(value: float, layout: str) -> str:
    """A number as a page shows it: Python's layout, with a space before % and a true minus."""
    return format(value, layout).replace("%", " %").replace("-", "−")


def claims() -> list[tuple[Path, str]]:
    """Pages and the lines that claim numbers."""
    found = tomllib.loads(CLAIMS.read_text(encoding="utf-8"))
    return [(ROOT / page, line) for page, lines in found.items() for line in lines["lines"]]


def stored() -> dict[str, dict[str, float]]:
    """Values by result and name."""
    found: dict[str, dict[str, float]] = json.loads(STORE.read_text(encoding="utf-8"))
    return found


def written(text: str, line: str, values: dict[str, dict[str, float]]) -> str:
    """A page with the numbers of a claim. Raises ValueError unless it has the line once, with any numbers."""

    def number(place: re.Match[str]) -> str:
        result, _, name = place[1].partition(".")
        return shown(values[result][name], place[2])

    bare = PLACE.split(line)[::3]
    found = re.findall(NUMBER.join(re.escape(part) for part in bare), text)
    if len(found) != 1:
        raise ValueError(f"{len(found)} times, not once: {line}")
    return text.replace(found[0], PLACE.sub(number, line))


def pages() -> dict[Path, str]:
    """Every page with claims, with the stored numbers in it. Raises ValueError, which names page and line."""
    values, made = stored(), dict[Path, str]()
    for page, line in claims():
        try:
            made[page] = written(made.get(page) or page.read_text(encoding="utf-8"), line, values)
        except ValueError as fault:
            raise ValueError(f"{page.name}: {fault}") from fault
    return made

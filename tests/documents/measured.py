"""Numbers on pages: `claims.toml` says where each stands, `measured.json` what its command gave.

A claim is a line of a page with `{result.name:format}` in place of numbers. `make docs` writes the stored numbers into
the pages; `make docs ARGS='--measure arena,intel'` runs the commands of these results anew first, which takes minutes.
`printed.toml` has commands whose printed lines stand on pages, and how these begin; `printed.json` has what they print.
"""

import functools
import json
import re
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
CLAIMS, STORE = Path(__file__).with_name("claims.toml"), Path(__file__).with_name("measured.json")
EXAMPLES, PRINTED = Path(__file__).with_name("printed.toml"), Path(__file__).with_name("printed.json")
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


def examples() -> dict[str, dict[str, Any]]:
    """Of each example its `command`, the `pages` that show it, and how the shown `lines` begin."""
    return tomllib.loads(EXAMPLES.read_text(encoding="utf-8"))


def shown_again(text: str, line: str, printed: str) -> str:
    """A page with a printed line, from a beginning on. Raises ValueError unless page and print have it once."""
    rest = re.compile(re.escape(line) + r"[^`\n]*")
    old, new = rest.findall(text), rest.findall(printed)
    if (len(old), len(new)) != (1, 1):
        raise ValueError(f"{len(old)} and {len(new)} times, not once: {line}")
    return text.replace(old[0], new[0].rstrip())


def pages() -> dict[Path, str]:
    """Every page with claims, with the stored numbers in it. Raises ValueError, which names page and line."""
    values, made, said = stored(), dict[Path, str](), json.loads(PRINTED.read_text(encoding="utf-8"))
    todo = [(page, functools.partial(written, line=line, values=values)) for page, line in claims()]
    for name, example in examples().items():
        changes = [functools.partial(shown_again, line=line, printed=said[name]) for line in example["lines"]]
        todo += [(ROOT / page, change) for page in example["pages"] for change in changes]
    for page, change in todo:
        try:
            made[page] = change(made.get(page) or page.read_text(encoding="utf-8"))
        except ValueError as fault:
            raise ValueError(f"{page.name}: {fault}") from fault
    return made

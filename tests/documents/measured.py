"""Numbers on pages: `claims.toml` says where each stands, `measured.json` what its command gave.

A claim is a line of a page with `{result.name:format}` in place of numbers. `make docs` writes the stored numbers into
the pages; `make docs ARGS='--measure arena,intel'` runs the commands of these results anew first, which takes minutes.
`printed.toml` has commands whose printed lines stand on pages, and how these begin; `printed.json` has what they print.
"""

import json
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
STORE, PRINTED = (Path(__file__).with_name(f"{name}.json") for name in ("measured", "printed"))
CLAIMS, EXAMPLES = (tomllib.loads(STORE.with_name(f"{name}.toml").read_text("utf-8")) for name in ("claims", "printed"))
PLACE = re.compile(r"\{([\w.]+):([^}]+)\}")
NUMBER = r"[−-]?\d[\d .]*(?: ?%)?"


def shown(value: float, layout: str) -> str:
    """A number as a page shows it: Python's layout, with a space before % and a true minus."""
    return format(value, layout).replace("%", " %").replace("-", "−")


def stored() -> dict[str, dict[str, float]]:
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
    todo = [(page, written, line, values) for page, of in CLAIMS.items() for line in of["lines"]]
    for name, of in EXAMPLES.items():
        todo += [(page, shown_again, line, said[name]) for page in of["pages"] for line in of["lines"]]
    for page, change, line, of in todo:
        page = ROOT / page
        try:
            made[page] = change(made.get(page) or page.read_text(encoding="utf-8"), line, of)
        except ValueError as fault:
            raise ValueError(f"{page.name}: {fault}") from fault
    return made

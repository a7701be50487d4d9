"""Files, folders and Python names in the docs exist, and pages named in the code do."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PACKAGES = ("association", "data", "ekf", "eval", "graph", "wings")
OURS = (*PACKAGES, "docs", "tests")
PAGES = [p for kind in ("*.md", "docs/**/*.md", "docs/**/*.ipynb") for p in sorted(ROOT.glob(kind))]
PAGES.remove(ROOT / "CHANGELOG.md")  # which names what there was
QUOTED = re.compile(r"`([^`\n]+)`")
FILE = re.compile(rf"(?:{'|'.join(OURS)})/[\w./-]*")
NAME = re.compile(rf"(?:{'|'.join(PACKAGES)})(?:\.(?!csv\b)\w+)+")


def quoted(page: Path) -> list[str]:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [word.partition("(")[0] for word in QUOTED.findall(text)]


def is_there(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        return all((found := getattr(found, attribute, None)) is not None for attribute in parts[k:])
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_and_names_in_backticks_exist(page):
    words = quoted(page)
    missing = [w for w in words if FILE.fullmatch(w) and not (ROOT / w).exists()]
    assert missing + [w for w in words if NAME.fullmatch(w) and not is_there(w)] == []


def test_pages_named_in_the_code_exist():
    named = {
        (path.name, page)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.suffix in (".py", ".j2", ".html", ".js")
        for page in re.findall(r"docs/[\w/-]+\.(?:md|ipynb)", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 5
    assert {(name, page) for name, page in named if not (ROOT / page).exists()} == set()

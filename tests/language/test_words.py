"""The field's words, everywhere a person reads: no banned word in docstrings, comments, texts, pages and templates."""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
LIST = Path(__file__).parent / "banned.txt"
ROOMS = ("association", "data", "ekf", "eval", "graph", "wings")
PAGES = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md")
VALUES = ("paired anew on the smoothed path",)
"""Values in files are contracts."""
STRING_OR_COMMENT = re.compile(
    r'''"""(?:\\.|[^\\])*?"""|\'{3}(?:\\.|[^\\])*?\'{3}|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|\#[^\n]*''', re.DOTALL
)
"""A string from quote to quote, in which `#` begins no comment, or a comment to the end of its line."""


def banned() -> dict[str, str]:
    lines = [line for line in LIST.read_text().splitlines() if line and not line.startswith("#")]
    return dict(line.split(" = ", 1) for line in lines)


def texts_of_module(path: Path) -> Iterator[tuple[int, str]]:
    """Docstrings, texts and comments with their lines; keys and names of columns have no blank and are left out."""
    source = path.read_text()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
            if node.value in VALUES:
                continue
            yield node.lineno, node.value
    line, at = 1, 0
    for found in STRING_OR_COMMENT.finditer(source):
        line, at = line + source.count("\n", at, found.start()), found.start()
        if found[0].startswith("#"):
            yield line, found[0]


def texts() -> Iterator[tuple[str, str]]:
    """Every text that a person may read, and where it stands."""
    for path in [*(p for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))), ROOT / "slamref.py"]:
        for line, text in texts_of_module(path):
            yield f"{path.relative_to(ROOT)}:{line}", text
    templates = [p for room in ROOMS for p in sorted((ROOT / room).rglob("*.j2"))]
    pages = [
        *(ROOT / p for p in PAGES),
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "docs" / "course").glob("*.md")),
    ]
    for path in [*templates, *pages]:
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            yield f"{path.relative_to(ROOT)}:{number}", line
    for path in sorted((ROOT / "docs").glob("*.ipynb")):
        for cell in json.loads(path.read_text())["cells"]:
            if cell["cell_type"] == "markdown":
                yield f"docs/{path.name}", "".join(cell["source"])


def test_no_text_has_a_banned_word():
    """What to say instead stands in `banned.txt`."""
    everything = list(texts())
    assert len(everything) > 8000
    pattern = re.compile(rf"(?<![\w`-])(?:{'|'.join(banned())})(?![\w`-])", re.IGNORECASE)
    assert [f"{where}: {m[0]!r}" for where, text in everything if (m := pattern.search(text))] == []

"""The course: page, notebook and picture of each lesson, out of one source.

A source, `lessons/NAME.md`, is Markdown. Its Python is run from top to bottom; `<<value:layout>>` in the text is a
value after the last line. What the code printed and these values are in `lessons/measured.json`, pictures beside the
pages: `make docs ARGS='--measure course'`, or the name of a lesson, runs them anew.
"""

import base64
import functools
import json
import math
import re
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from tests.e2e.docs.notebook import run_cell

SOURCES, PAGES = Path(__file__).with_name("lessons"), Path(__file__).parents[2] / "docs" / "course"
STORE = SOURCES / "measured.json"
LESSONS = tuple(sorted(path.stem for path in SOURCES.glob("[0-9]*.md")))
CODE = re.compile(r"^```python(?: picture: ([^\n]+))?\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
VALUE = re.compile(r"<<(.+?)>>")
WORDS_PER_MINUTE = 200


class Measured(NamedTuple):
    """What a lesson's code printed, block by block, its values as the text shows them, its picture, its time [s]."""

    printed: list[str]
    values: dict[str, str]
    picture: bytes
    seconds: float


def source(name: str) -> str:
    return (SOURCES / f"{name}.md").read_text(encoding="utf-8")


def run(name: str) -> Measured:
    names: dict[str, Any] = {"__name__": "__main__"}
    printed, pictures, start = [], [], time.perf_counter()
    for count, block in enumerate(CODE.finditer(source(name))):
        outputs = run_cell(block[2], names, count)
        printed.append("".join("".join(o.get("text", ())) for o in outputs))
        pictures += [base64.b64decode(o["data"]["image/png"]) for o in outputs if "image/png" in o.get("data", {})]
    seconds = time.perf_counter() - start
    places = VALUE.findall(CODE.sub("", source(name)))
    values = {place: eval(f"f'''{{{place}}}'''", names).replace("-", "−") for place in places}
    return Measured(printed, values, *pictures, seconds)


def measure(lessons: Iterable[str]) -> None:
    for name in lessons:
        found = run(name)
        (PAGES / f"{name}.png").write_bytes(found.picture)
        stored = json.loads(STORE.read_text(encoding="utf-8")) if STORE.exists() else {}
        stored[name] = {"printed": found.printed, "values": found.values, "seconds": math.ceil(found.seconds)}
        text = json.dumps(stored, indent=1, sort_keys=True, ensure_ascii=False)
        STORE.write_text(text + "\n", encoding="utf-8")
        sys.stdout.write(f"measured: {name}, {found.seconds:.1f} s\n")


def parts(name: str) -> tuple[list[str], list[re.Match[str]], list[str], int]:
    """Texts with their values, the code blocks between them, what these printed, and the time [s]."""
    of = json.loads(STORE.read_text(encoding="utf-8"))[name]
    texts = [VALUE.sub(lambda place: of["values"][place[1]], text) for text in CODE.split(source(name))[::3]]
    return texts, list(CODE.finditer(source(name))), of["printed"], of["seconds"]


def page(name: str) -> str:
    texts, blocks, printed, seconds = parts(name)
    title, _, rest = texts[0].partition("\n")
    made = [rest]
    for block, said, text in zip(blocks, printed, texts[1:], strict=True):
        code = f"```python\n{block[2]}```\n"
        if block[1]:
            folded = f"<details markdown>\n<summary>Code of the picture</summary>\n\n{code}\n</details>\n"
            code = f"![{block[1]}]({name}.png)\n\n{folded}"
        made += [code, f"\n```text\n{said}```\n" if said else "", text]
    body = "".join(made)
    minutes = math.ceil(len(body.split()) / WORDS_PER_MINUTE)
    about = f"*{minutes} minutes to read. [Notebook]({name}.ipynb): this page to run, in {seconds}\N{NO-BREAK SPACE}s.*"
    return f"{title}\n\n{about}\n{body}"


def notebook(name: str) -> str:
    texts, blocks, _, _ = parts(name)
    cells = [("code", "%matplotlib inline\n")]
    for text, block in zip(texts, [*blocks, None], strict=True):
        cells += [("markdown", text)] * bool(text.strip())
        cells += [("code", block[2])] if block else []
    cells[:2] = cells[1::-1]  # the title comes first
    made = []
    for number, (kind, text) in enumerate(cells):
        lines = text.strip().splitlines(keepends=True)
        cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": lines}
        made.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def index() -> str:
    rows, total = [], 0
    for name in LESSONS:
        text = page(name)
        title, question = text.splitlines()[0][2:], re.search(r"\*\*(.+?)\*\*", text)
        minutes, seconds = re.findall(r"(\d+) minutes to read|in (\d+)\ss\.\*", text)[:2]
        assert question
        total += int(minutes[0])
        rows.append(f"| [{title}]({name}.md) | {question[1]} | {minutes[0]} | {seconds[1]} |")
    text = (SOURCES / "index.md").read_text(encoding="utf-8")
    return text.replace("<<lessons>>", "\n".join(rows)).replace("<<minutes>>", str(total))


MADE = {PAGES / "index.md": index} | {
    PAGES / f"{name}{suffix}": functools.partial(make, name)
    for name in LESSONS
    for suffix, make in ((".md", page), (".ipynb", notebook))
}
"""Each written file, and what makes it."""

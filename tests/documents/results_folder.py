"""docs/results-folder.md, out of the table of files and columns that the writers use."""

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from jinja2 import Environment

from eval.referee.result_files import BLANKS, DIFFERENCES, OF_LOGS, OF_RUNS, OTHERS, TOP, Column, File

PARTS = {
    "At the top": TOP, "Of each run": OF_RUNS, "Of each log": OF_LOGS, "For readers": OTHERS,
    "In Python only": (DIFFERENCES,),
}  # fmt: skip


def page() -> str:
    first: dict[Column, str] = {}  # the file that each column was described for

    def rows(file: File) -> Iterator[tuple[list[str], str, str]]:
        """Names of columns with one description, their type or unit if it is the same, and the description."""
        for about, group in groupby(file.columns, lambda c: f"as in `{first[c]}`" if c in first else c.about):
            columns = list(group)
            types, names = {c.unit or c.kind for c in columns}, [f"`{c.name}`" for c in columns]
            if about != columns[0].about:
                types = {""}
            elif len(types) > 1:
                units = [f" {c.unit}" * bool(c.unit and not c.name.endswith(f"_{c.unit}")) for c in columns]
                names, types = [name + unit for name, unit in zip(names, units, strict=True)], {""}
            yield names, types.pop(), about
        first.update({c: file.name for c in file.columns if c not in first})

    template = Path(__file__).with_suffix(".md.j2").read_text(encoding="utf-8")
    made = Environment(trim_blocks=True, lstrip_blocks=True).from_string(template)
    return made.render(parts=PARTS.items(), rows=rows, blanks=BLANKS).strip() + "\n"

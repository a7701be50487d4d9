"""`python -m eval.report.results_folder`: docs/results-folder.md, out of the table that the writers use."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

from eval.referee.result_files import BLANKS, DIFFERENCES, OF_LOGS, OF_RUNS, OTHERS, TOP, Column, File
from eval.report.words import say

PAGE = Path(__file__).parents[2] / "docs" / "results-folder.md"
PARTS = {
    "At the top": TOP,
    "Of each run": OF_RUNS,
    "Of each log": OF_LOGS,
    "For readers": OTHERS,
    "In Python only": (DIFFERENCES,),
}


def page() -> str:
    """The page in Markdown."""
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

    return say("results_folder", parts=PARTS.items(), rows=rows, blanks=BLANKS) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"written: {PAGE}\n")

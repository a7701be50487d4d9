"""`python -m eval.report.page.results_folder`: docs/results-folder.md, out of the table that the writers use."""

from __future__ import annotations

import sys
from itertools import groupby
from pathlib import Path

from eval.referee.result_files import BLANKS, DIFFERENCES, OF_LOGS, OF_RUNS, OTHERS, TOP, Column, File

PAGE = Path(__file__).parents[3] / "docs" / "results-folder.md"
HEAD = f"""\
# The result folder

<!-- Written by `make docs` out of eval/referee/result_files.py. Do not edit. -->

Every file and column that `slamref run` writes (default: `results/report`).

* Units are SI and radians unless a name ends in a unit. In brackets: the type (text, count, number) or the unit of a
  number; shares lie between 0 and 1.
* A blank cell is unknown or does not apply, never zero.
* In file names `:`, `+` and `/` of a log's name become `_`.
* Later versions may append columns, but never reorder or rename them.
* The same inputs and seed give the same bytes. Exceptions are measured times (`timing.csv`, `provenance.json`,
  `run.log`, tables that quote them) and, with `slamref lab`, `figures/lab-update-time.*` and `report.html`.

**Landmark numbers** are at least 0: the order of creation in SLAM, the map's ids in localization. A decision of `-1`
initialized a landmark, `-2` discarded the observation. A truth of `-1` means that no landmark of the map is right.

In Python, `slamref.score(trials)` has the tables `metrics`, `association`, `timing`, `relations` and `differences`.
Texts are `{BLANKS["text"]}`, numbers `{BLANKS["number"]}` (unknown: NaN), counts `{BLANKS["count"]}`
(unknown: `pd.NA`).
`slamref.notices(trials)` has the diagnostics, `slamref.sentence(notice)` their text.
"""


def page() -> str:
    """The page in Markdown."""
    first: dict[Column, str] = {}
    parts = [HEAD]
    for title, files in (
        ("At the top", TOP),
        ("Of each run", OF_RUNS),
        ("Of each log", OF_LOGS),
        ("For readers", OTHERS),
        ("In Python only", (DIFFERENCES,)),
    ):
        parts += [f"## {title}\n", *(_section(f, first) for f in files)]
    return "\n".join(parts)


def _section(file: File, first: dict[Column, str]) -> str:
    """A file; `first`: the file that each column was described for, which is added to."""
    about_file = f"{file.about[:-1]} ({file.when})." if file.when else file.about
    if not file.columns:
        return f"* `{file.path}`: {about_file}\n"
    rows = []
    for about, group in groupby(file.columns, lambda c: f"as in `{first[c]}`" if c in first else c.about):
        columns = list(group)
        types = [c.unit or c.kind for c in columns]
        names = [f"`{c.name}`" for c in columns]
        if about != columns[0].about:
            types = [""]
        elif len(set(types)) > 1:
            names = [f"`{c.name}`" + f" {c.unit}" * bool(c.unit and not c.name.endswith(f"_{c.unit}")) for c in columns]
            types = [""]
        bracket = f" [{types[0]}]" if types[0] else ""
        rows.append(f"| {', '.join(names)}{bracket} | {about.replace('|', chr(92) + '|')} |")
    first |= {c: file.name for c in file.columns if c not in first}
    head = f"### `{file.path}`\n\n{about_file}\n"
    return "\n".join([head, "| column [type or unit] | meaning |", "|---|---|", *rows, ""])


def main() -> int:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"written: {PAGE}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""`python -m eval.report.page.results_folder`: docs/results-folder.md, out of the table that the writers use."""

from __future__ import annotations

import sys
from pathlib import Path

from eval.referee.result_files import BLANKS, DIFFERENCES, OF_LOGS, OF_RUNS, OTHERS, TOP, File

PAGE = Path(__file__).parents[3] / "docs" / "results-folder.md"
HEAD = f"""\
# The result folder

<!-- Written by `make docs` out of eval/referee/result_files.py. Do not edit. -->

Every file that `slamref run` writes (default: `results/report`), and every column. SI units and radians, unless a name
ends in a unit. In file names `:`, `+` and `/` of a log's name become `_`. A blank cell is unknown or does not apply,
never zero. Columns may be appended in later versions, never reordered or renamed. Two runs with the same inputs and
seed write the same bytes, except in `timing.csv`, `provenance.json`, `run.log`, the tables that quote a time, and with
`--lab corridor:...` the figure of measured update times (`figures/lab-update-time.*`), its table, and `report.html`,
which shows it.

**Decisions.** A landmark number is ≥ 0: the order of creation in SLAM, the map's own id in localization. `-1` in a
decision: the observation initialized a new landmark. `-2`: it was discarded. `-1` in a truth: the right landmark is
not in the map, or the observation was clutter.

From Python, `slamref.score(trials)` has the same tables as attributes: `metrics`, `association` (association.csv),
`timing`, `relations` and `differences`, with the types below: words are `{BLANKS["text"]}`, numbers
`{BLANKS["number"]}` (unknown: NaN), counts `{BLANKS["count"]}` (unknown: `pd.NA`).
`slamref.notices(trials)` has what notices.csv holds, with types; `slamref.sentence(notice)` is its text.
"""


def page() -> str:
    """The page in Markdown."""
    parts = [HEAD, "## At the top\n", *(_section(f) for f in TOP)]
    parts += ["## Of each run\n", *(_section(f) for f in OF_RUNS), "## Of each log\n", *(_section(f) for f in OF_LOGS)]
    parts += ["## For readers\n", *(_section(f) for f in OTHERS), "## In Python only\n", _section(DIFFERENCES)]
    return "\n".join(parts)


def _section(file: File) -> str:
    when = f" ({file.when})" if file.when else ""
    if not file.columns:
        return f"* `{file.path}`: {file.about}{when}\n"
    head = f"### `{file.path}`\n\n{file.about}{when}\n"
    rows = [f"| `{c.name}` | {c.kind} | {c.unit} | {_cell(c.about)} |" for c in file.columns]
    return "\n".join([head, "| column | type | unit | what it holds |", "|---|---|---|---|", *rows, ""])


def _cell(text: str) -> str:
    return text.replace("|", r"\|")


def main() -> int:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"written: {PAGE}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

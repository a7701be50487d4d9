"""`slamref report DIR`: show the report of a result folder in the browser."""

import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from data.errors import UsageError
from data.terminal import ended
from eval.plan.flags import command_of

PROG = "python -m eval.open_report"


def show(folder: Path) -> None:
    """Open `report.html` of a folder in the browser, or print its address. UsageError: the folder has no report."""
    page = folder.absolute() / "report.html"
    if not page.is_file():
        raise UsageError(f"{folder}: no report.html; `slamref run LOG --out {folder}` writes one")
    if not webbrowser.open(page.as_uri()):
        sys.stdout.write(f"no browser found; open {page.as_uri()}\n")


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    return ended(lambda: show(command_of(prog, PROG, "report").read(argv).folder))


if __name__ == "__main__":
    sys.exit(main())

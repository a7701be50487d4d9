"""`slamref report DIR`: show the report of a result folder in the browser."""

import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from data.command import Command
from data.errors import UsageError
from data.terminal import ended

PROG = "python -m eval.open_report"
DEFAULT = Path("results/report")


def show(folder: Path) -> None:
    """Open `report.html` of a folder in the browser, or print its address. UsageError: the folder has no report."""
    page = folder.absolute() / "report.html"
    if not page.is_file():
        raise UsageError(f"{folder}: no report.html; `slamref run LOG --out {folder}` writes one")
    if not webbrowser.open(page.as_uri()):
        sys.stdout.write(f"no browser found; open {page.as_uri()}\n")


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    p = Command(prog, PROG, "Show the report of a result folder in the browser.", f"examples:\n  {PROG} results/report")
    about = f"the result folder (default: {DEFAULT})"
    p.add_argument("folder", metavar="DIR", type=Path, nargs="?", default=DEFAULT, help=about)
    return ended(lambda: show(p.read(argv).folder))


if __name__ == "__main__":
    sys.exit(main())

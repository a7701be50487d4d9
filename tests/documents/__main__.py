"""`python -m tests.documents` (`make docs`): write the generated pages, and the measured numbers into all pages."""

import argparse
import sys
from pathlib import Path

from tests.documents import api, course, measured, results_folder
from tests.documents.measures import MEASURES, measure

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {DOCS / "api.md": api.page, DOCS / "results-folder.md": results_folder.page, **course.MADE}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--measure",
        metavar="RESULTS",
        help=f"measure anew, of {', '.join((*MEASURES, *measured.EXAMPLES))}, course, lessons by name, or all",
    )
    if asked := parser.parse_args().measure:
        names = asked.replace("all", ",".join([*MEASURES, *measured.EXAMPLES, "course"])).replace(
            "course", ",".join(course.LESSONS)
        )
        course.measure(name for name in names.split(",") if name in course.LESSONS)
        measure(name for name in names.split(",") if name not in course.LESSONS)
    for path, page in PAGES.items():
        path.write_text(page(), encoding="utf-8")
    for path, text in measured.pages().items():
        path.write_text(text, encoding="utf-8")
        sys.stdout.write(f"written: {path.name}\n")


if __name__ == "__main__":
    main()

"""`python -m tests.documents` (`make docs`): write the generated pages, and the measured numbers into all pages."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.documents import api, results_folder

DOCS = Path(__file__).parents[2] / "docs"
PAGES = {DOCS / "api.md": api.page, DOCS / "results-folder.md": results_folder.page}

if __name__ == "__main__":
    for path, page in PAGES.items():
        path.write_text(page(), encoding="utf-8")
        sys.stdout.write(f"written: docs/{path.name}\n")

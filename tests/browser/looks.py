"""`python -m tests.browser.looks OUT` (`make looks`): pictures of twelve pages at three widths, to be looked at."""

import sys
from collections.abc import Iterator
from pathlib import Path

from playwright.sync_api import sync_playwright

import slamref
from tests.browser.opened import CHROMIUM

WIDTHS = (1400, 800, 400)
METHODS = "known,nn,gnn,jcbb,jcbb-hindsight"
COMMANDS = {
    "arena": ("run", "arena:0", "--task", "localization,slam"),
    "methods": ("run", "corridor:0:people", "--task", "slam", "--estimator", "ekf,batch", "--association", METHODS),
    "laser": ("run", "floorplan:0"), "twins": ("run", "arena:0", "--task", "slam", "--twins", "19"),
    "study": ("study", "circle", "--runs", "5"), "lab": ("lab", "corridor:3"),
}  # fmt: skip
"""Result folders that pages are taken of."""
PAGES = {
    "arena": "arena/report.html", "arena-details": "arena/details/*.html", "methods": "methods/report.html",
    "methods-details": "methods/details/*.html", "laser": "laser/report.html",
    "laser-details": "laser/details/*.html", "twins": "twins/report.html", "twins-details": "twins/details/*.html",
    "study": "study/report.html", "lab": "lab/report.html", "player": "methods/players/*.html",
    "lab-details": "lab/details/*.html",
}  # fmt: skip
"""Files of these folders; of several the first."""


def pages(folder: Path) -> Iterator[tuple[str, Path]]:
    for name, words in COMMANDS.items():
        if not (folder / name).exists() and slamref.main([*words, "--out", str(folder / name), "-q"]) == 2:
            raise SystemExit(f"slamref {' '.join(words)} failed")
    for name, pattern in PAGES.items():
        yield name, min(folder.glob(pattern))


def main(folder: Path) -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        for name, path in pages(folder):
            for width in WIDTHS:
                page = browser.new_page(viewport={"width": width, "height": 900})
                page.goto(path.resolve().as_uri())
                wide = page.evaluate("document.documentElement.scrollWidth")
                page.screenshot(path=folder / f"{name}-{width}.png", full_page=True)
                page.close()
                over = f"  wider than the window: {wide} px" if wide > width else ""
                sys.stdout.write(f"{name}-{width}.png{over}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "build/looks"))

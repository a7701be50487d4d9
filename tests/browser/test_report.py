"""The report in a real headless browser: nothing wider than the page, the overview whole, sections on their own paper.

`make test-browser`; needs the extra `browser` (Playwright) and a Chromium on PATH, and is skipped without.
"""

from __future__ import annotations

import pytest

from eval.report.page.blocks import Overview, OverviewRow, Report, Section
from eval.report.render import write_report
from tests.browser.opened import WIDTHS

pytestmark = pytest.mark.browser
ROW = OverviewRow("people+no-odometry, slam", "A", ("smoother", "0.0227", "0.00826", "2.75", "jcbb-hindsight\n9 FP"))
BREAKS = "Array.from(document.querySelectorAll('section'), (s) => getComputedStyle(s).breakBefore)"


def breaks_on_paper(chromium, folder, first):
    overview = Overview(("log", "trust", "filter", "smoother", "ratio", "best"), (ROW,), "What it means.")
    below = tuple(Section(name, ("Text.",)) for name in "AB")
    write_report(folder, Report("Title", "command", (overview,), below, tuple(Section(n, ("Text.",)) for n in first)))
    page = chromium.new_page()
    page.goto((folder / "report.html").as_uri())
    page.emulate_media(media="print")
    found = page.evaluate(BREAKS)
    page.close()
    return found


def test_each_section_begins_a_page_but_a_single_one_under_the_overview(chromium, tmp_path):
    assert breaks_on_paper(chromium, tmp_path, ["Cause"]) == ["auto", "page", "page"]
    assert breaks_on_paper(chromium, tmp_path, ["Question 1", "Question 2"]) == ["page"] * 4


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_is_no_wider_than_the_window_and_the_overview_is_whole_from_1100(chromium, results, width):
    page = chromium.new_page(viewport={"width": width, "height": 900})
    page.goto((results / "report.html").as_uri())
    page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    inner, outer = page.evaluate(
        "(({ scrollWidth: a, clientWidth: b }) => [a, b])(document.querySelector('.overview .scroll'))"
    )
    assert inner <= outer or width < 1100
    page.close()

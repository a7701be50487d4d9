"""The page's parts: the overview, folded text, captions of two lines, rows apart, fine print once, small figures."""

from __future__ import annotations

import re

import pandas as pd
import pytest
from matplotlib.figure import Figure

from eval.figures.style import save
from eval.report.page.blocks import (
    FinePrint,
    Folded,
    Mark,
    Overview,
    OverviewRow,
    Picture,
    Report,
    Section,
    Sketch,
    Table,
    folded,
)
from eval.report.render import write_report

FINE = FinePrint("Errors", "What all errors mean.")
FRAME = pd.DataFrame({"estimator": ["ekf", "lost", "batch"], "RMSE": [0.1, 9e7, 0.05]})
LONG = "First sentence. " + "Another sentence of the caption that says more than fits. " * 8
OVERVIEW = Overview(
    ("log", "trust", "map"),
    (
        OverviewRow("a:1, slam", "a:1, slam", (Mark("smoother", "good", "why"), Sketch("<svg></svg>", "Map of a")),
                    (("play", "players/a_1.html"),)),
        OverviewRow("b<2>, slam", "b<2>, slam", (Mark("neither", "bad"), None)),
    ),
    "What it means.",
)  # fmt: skip
REPORT = Report(
    "Title",
    "command",
    ("Two sentences.", OVERVIEW),
    (
        Section("a:1, slam", (Table(FRAME, "Caption.", fine=FINE, apart=(1,)), Folded("In full", ("Long prose.",)))),
        Section("b<2>, slam", (Table(FRAME, LONG, fine=FINE), Picture("dots", "Dots.", "Dots on white"))),
    ),
    (Section("Attribution", ("The cause.",)),),
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    fig = Figure(figsize=(7, 5))
    fig.subplots().plot(range(50), [i % 7 for i in range(50)], marker="o")
    save(fig, folder / "figures", "dots", formats=("png",))
    write_report(folder, REPORT)
    png = (folder / "figures" / "dots.png").stat().st_size
    return (folder / "report.html").read_text(encoding="utf-8"), (folder / "report.md").read_text(encoding="utf-8"), png


def test_a_row_points_to_its_section_and_has_symbol_word_and_picture_with_words(pages):
    html, text, _ = pages
    assert re.search(r'<th scope="row"><a href="#a-1-slam">a:<wbr>1, slam</a> <a class="more" href="players/a_1', html)
    assert '<span class="mark good"><span aria-hidden="true">✓</span> smoother</span><small>why</small>' in html
    assert '<span class="mark bad"><span aria-hidden="true">✗</span> neither</span>' in html
    assert 'role="img" aria-label="Map of a"' in html
    assert "b&lt;2&gt;, slam" in html
    assert "| [a:1, slam](#a1-slam) [play](players/a_1.html) | ✓ **smoother** (why) |" in text


def test_rows_in_no_comparison_stand_beneath_the_others(pages):
    html, text, _ = pages
    body = html[html.index("Table 1.") :]
    order = [body.index(part) for part in ("<td>ekf", "<td>batch", "Diverged, incomplete", "<td>lost")]
    assert order == sorted(order)
    assert text.index("| batch | 0.0500") < text.index("| lost | 9.00e+07")


def test_fine_print_stands_once_and_captions_point_to_it(pages):
    html, text, _ = pages
    assert html.count("What all errors mean.") == text.count("What all errors mean.") == 1
    assert html.count('<a href="#how-to-read-this">') == 3  # two captions, contents
    assert text.count("(#how-to-read-this)") == 2


def test_every_table_scrolls_in_a_box_that_the_keyboard_reaches(pages):
    html = pages[0]
    assert html.count("<table>") == html.count('<div class="scroll" role="region" aria-label=') == 3
    assert html.count('tabindex="0"><table>') == 3
    assert html.index('class="skip"') < html.index("<h1>")


def test_a_text_is_folded_after_three_lines_and_nothing_of_it_is_lost():
    assert folded("Short.", "More") == ("Short.",)
    assert folded("", "More") == ()
    words = "One sentence with 1.5 m in it. " * 40
    front, more = folded(words.strip(), "More")
    assert isinstance(more, Folded)
    assert len(front) <= 420
    assert f"{front} {more.blocks[0]}" == words.strip()
    front, more = folded("* First point.\n  * of it\n* " + words, "More")
    assert front.startswith("First point.")
    assert more.blocks[0].startswith("* One sentence")


def test_a_section_of_details_is_a_page_of_its_own_with_the_way_back(tmp_path):
    table = Table(FRAME, "All columns.", "a-comparison", fine=FINE)
    details = (Section("a: details", (table,), page="a"), Section("Trust", ("Words.",), 3, page="a"))
    write_report(tmp_path, Report("Title", "command", ("Two sentences.",), (Section("a", ("Short.",)), *details)))
    report, page = ((tmp_path / name).read_text(encoding="utf-8") for name in ("report.html", "details/a.html"))
    assert '<a href="details/a.html">a</a>' in report
    assert "All columns." not in report
    for part in ('<a href="../report.html">', "<h1>a: details</h1>", 'href="../tables/a-comparison.csv"',
                 '<h2 id="trust">', "What all errors mean."):  # fmt: skip
        assert part in page

"""The report: self-contained HTML and Markdown with the same content, in order, with everything escaped."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

import cv2
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from eval.figures.style import save
from eval.report.page.blocks import Picture, Report, Section, Table, anchor
from eval.report.render import write_report

TABLE = pd.DataFrame({"estimator": ["ekf<1>", "batch"], "position RMSE [m]": [0.0991, None]}, dtype=object)
REPORT = Report(
    title="Filter & smoother",
    command="python -m eval.run_all --log 'a<b'",
    introduction=("The **answer** first.",),
    sections=(
        Section("Log arena:0", ("A paragraph with `code`.", Table(TABLE, "Errors, *no alignment*.", "arena"))),
        Section("Map", (Picture("map", "All paths.", 'Paths "seen" from above'),), level=3),
        Section("Log arena:0", ("- one\n- two <script>alert(1)</script>", Table(TABLE, "Again."))),
        Section("Provenance", ("[metrics](metrics.csv)",)),
    ),
)
VOID = {"meta", "img", "br", "hr", "link"}


class Page(HTMLParser):
    """Tags with their attributes, text, and whether every tag is closed where it should be."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    def all(self, tag):
        return [a for t, a in self.tags if t == tag]


@pytest.fixture
def folder(tmp_path):
    save(Figure(figsize=(2, 1)), tmp_path / "figures", "map", formats=("png",))
    write_report(tmp_path, REPORT)
    return tmp_path


def test_html_is_well_formed_and_needs_nothing_from_outside(folder):
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert page.all("script") == page.all("link") == page.all("iframe") == []
    loaded = [a[k] for _, a in page.tags for k in ("src", "data", "poster", "srcset") if k in a]
    assert all(re.match(r"data:image/(png|webp);base64,", source) for source in loaded)
    assert len(loaded) == 1
    assert not re.search(r"@import|url\(|https?://", text)
    assert {
        "http-equiv": "Content-Security-Policy",
        "content": "default-src 'none'; img-src data:; style-src 'unsafe-inline'",
    } in page.all("meta")


def test_html_holds_the_figure_itself_with_its_description_and_page_size(folder):
    image = Page((folder / "report.html").read_text(encoding="utf-8")).all("img")[0]
    shown = base64.b64decode(image["src"].split(",")[1])
    drawn = (folder / "figures" / "map.png").read_bytes()
    assert len(shown) <= len(drawn)
    pixels = [cv2.imdecode(np.frombuffer(b, np.uint8), cv2.IMREAD_COLOR).astype(int) for b in (shown, drawn)]
    assert pixels[0].shape == pixels[1].shape
    assert np.abs(pixels[0] - pixels[1]).max() < 96
    assert image["alt"] == 'Paths "seen" from above'
    # 2 in at 200 pixels per inch, two for a page pixel
    assert (image["width"], image["height"]) == ("200", "100")


def test_text_from_outside_stays_text(folder):
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    words = "".join(page.words)
    for text in ("Filter & smoother", "--log 'a<b'", "ekf<1>", "<script>alert(1)</script>"):
        assert text in words


def test_headings_have_addresses_of_their_own_that_the_contents_point_to(folder):
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    ids = [a["id"] for _, a in page.tags if "id" in a]
    assert ids == ["contents", "log-arena-0", "map", "log-arena-0-2", "provenance"]
    assert [a["href"] for a in page.all("a") if a["href"].startswith("#")] == [
        "#log-arena-0",
        "#log-arena-0-2",
        "#provenance",
    ]
    assert anchor("σ") == "section"


def test_both_forms_have_the_same_parts_in_the_same_order(folder):
    text = (folder / "report.md").read_text(encoding="utf-8")
    words = " ".join("".join(Page((folder / "report.html").read_text(encoding="utf-8")).words).split("\n"))
    for form, parts in (
        (
            text,
            "# Filter & smoother|The **answer**|python -m eval.run_all|## Log arena:0|**Table 1.** Errors|0.0991|"
            "### Map|(figures/map.png)|**Figure 1.** All paths.|**Table 2.** Again.|## Provenance",
        ),
        (
            words,
            "The answer first.|A paragraph|Table 1. Errors, no alignment.|0.0991|"
            "Figure 1. All paths.|Table 2. Again.|metrics|python -m eval.run_all",
        ),
    ):
        places = [form.index(part) for part in parts.split("|")]
        assert places == sorted(places)
    assert "([CSV](tables/arena.csv))" in text
    assert [(folder / place).exists() for place in re.findall(r"!\[.*?\]\((.*?)\)", text)] == [True]


def test_a_missing_figure_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"map\.png"):
        write_report(tmp_path, REPORT)

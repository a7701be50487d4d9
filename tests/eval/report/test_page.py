"""The report as a page: HTML and Markdown with the same content, escaped, folded, numbered; tables in every format."""

import html
import io
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from markdown_it import MarkdownIt
from matplotlib.figure import Figure
from PIL import Image

from eval.figures.figure_style import tex_escape
from eval.figures.style import save
from eval.referee.result_files import CONSISTENCY, DECISION_COUNTS, METRICS
from eval.report import comparison
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
    anchor,
    folded,
)
from eval.report.page.files import cell_texts, drop_blank_columns, markdown, write_table
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


def test_text_from_outside_stays_text_and_headings_have_addresses(folder):
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    words = "".join(page.words)
    for text in ("Filter & smoother", "--log 'a<b'", "ekf<1>", "<script>alert(1)</script>"):
        assert text in words
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    ids = [a["id"] for _, a in page.tags if "id" in a]
    assert ids == ["contents", "log-arena-0", "map", "log-arena-0-2", "provenance"]
    links = [a["href"] for a in page.all("a") if a["href"].startswith("#")]
    assert links == ["#log-arena-0", "#log-arena-0-2", "#provenance"]
    assert anchor("σ") == "section"


def test_both_forms_have_the_same_parts_in_the_same_order(folder):
    text = (folder / "report.md").read_text(encoding="utf-8")
    for form, parts in (
        (
            text,
            "# Filter & smoother|The **answer**|python -m eval.run_all|## Log arena:0|**Table 1.** Errors|0.0991|"
            "### Map|(figures/map.png)|**Figure 1.** All paths.|**Table 2.** Again.|## Provenance",
        ),
        (
            " ".join("".join(Page((folder / "report.html").read_text(encoding="utf-8")).words).split("\n")),
            "The answer first.|A paragraph|Table 1. Errors, no alignment.|0.0991|"
            "Figure 1. All paths.|Table 2. Again.|metrics|python -m eval.run_all",
        ),
    ):
        places = [form.index(part) for part in parts.split("|")]
        assert places == sorted(places)
    assert "([CSV](tables/arena.csv))" in text
    assert [(folder / place).exists() for place in re.findall(r"!\[.*?\]\((.*?)\)", text)] == [True]


FINE = FinePrint("Errors", "What all errors mean.")
RUNS = pd.DataFrame({"estimator": ["ekf", "lost", "batch"], "RMSE": [0.1, 9e7, 0.05]})
LONG = "First sentence. " + "Another sentence of the caption that says more than fits. " * 8
OVERVIEW = Overview(
    ("log", "trust", "map"),
    (
        OverviewRow("a:1, slam", "a:1, slam", (Mark("smoother", "good", "why"), Sketch("<svg></svg>", "Map of a")),
                    (("play", "players/a_1.html"),)),
        OverviewRow("b<2>, slam", "b<2>, slam", (Mark("neither", "bad", "next: `--calibrate`"), None)),
    ),
    "What it means.",
)  # fmt: skip
WHOLE = Report(
    "Title",
    "command",
    ("Two sentences.", OVERVIEW),
    (
        Section("a:1, slam", (Table(RUNS, "Caption.", fine=FINE), Folded("In full", ("Long prose.",)))),
        Section("b<2>, slam", (Table(RUNS, LONG, fine=FINE), Picture("dots", "Dots.", "Dots on white"))),
    ),
    (Section("Attribution", ("The cause.",)),),
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    fig = Figure(figsize=(7, 5))
    fig.subplots().plot(range(50), [i % 7 for i in range(50)], marker="o")
    save(fig, folder / "figures", "dots", formats=("png",))
    write_report(folder, WHOLE)
    png = (folder / "figures" / "dots.png").stat().st_size
    return (folder / "report.html").read_text(encoding="utf-8"), (folder / "report.md").read_text(encoding="utf-8"), png


def test_rows_tables_and_fine_print_of_the_page_are_linked_marked_and_reachable(pages):
    html, text, _ = pages
    assert re.search(r'<th scope="row"><a href="#a-1-slam">a:<wbr>1, slam</a> <a class="more" href="players/a_1', html)
    assert '<span class="mark good"><span aria-hidden="true">✓</span> smoother</span><small>why</small>' in html
    assert (
        '<span class="mark bad"><span aria-hidden="true">✗</span> neither</span><small>next: <code>--calibrate</code>'
        in html
    )
    assert 'role="img" aria-label="Map of a"' in html
    assert "b&lt;2&gt;, slam" in html
    assert "| [a:1, slam](#a1-slam) [play](players/a_1.html) | ✓ **smoother** (why) |" in text
    html, text, _ = pages
    assert html.index('id="overview"') < html.index('id="attribution"') < html.index('id="a-1-slam"')
    assert html.count("What all errors mean.") == text.count("What all errors mean.") == 1
    assert html.count('<a href="#how-to-read-this">') == 3  # two captions, contents
    assert text.count("(#how-to-read-this)") == 2
    html = pages[0]
    assert html.count("<table>") == html.count('<div class="scroll" role="region" aria-label=') == 3
    assert html.count('tabindex="0"><table>') == 3
    assert html.index('class="skip"') < html.index("<h1>")


def test_a_phone_gets_the_figure_that_was_drawn_for_it(tmp_path):
    (tmp_path / "figures").mkdir()
    for name, width in (("dots", 140), ("dots-narrow", 70)):
        Image.new("RGB", (width, 40)).save(tmp_path / "figures" / f"{name}.png")
    write_report(tmp_path, Report("Title", "command", (Picture("dots", "Dots.", "Dots on white"),), ()))
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert re.search(r'<picture><source media="\(max-width: 40rem\)" width="35" .*<img width="70" .*</picture>', html)
    assert 'wide-picture"' not in html


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
    table = Table(RUNS, "All columns.", "a-comparison", fine=FINE)
    details = (Section("a: details", (table,), page="a"), Section("Trust", ("Words.",), 3, page="a"))
    write_report(tmp_path, Report("Title", "command", ("Two sentences.",), (Section("a", ("Short.",)), *details)))
    report, page = ((tmp_path / name).read_text(encoding="utf-8") for name in ("report.html", "details/a.html"))
    assert '<a href="details/a.html">a</a>' in report
    assert "All columns." not in report
    for part in ('<a href="../report.html">', "<h1>a: details</h1>", 'href="../tables/a-comparison.csv"',
                 '<h2 id="trust">', "What all errors mean."):  # fmt: skip
        assert part in page


FRAME = pd.DataFrame(
    {
        "estimator": ["ekf_slam", "batch | final", "gnc"], "position RMSE [m]": [0.09912, 0.0862, None],
        "inside 3σ [%]": [98.913, 100.0, np.nan], "accepted": [812, 840, None],
    },
    dtype=object,
)  # fmt: skip


def cells_of(table: str) -> list[list[str]]:
    rows = re.findall(r"<tr>(.*?)</tr>", MarkdownIt("commonmark").enable("table").render(table), re.S)
    return [[html.unescape(c) for c in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.S)] for row in rows]


@pytest.mark.parametrize(("column", "expected"), [
    ([0.09912, 0.0862, 0.1041], ["0.0991", "0.0862", "0.104"]), ([51.61, 3.0, 2.912], ["51.6", "3.00", "2.91"]),
    ([812, None, 3], ["812", "", "3"]), ([812.0, float("nan")], ["812", ""]), ([-0.5, 0.25], ["−0.500", "0.250"]),
    ([0.0, 0.0312], ["0", "0.0312"]), ([2e13, 3.1], ["2.00e+13", "3.10"]),
    ([123456.7, 23456.0], ["123457", "23456"]), ([True, False, None], ["yes", "no", ""]), ([None, None], ["", ""]),
    (["ok", None], ["ok", ""]), ([float("inf"), 1.5], ["", "1.50"]),
])  # fmt: skip
def test_numbers_have_three_digits_and_what_is_unknown_is_blank(column, expected):
    assert cell_texts(column) == expected


def test_markdown_shows_the_rounded_cells_and_only_blank_columns_are_dropped():
    text = markdown(FRAME)
    assert cells_of(text) == [
        ["estimator", "position RMSE [m]", "inside 3σ [%]", "accepted"],
        ["ekf_slam", "0.0991", "98.9", "812"],
        ["batch | final", "0.0862", "100", "840"],
        ["gnc", "", "", ""],
    ]
    assert text.splitlines()[1] == "| --- | ---: | ---: | ---: |"
    frame = pd.DataFrame({"a": [None, 1.0], "b": [np.nan, None], "c": ["", None], "d": [0, None]}, dtype=object)
    assert list(drop_blank_columns(frame).columns) == ["a", "d"]


@given(st.text(st.characters(blacklist_categories=("Cc", "Cs", "Zl", "Zp", "Zs"), max_codepoint=0x2FFF), min_size=1))
def test_markdown_shows_any_text_as_it_is(text):
    assert cells_of(markdown(pd.DataFrame({"a": [f"x{text}x"], "b": [1]})))[1] == [f"x{text}x", "1"]


@given(st.text(st.characters(blacklist_categories=("Cc", "Cs"), max_codepoint=0x24F)))
def test_latex_leaves_no_special_character_of_a_text_active(text):
    plain = re.sub(r"\\[\\&%$#_{}]", "", tex_escape(text))
    assert plain.count("{") == plain.count("}")
    assert plain.count("$") % 2 == 0
    assert not re.search(r"[&%#~^<>|_]", re.sub(r"\$[^$]*\$", "", plain.replace("~", "", text.count("\u00a0"))))
    commands = set(re.findall(r"\\(.[a-z]*)", plain))
    assert commands <= {"textbackslash", "textasciitilde", "textasciicircum", "dots", "circ", "times", "pm", "mu"}


def test_csv_keeps_every_digit_and_tables_come_in_the_formats_asked_for_twice_alike(tmp_path):
    frame = pd.DataFrame({"name": ["a", "b"], "x [m]": [0.1 + 0.2, None], "n": [3, None]}, dtype=object)
    write_table(frame, tmp_path, "t", "caption", formats=("csv",))
    text = (tmp_path / "t.csv").read_text(encoding="utf-8")
    assert text == "name,x [m],n\na,0.30000000000000004,3\nb,,\n"
    assert float(pd.read_csv(io.StringIO(text), dtype=str)["x [m]"][0]) == 0.1 + 0.2
    first = write_table(FRAME, tmp_path / "a", "t", "caption")
    second = write_table(FRAME, tmp_path / "b", "t", "caption")
    assert [p.name for p in first] == ["t.csv", "t.md", "t.tex"]
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]
    assert not any(b"\r" in p.read_bytes() for p in first)
    assert (tmp_path / "a" / "notes.tex").read_bytes() == (tmp_path / "b" / "notes.tex").read_bytes()
    assert [p.name for p in write_table(FRAME, tmp_path / "c", "t", "caption", formats=("md",))] == ["t.md"]
    with pytest.raises(ValueError, match="table format 'xlsx'; known: csv, md, tex"):
        write_table(FRAME, tmp_path / "d", "t", "caption", formats=("xlsx",))


def metrics_rows(**changes) -> pd.DataFrame:
    row = {
        "log": "arena", "task": "slam", "estimator": "ekf", "association": "known", "phase": "online", "status": "ok",
        "accepted": 812, "rejected": 28, "rmse_position_m": 0.1, "nis": 1.9, "nis_lower": 0.9712, "nis_upper": 1.0331,
        "inside_3sigma": 0.9889,
    } | changes  # fmt: skip
    return METRICS.table([row])


def test_comparison_and_consistency_have_human_heads_bounds_percent_and_power():
    table = comparison.comparison_table(metrics_rows())
    assert table.to_dict("records") == [
        {
            "estimator": "ekf", "association": "known", "phase": "online", "position RMSE [m]": 0.1,
            "NIS per dof (expected 1)": 1.9, "95 % bounds of NIS": "0.971–1.033",
            "inside 3σ (expected 98.9) [%]": pytest.approx(98.89), "accepted": 812, "rejected": 28,
        }
    ]  # fmt: skip
    stopped = metrics_rows(estimator="batch", status="diverged")
    both = comparison.comparison_table(pd.concat([stopped, metrics_rows()]))
    assert both["estimator"].tolist() == ["ekf", "batch"]  # what is in no comparison comes last
    row = {
        "scenario": "arena", "estimator": "ekf", "quantity": "pose", "dof": 3, "runs": 50, "mean": 3.05, "lower": 2.93,
        "upper": 3.17, "verdict": "consistent", "power": 0.993, "phase": "online",
    }  # fmt: skip
    table = comparison.consistency_table(CONSISTENCY.table([row]))
    assert table["95 % interval of the mean"].tolist() == ["2.93–3.17"]
    assert table["power against 0.8 P [%]"].tolist() == [pytest.approx(99.3)]
    assert "scenario" not in table


def test_association_table_shows_the_final_phase_only_where_something_was_revised():
    row = {
        "log": "a", "task": "slam", "estimator": "ekf", "association": "jcbb", "tp": 5, "precision": 0.5,
        "recall": 1.0,
    }  # fmt: skip
    rows = [
        {**row, "phase": "online"}, {**row, "phase": "final"},
        {**row, "estimator": "isam2", "phase": "online"}, {**row, "estimator": "isam2", "phase": "final", "tp": 6},
    ]  # fmt: skip
    table = comparison.association_table(DECISION_COUNTS.table(rows))
    assert table[["estimator", "phase", "TP"]].to_numpy().tolist() == [
        ["ekf", "online", 5], ["isam2", "online", 5], ["isam2", "final", 6],
    ]  # fmt: skip
    assert table["precision [%]"].tolist() == [50.0, 50.0, 50.0]

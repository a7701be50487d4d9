"""Figures for a column: as wide as asked, nothing outside, no text on another; as usual where nothing is asked."""

from __future__ import annotations

import itertools

import pytest
from matplotlib import font_manager, image
from matplotlib.figure import Figure
from matplotlib.text import Text

import slamref
from data.errors import UsageError
from eval.figures.claims import nees_figure
from eval.figures.error import error_figure
from eval.figures.figure_style import FigureStyle, figure_style
from eval.figures.map import map_figure
from eval.figures.style import across, drawing, page_width, save, translate
from eval.plan.flags import options as appearance
from eval.plan.flags.options import read_options
from eval.plan.flags.table import Output, inches

COLUMN = FigureStyle(width=3.4, fonts=("STIXGeneral", "DejaVu Sans"), mathematics="stix")


@pytest.fixture(scope="module")
def runs():
    log = slamref.open_log("arena:0:frames=40")
    return log, slamref.compare(log.inputs(labels=True), "slam", ("dead-reckoning", "ekf", "isam2", "batch"))


def texts(fig):
    """Boxes of titles and legends, in pixels."""
    fig.draw_without_rendering()
    found = [t for ax in fig.axes for t in (ax.title, ax._left_title)] + [fig._suptitle]
    shown = [t for t in found if t is not None and t.get_text()]
    return [(t.get_text(), t.get_window_extent()) for t in shown] + [
        ("legend", legend.get_window_extent()) for legend in fig.legends
    ]


@pytest.mark.slow
@pytest.mark.parametrize("draw", [error_figure, nees_figure, map_figure])
def test_a_figure_for_a_column_has_room_for_every_title_and_legend(draw, runs, tmp_path, monkeypatch):
    log, made = runs
    seen = {}
    with figure_style(COLUMN), drawing():
        fig = draw(log, made)
        monkeypatch.setattr(fig, "clear", lambda: None)
        (path,) = save(fig, tmp_path, "f", ("png",))
        seen = texts(fig)
        page = fig.bbox
    assert path.exists()
    assert fig.get_size_inches()[0] == pytest.approx(3.4)
    for text, box in seen:
        assert box.x0 >= page.x0 - 1 and box.x1 <= page.x1 + 1, text  # noqa: PT018
        assert box.y0 >= page.y0 - 1 and box.y1 <= page.y1 + 1, text  # noqa: PT018
    for (a, one), (b, other) in itertools.combinations(seen, 2):
        assert not one.overlaps(other), f"{a!r} is on {b!r}"


def titled():
    fig = Figure(figsize=(2.0, 2.0))
    fig.add_subplot().set_title("a title that is far too long for a page of two inches", loc="left")
    return fig


def test_a_saved_page_is_longer_by_the_lines_of_its_title_where_a_width_is_wished_for(tmp_path):
    def pixels(path):
        return image.imread(path).shape[:2]

    with drawing():
        fig = titled()
    assert pixels(*save(fig, tmp_path / "usual", "f", ("png",))) == (400, 400)
    with figure_style(FigureStyle(width=2.0)), drawing():
        written = save(titled(), tmp_path / "column", "f", ("png",))
    height, width = pixels(*written)
    lines = (height - 400) / (8.0 * 1.25 / 72.0 * 200.0)  # type of 8 pt in lines of 10 pt
    assert width == 400
    assert lines == pytest.approx(round(lines), abs=0.05)
    assert 1 <= round(lines) <= 4


def test_panels_side_by_side_are_two_at_most_in_a_column():
    assert (page_width(), across(4)) == (7.0, 4)
    with figure_style(COLUMN):
        assert (page_width(), across(4)) == (3.4, 2)
    assert page_width() == 7.0


def test_lengths_have_units():
    assert [inches(t) for t in ("3.4in", "8.636cm", "86.36mm", "252pt")] == pytest.approx(
        [3.4, 3.4, 3.4, 3.487], abs=2e-3
    )
    for wrong, said in (("3.4", "a length with its unit"), ("3.4ft", "a length"), ("0.1in", "between 1.5in and 20in")):
        with pytest.raises(UsageError, match=f"--figure-width {wrong}: {said}"):
            read_options(["--figure-width", wrong])


def test_a_font_that_is_not_here_is_replaced_and_that_is_said(monkeypatch):
    look, said = appearance.figure_style_of(read_options(["--font", "Nowhere Grotesk"]).drawing, Output())
    assert look.fonts == ("DejaVu Sans",)
    assert said == "--font Nowhere Grotesk: not on this machine; figures use DejaVu Sans instead"
    fonts = [f for f in font_manager.fontManager.ttflist if f.name in ("STIXGeneral", "DejaVu Sans")]
    monkeypatch.setattr(font_manager.fontManager, "ttflist", fonts)
    look, said = appearance.figure_style_of(read_options(["--font", "Times"]).drawing, Output())
    assert (look.fonts[0], look.mathematics) == ("STIXGeneral", "stix")
    assert said.endswith("figures use STIXGeneral instead")
    assert appearance.figure_style_of(read_options([]).drawing, Output())[0] == FigureStyle()


def test_without_latex_the_flags_that_need_it_say_so_before_any_work(monkeypatch):
    monkeypatch.setattr(appearance.shutil, "which", lambda _: None)
    with pytest.raises(UsageError, match=r"--usetex: needs LaTeX; program 'latex' is not on this machine"):
        appearance.require_latex(read_options(["--usetex"]).drawing)
    with pytest.raises(UsageError, match=r"--pgf: needs LaTeX; none of pdflatex, "):
        appearance.require_latex(read_options(["--pgf"]).drawing)


def test_signs_become_commands_of_latex(runs):
    log, made = runs
    with drawing():
        fig = error_figure(log, made)
        translate(fig, escape=True)
    every = [t.get_text() for t in fig.findobj(Text) if t.get_text()]
    assert any(r"$\pm$3$\sigma$" in t for t in every)
    assert not any("σ" in t or "±" in t for t in every)

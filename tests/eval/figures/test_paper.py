"""Figures for a column, and a figure's data."""

import numpy as np
import pandas as pd
import pytest
from matplotlib import font_manager, image
from matplotlib.figure import Figure
from matplotlib.text import Text

import slamref
from data.errors import UsageError
from eval.figures.error import error_figure
from eval.figures.figure_style import FigureStyle, figure_style
from eval.figures.style import drawing, save, translate
from eval.plan.flags import options as appearance
from eval.plan.flags.options import read_options
from eval.plan.flags.table import Output


@pytest.fixture(scope="module")
def runs():
    log = slamref.open_log("arena:0:frames=40")
    return log, slamref.compare(log.inputs(labels=True), "slam", ("dead-reckoning", "ekf", "isam2", "batch"))


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


def test_fonts_and_latex_that_are_not_here_are_replaced_or_named_before_any_work(monkeypatch):
    look, said = appearance.figure_style_of(read_options(["--font", "Nowhere Grotesk"]).drawing, Output())
    assert look.fonts == ("DejaVu Sans",)
    assert said == "--font Nowhere Grotesk: not on this machine; figures use DejaVu Sans instead"
    fonts = [f for f in font_manager.fontManager.ttflist if f.name in ("STIXGeneral", "DejaVu Sans")]
    monkeypatch.setattr(font_manager.fontManager, "ttflist", fonts)
    look, said = appearance.figure_style_of(read_options(["--font", "Times"]).drawing, Output())
    assert (look.fonts[0], look.mathematics) == ("STIXGeneral", "stix")
    assert said.endswith("figures use STIXGeneral instead")
    assert appearance.figure_style_of(read_options([]).drawing, Output())[0] == FigureStyle()
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


def drawn():
    fig = Figure(figsize=(3.0, 2.0))
    left, right = fig.subplots(1, 2)
    t = np.linspace(0.0, 4.0, 5)
    left.plot(t, t**2, color="#D55E00", label="EKF")
    left.fill_between(t, t - 1.0, t + 1.0, color="#C8C8C8", alpha=0.5, label="band")
    left.axhline(3.0, color="black", linestyle="--")
    left.set(xlabel="time [s]", ylabel="error [m]", title="left")
    right.scatter([1.0, 2.0], [3.0, 4.0], color="#0064A8", label="landmarks")
    right.bar([0.5], [2.0], width=1.0, color="#009E73", label="count")
    right.set_aspect("equal")
    fig.suptitle("both")
    return fig


@pytest.fixture
def saved(tmp_path):
    with figure_style(FigureStyle(data=True)):
        written = save(drawn(), tmp_path, "mine")
    assert [p.name for p in written] == ["mine.csv", "mine.png"]
    return pd.read_csv(tmp_path / "mine.csv", keep_default_na=False, na_values="nan")


def series(table, label, panel=0):
    return table[(table.label == label) & (table.panel == panel)]


def test_curves_points_bars_and_bands_are_in_the_units_of_the_axes(saved):
    curve = series(saved, "EKF")
    np.testing.assert_allclose(curve.y, curve.x**2)
    band = series(saved, "band")
    assert (band.kind.iloc[0], band.y.min(), band.y.max()) == ("area", pytest.approx(-1.0), pytest.approx(5.0))
    level = saved[(saved.panel == 0) & (saved.color == "#000000")]
    np.testing.assert_allclose(level.y, 3.0)
    np.testing.assert_allclose(series(saved, "landmarks", 1)[["x", "y"]], [[1.0, 3.0], [2.0, 4.0]])
    bar = saved[(saved.panel == 1) & (saved.kind == "area")]
    assert (bar.x.min(), bar.x.max(), bar.y.max()) == (pytest.approx(0.0), pytest.approx(1.0), pytest.approx(2.0))


def test_without_a_title_the_panels_keep_theirs(tmp_path):
    fig = drawn()
    with figure_style(FigureStyle(titles=False)):
        fig.delaxes = lambda ax: None
        save(fig, tmp_path, "mine")
    assert [fig._suptitle.get_text(), fig.axes[0].get_title()] == ["", "left"]

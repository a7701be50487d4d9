"""A figure's data are what it shows."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from eval.figures.figure_style import FigureStyle, figure_style
from eval.figures.style import save


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
        titles = []
        fig.clear, clear = lambda: titles.extend([fig._suptitle.get_text(), fig.axes[0].get_title()]), fig.clear
        save(fig, tmp_path, "mine")
        clear()
    assert titles == ["", "left"]

"""Colours, lines and markers of estimators and association methods, page sizes, and saving the same bytes each time.

Filters are warm, smoothers cool; colours are Okabe and Ito's and Tol's, which colour-blind readers can tell apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Tick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Transform
from PIL import Image

from association.names import METHOD_TABLE
from data.result import Run, Trajectory
from eval.figures.figure_style import FOR_PHONE, PHONE, TEX, USUAL, USUAL_TYPE, current, figure_style
from eval.referee.given.runs import GivenRun
from eval.replay.external.spec import place
from eval.replay.settings import ESTIMATOR_TABLE

LINE, AREA = "line", "area"


def write_data(fig: Figure, folder: Path, stem: str) -> list[Path]:
    """Write `stem.csv`; pictures such as a grid of the laser are left out. Columns: panel (place in the grid of
    panels), series, kind (line, NaN where it is interrupted, or area), label, color, x, y, in the units of the axes.
    """
    fig.draw_without_rendering()  # so that all limits are settled
    parts = []
    for ax in fig.axes:
        place = ax.get_subplotspec()
        at = 0 if place is None else place.rowspan.start * place.get_gridspec().ncols + place.colspan.start
        for series, (_, part) in enumerate(sorted(_series(ax), key=lambda each: each[0])):
            parts.append(pd.DataFrame({"panel": at, "series": series}, part.index).join(part))
    if not parts:
        return []
    data = folder / f"{stem}.csv"
    pd.concat(parts).to_csv(data, index=False, na_rep="nan", float_format="%.9g", lineterminator="\n")
    return [data]


def _series(ax: Axes) -> list[tuple[float, pd.DataFrame]]:
    """All that a panel shows, with its order from behind to the front."""
    found = list[tuple[float, pd.DataFrame]]()

    def add(artist: Artist, transform: Transform, points: Any, kind: str, color: Any) -> None:
        xy, label = np.asarray(points, float).reshape(-1, 2), str(artist.get_label())
        if transform != ax.transData:
            xy = np.asarray((transform - ax.transData).transform(xy))
        named = {"kind": kind, "label": "" if label.startswith("_") else label, "color": to_hex(color)}
        if len(xy):
            found.append((artist.zorder, pd.DataFrame({**named, "x": xy[:, 0], "y": xy[:, 1]})))

    for line in ax.get_lines():
        add(line, line.get_transform(), np.column_stack(line.get_data(orig=False)), LINE, line.get_color())
    for c in ax.collections:
        kind, colors = (AREA, c.get_facecolor()) if len(c.get_facecolor()) else (LINE, c.get_edgecolor())
        shapes = [np.asarray(path.vertices, float) for path in c.get_paths()]
        if isinstance(c, PathCollection):
            add(c, c.get_offset_transform(), c.get_offsets(), LINE, colors[0])
        elif isinstance(c, LineCollection) and shapes:
            add(c, c.get_transform(), np.concatenate([np.vstack([s, [np.nan] * 2]) for s in shapes]), LINE, colors[0])
        else:
            for i, shape in enumerate(shapes):
                add(c, c.get_transform(), shape, kind, colors[i % len(colors)])
    for patch in ax.patches:
        outline = patch.get_path().to_polygons(closed_only=False)[0]
        filled = patch.get_fill() and to_rgba(patch.get_facecolor())[3] > 0.0
        kind, color = (AREA, patch.get_facecolor()) if filled else (LINE, patch.get_edgecolor())
        add(patch, patch.get_transform(), outline, kind, color)
    return found


DOUBLE = 7.0  # in. Width of both columns
NARROW = 5.0  # in. Below, panels side by side are two at most
MARGIN = 0.06  # in, left free at the right edge


def page_width() -> float:
    """In. Width of a figure."""
    return current().width or DOUBLE


def across(most: int) -> int:
    """How many panels stand side by side."""
    return most if page_width() >= NARROW else min(most, 2)


def points(usual: float) -> float:
    """Size [pt] of a text that is smaller or larger than the rest."""
    return usual * current().size / USUAL_TYPE


def refit(fig: Figure) -> None:
    """Make room in a narrow figure, unless `settle` did: titles wrapped, legends in fewer columns, a longer page."""
    engine = fig.get_layout_engine()
    if current().width is None or not isinstance(engine, ConstrainedLayoutEngine):
        return
    engine.execute(fig)
    line = current().size * 1.25 / 72.0
    added = 0.0
    suptitle = fig._suptitle  # type: ignore[attr-defined]
    if suptitle is not None and suptitle.get_text():
        added += line * _wrap(suptitle, fig.bbox.width - suptitle.get_window_extent().x0 - MARGIN * fig.dpi)
    rows: dict[float, float] = {}
    for ax in fig.axes:
        wrapped = line * _wrap_titles(ax, fig)
        top = round(ax.get_position().y1, 3)
        rows[top] = max(rows.get(top, 0.0), wrapped)
    added += sum(rows.values())
    for legend in list(fig.legends):
        added += _relegend(fig, legend)
    width, height = fig.get_size_inches()
    fig.set_size_inches(width, height + added)


def _wrap_titles(ax: Axes, fig: Figure) -> int:
    """Lines more in the titles of a panel."""
    box = ax.get_window_extent()
    more = 0
    for where, room in (("left", fig.bbox.width - box.x0 - MARGIN * fig.dpi), ("center", box.width)):
        title: Text = {"left": ax._left_title, "center": ax.title}[where]  # type: ignore[attr-defined]
        side = len({round(a.get_window_extent().x0) for a in fig.axes}) > 1
        more = max(more, _wrap(title, box.width if side else room))
    return more


def _wrap(text: Text, room: float) -> int:
    """Break a text between words so that no line is wider than `room` [pixels]; how many lines that is more."""
    before, width = text.get_text(), text.get_window_extent().width
    if not before or width <= room:
        return 0
    most = int(0.95 * room / width * max(map(len, before.split("\n"))))  # letters differ in width
    text.set_text("\n".join(fill(line, max(most, 1), break_long_words=False) for line in before.split("\n")))
    return text.get_text().count("\n") - before.count("\n")


def _relegend(fig: Figure, legend: Legend) -> float:
    """A legend below everything, in as many columns as there is room for; how much longer [in] the page has to be."""
    handles = [h for h in legend.legend_handles if h is not None]
    labels = [t.get_text() for t in legend.get_texts()]
    before, title = legend.get_window_extent().height, legend.get_title().get_text() or None
    length = legend.handlelength
    legend.remove()
    for columns in (3, 2, 1):
        made = fig.legend(handles, labels, loc="outside lower center", ncols=columns, handlelength=length, title=title)
        if columns == 1 or made.get_window_extent().width <= fig.bbox.width - MARGIN * fig.dpi:
            break
        made.remove()
    return max(float(made.get_window_extent().height - before) / fig.dpi, 0.0)


def translate(fig: Figure, *, escape: bool) -> None:
    """Signs in every text as commands of LaTeX; `escape`: also what is special to LaTeX (pgf does so itself)."""
    signs = {c: command for c, command in TEX.items() if not c.isascii() or escape}
    for text in fig.findobj(Text):
        assert isinstance(text, Text)
        given = text.get_text()
        if "$" not in given:  # else somebody wrote mathematics
            text.set_text("".join(signs.get(c, c) for c in given))


SINGLE = 3.4  # in. Width of one column of a two-column paper
PNG_DPI = 200
COMPRESS_LEVEL = 3  # of PNG: 2 % larger than by default in two thirds of the time
LONG_HANDLE = 3.8  # length of a legend's line [font sizes] that shows every line's pattern beside its marker

SOLID: Literal["-"] = "-"
DASHED, DASHDOT, DOTTED = (0, (4.0, 1.4)), (0, (5.0, 1.3, 1.2, 1.3)), (0, (1.0, 1.2))
LONG, DASHDOTDOT = (0, (8.0, 1.6)), (0, (5.0, 1.2, 1.2, 1.2, 1.2, 1.2))
Line = Literal["-"] | tuple[int, tuple[float, ...]]

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType  # not in matplotlib 3.10

TRUTH_COLOUR = "#000000"
BAND: dict[str, Any] = {"color": "#C8C8C8", "alpha": 0.45, "linewidth": 0.0}  # where something is expected to be

RC: dict[RcKeyType, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib, so a figure does not depend on the machine's fonts
    "font.size": 8.0, "axes.titlesize": 8.0, "axes.labelsize": 8.0, "legend.fontsize": 7.0, "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0, "figure.titlesize": 8.5, "axes.linewidth": 0.6, "axes.grid": True, "axes.axisbelow": True,
    "grid.color": "#E4E4E4", "grid.linewidth": 0.5, "hatch.linewidth": 0.5, "xtick.major.width": 0.6,
    "ytick.major.width": 0.6, "xtick.major.size": 2.5, "ytick.major.size": 2.5, "lines.linewidth": 0.9,
    "lines.markersize": 4.0, "legend.frameon": False, "legend.handlelength": 2.4, "legend.borderaxespad": 0.3,
    "figure.constrained_layout.use": True, "savefig.dpi": PNG_DPI, "pdf.fonttype": 42, "image.composite_image": False,
    "text.usetex": False,
}  # fmt: skip


@dataclass(frozen=True)
class Style:
    """How one estimator is drawn and called; line and marker tell it apart in grey."""

    colour: str
    label: str
    line: Line = SOLID
    marker: str = "+"

    @property
    def look(self) -> dict[str, Any]:
        """Colour, line and marker, as matplotlib calls them."""
        return {"color": self.colour, "linestyle": self.line, "marker": self.marker}


LINES: dict[str, Line] = {
    "solid": SOLID, "dashed": DASHED, "dashdot": DASHDOT, "dotted": DOTTED, "long": LONG, "dashdotdot": DASHDOTDOT,
}  # fmt: skip
STYLES = {name: Style(e.colour, e.label, LINES[e.line], e.marker) for name, e in ESTIMATOR_TABLE.items()}
METHODS: dict[str, tuple[str, Line]] = {
    name: (m.colour, LINES[m.line] if isinstance(m.line, str) else (0, m.line)) for name, m in METHOD_TABLE.items()
}  # colour and line of association methods, where one estimator was run with several
OTHERS = (("#8000E0", "*"), ("#800000", "h"), ("#806080", "d"), ("#E00040", "1"), ("#E040E0", "2"), ("#C080C0", "3"))
"""Colour and marker of names that are not ours, as far from ours and from each other as colours go (CIELAB, for all
colour-blind readers): each with every one of these lines, so that so many names look different."""
OTHER_LINES: tuple[Line, ...] = (DASHDOT, LONG, DASHDOTDOT)


def style_of(estimator: str) -> Style:
    """The style of an estimator; a name that is not ours gets one of its own, the same each time."""
    known = STYLES.get(estimator)
    if known is not None:
        return known
    colour, line, marker = _other(estimator)
    return Style(colour, estimator, line, marker)


def style_of_method(association: str) -> tuple[str, Line]:
    """Colour and line of an association method; of its own for a name that is not ours."""
    return METHODS.get(association) or _other(association)[:2]


def colour_of_method(association: str) -> str:
    """The colour of an association method."""
    return style_of_method(association)[0]


def _other(name: str) -> tuple[str, Line, str]:
    which = place(name, len(OTHERS) * len(OTHER_LINES))
    colour, marker = OTHERS[which % len(OTHERS)]
    return colour, OTHER_LINES[which // len(OTHERS)], marker


@dataclass(frozen=True)
class Series:
    """One phase of one run, as drawn."""

    run: Run
    phase: str
    label: str
    colour: str
    line: Line

    @property
    def trajectory(self) -> Trajectory:
        """Poses and covariances of this phase."""
        return self.run.trajectory(self.phase)


def series(runs: Sequence[Run]) -> list[Series]:
    """Every phase of every run, told apart by colour, line or label; online dashed where a final path is drawn, too.
    Colour is the estimator's and the line the association method's; of one estimator alone both are the method's.
    """
    # a result that was handed in without decisions has no association that could differ, as dead reckoning has none
    estimates = [r for r in runs if r.association != "none"]
    several, tasks = len({r.association for r in estimates}) > 1, sorted({r.task for r in estimates})
    alone = several and len({r.estimator for r in estimates}) == 1
    cycle = (SOLID, DASHDOT)
    drawn = []
    for run in runs:
        style, extra = style_of(run.estimator), ""
        colour, line = style.colour, style.line
        if run.association != "none" and (several or len(tasks) > 1):
            extra += f", {run.association}" if several else ""
            extra += f", {run.task}" if len(tasks) > 1 else ""
            line = style_of_method(run.association)[1] if several else cycle[tasks.index(run.task)]
            colour = colour_of_method(run.association) if alone else colour
        if isinstance(run, GivenRun) and run.aligned != "none":
            extra += ", aligned"
        for phase in run.phases:
            phase_line = DASHED if phase == "online" and len(run.phases) > 1 else line
            when = "" if run.estimator == "dead-reckoning" else f" ({phase})"
            drawn.append(Series(run, phase, f"{style.label}{extra}{when}", colour, phase_line))
    return drawn


def key(label: str, **look: Any) -> Line2D:
    """An entry of a legend: a line or marker that looks so."""
    return Line2D([], [], label=label, **look)


def finish(fig: Figure, title: str, handles: Sequence[Artist], columns: int = 2, **more: Any) -> None:
    """Title above all panels, legend below them."""
    fig.suptitle(title, x=0.01, ha="left")
    fig.legend(handles=list(handles), loc="outside lower center", ncols=columns, **more)


EXPECTED: dict[str, Any] = {"color": "#505050", "linewidth": 0.6, "linestyle": "--"}  # of a line where a mean should be
CLAIM: dict[str, Any] = {"facecolor": "#D0D0D0", "edgecolor": "#606060", "linewidth": 0.5}  # of a claim, in legends


@contextmanager
def drawing() -> Iterator[None]:
    """Our settings while a figure is built or saved, and nobody else's before or after."""
    with matplotlib.rc_context(rc=RC | current().settings()):
        yield


@contextmanager
def _ticks_kept(fig: Figure) -> Iterator[None]:
    """Make an axis' ticks again only where its limits or panel changed; matplotlib does so 25 times a panel."""
    panels: list[Any] = [axis for ax in fig.axes for axis in (ax.xaxis, ax.yaxis)]
    kept = [axis for axis in panels if "_update_ticks" not in vars(axis)]
    for axis in kept:
        axis._update_ticks = _kept(axis)
    try:
        yield
    finally:
        for axis in kept:
            del axis._update_ticks


def _kept(axis: Any) -> Callable[[], list[Tick]]:
    """The ticks of an axis, made when they are asked for first, and where it changed."""
    make, at, made = axis._update_ticks, (), list[Tick]()

    def ticks() -> list[Tick]:
        nonlocal at, made
        now = (*axis.get_view_interval(), axis.axes.bbox.width, axis.axes.bbox.height)
        if now != at:
            at, made = now, make()
        return made

    return ticks


def settle(fig: Figure, times: int = 2) -> FigureCanvasAgg:
    """Lay a figure out for good, labels of y axes in line; its canvas. With equal aspect, each layout moves all."""
    # its renderer keeps the sizes of texts, until they are drawn
    canvas = fig.canvas if isinstance(fig.canvas, FigureCanvasAgg) else FigureCanvasAgg(fig)
    with _ticks_kept(fig):
        refit(fig)
        if (engine := fig.get_layout_engine()) is not None:
            for _ in range(times):
                engine.execute(fig)  # the layout alone: the picture is drawn when it is saved
    fig.set_layout_engine("none")
    fig.align_ylabels()
    return canvas


def save(fig: Figure, folder: Path, stem: str, formats: Sequence[str] | None = None) -> list[Path]:
    """Write a figure as `folder/stem.png` or pdf (default: of the style), and empty it: same data, same bytes."""
    formats = current().formats if formats is None else formats
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with drawing(), _ticks_kept(fig):
        if not current().titles:  # those that tell its panels apart stay
            fig.suptitle("")
            for place in ("left", "center", "right") if len(fig.axes) == 1 else ():
                fig.axes[0].set_title("", loc=place)
        if current().data:
            written += write_data(fig, folder, stem)
        if current().usetex:
            translate(fig, escape=True)
        fig.set_dpi(PNG_DPI)
        canvas = settle(fig, 1)  # one layout for all formats
        for suffix in formats:
            path = folder / f"{stem}.{suffix}"
            if suffix == "png":  # as `savefig`, with the same pixels, but drawn once
                canvas.draw()  # type: ignore[no-untyped-call]
                pixels = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")  # type: ignore[no-untyped-call]
                pixels.save(path, dpi=(PNG_DPI, PNG_DPI), compress_level=COMPRESS_LEVEL)
            else:
                fig.savefig(path, metadata={"CreationDate": None, "Creator": None, "Producer": None})
            written.append(path)
        if current().pgf is not None:
            # LaTeX sets it with the fonts of the document; it is laid out by the widths that those have here
            if not current().usetex:
                translate(fig, escape=False)
            written.append(folder / f"{stem}.pgf")
            with matplotlib.rc_context(rc={"axes.unicode_minus": False}):
                fig.savefig(written[-1], backend="pgf")
    for ax in list(fig.axes):  # `fig.clear` makes new ticks in each
        fig.delaxes(ax)
    return written


def save_for_page(draw: Callable[[], Figure], folder: Path, stem: str, drawn: Figure | None = None) -> None:
    """Save a figure (`drawn` or not), and as `folder/stem-narrow.png` for phones unless a width was asked for."""
    save(draw() if drawn is None else drawn, folder, stem)
    if current().width is None:
        with figure_style(replace(USUAL, width=PHONE)):
            save(draw(), folder, stem + FOR_PHONE)

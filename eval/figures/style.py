"""Colours, lines and markers of estimators and association methods, page sizes, and saving the same bytes each time.

Filters are warm, smoothers cool; colours are Okabe and Ito's and Tol's, which colour-blind readers can tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.typing import RcKeyType
from PIL import Image

from data.result import Run, Trajectory
from eval.figures import figure_data
from eval.figures.figure_style import current
from eval.figures.paper import refit, translate, untitle
from eval.referee.given.runs import GivenRun
from eval.replay.external.spec import place

SINGLE = 3.4  # in. Width of one column of a two-column paper
PNG_DPI = 200
COMPRESS_LEVEL = 3  # of PNG: 2 % larger than by default in two thirds of the time
LONG_HANDLE = 3.8  # length of a legend's line [font sizes] that shows every line's pattern beside its marker

SOLID: Literal["-"] = "-"
DASHED, DASHDOT, DOTTED = (0, (4.0, 1.4)), (0, (5.0, 1.3, 1.2, 1.3)), (0, (1.0, 1.2))
LONG, DASHDOTDOT = (0, (8.0, 1.6)), (0, (5.0, 1.2, 1.2, 1.2, 1.2, 1.2))
Line = Literal["-"] | tuple[int, tuple[float, ...]]

TRUTH_COLOUR = "#000000"
BAND_COLOUR = "#C8C8C8"
BAND: dict[str, Any] = {"color": BAND_COLOUR, "alpha": 0.45, "linewidth": 0.0}  # where something is expected to be

RC: dict[RcKeyType, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib, so a figure does not depend on the machine's fonts
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "legend.fontsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "figure.titlesize": 8.5,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "lines.linewidth": 0.9,
    "lines.markersize": 4.0,
    "legend.frameon": False,
    "legend.handlelength": 2.4,
    "legend.borderaxespad": 0.3,
    "figure.constrained_layout.use": True,
    "savefig.dpi": PNG_DPI,
    "pdf.fonttype": 42,
    "image.composite_image": False,
    "text.usetex": False,
}


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


STYLES: dict[str, Style] = {
    "dead-reckoning": Style("#A6A6A6", "dead reckoning", DOTTED, "x"),
    "ekf": Style("#D55E00", "EKF", SOLID, "o"),
    "ekf-iterated": Style("#E69F00", "iterated EKF", DASHED, "p"),
    "ekf-fej": Style("#CC79A7", "first-estimates EKF", DASHDOT, "^"),
    "ekf-invariant": Style("#882255", "invariant EKF", DASHED, "v"),
    "batch": Style("#0064A8", "batch", SOLID, "s"),
    "batch-huber": Style("#56B4E9", "batch, Huber", DASHDOTDOT, "<"),
    "batch-cauchy": Style("#332288", "batch, Cauchy", DASHDOT, ">"),
    "gnc": Style("#117733", "GNC", LONG, "P"),
    "isam2": Style("#009E73", "iSAM2", SOLID, "D"),
    "fixed-lag": Style("#999933", "fixed lag", LONG, "X"),
}
METHODS: dict[str, tuple[str, Line]] = {
    "known": ("#000000", SOLID),
    "nn": ("#D55E00", DOTTED),
    "ml": ("#E69F00", (0, (6.0, 1.2, 2.2, 1.2))),
    "ml-ratio": ("#7B3F00", (0, (1.0, 1.2, 1.0, 3.0))),
    "singles": ("#CC79A7", (0, (2.2, 1.2))),
    "gnn": ("#999933", (0, (1.0, 3.0))),
    "jcbb": ("#0072B2", DASHDOT),
    "jcbb-first": ("#56B4E9", DASHDOTDOT),
    "jcbb-hindsight": ("#332288", LONG),
    "scan": ("#117733", SOLID),
}
"""Colour and line of association methods, where one estimator was run with several; joint tests are blue."""
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
    """Every phase of every run, told apart by colour, line or label; online dashed where a final path is drawn, too."""
    # a result that was handed in without decisions has no association that could differ, as dead reckoning has none
    estimates = [r for r in runs if r.association != "none"]
    several, tasks = len({r.association for r in estimates}) > 1, sorted({r.task for r in estimates})
    cycle = (SOLID, DASHDOT)
    drawn = []
    for run in runs:
        style, extra, line = style_of(run.estimator), "", style_of(run.estimator).line
        if run.association != "none" and (several or len(tasks) > 1):
            extra += f", {run.association}" if several else ""
            extra += f", {run.task}" if len(tasks) > 1 else ""
            line = style_of_method(run.association)[1] if several else cycle[tasks.index(run.task)]
        if isinstance(run, GivenRun) and run.aligned != "none":
            extra += ", aligned"
        for phase in run.phases:
            phase_line = DASHED if phase == "online" and len(run.phases) > 1 else line
            when = "" if run.estimator == "dead-reckoning" else f" ({phase})"
            drawn.append(Series(run, phase, f"{style.label}{extra}{when}", style.colour, phase_line))
    return drawn


@contextmanager
def drawing() -> Iterator[None]:
    """Our settings while a figure is built or saved, and nobody else's before or after."""
    with matplotlib.rc_context(rc=RC | current().settings()):
        yield


def settle(fig: Figure) -> None:
    """Lay a figure out for good: with equal aspect, each further layout would move everything a little."""
    refit(fig)
    if (engine := fig.get_layout_engine()) is not None:
        for _ in range(2):
            engine.execute(fig)  # the layout alone: the picture is drawn when it is saved
    fig.set_layout_engine("none")


def _write_png(fig: Figure, path: Path) -> None:
    """As `savefig`, with the same pixels, but drawn once: `savefig` draws everything in advance to lay it out."""
    before = fig.dpi
    fig.set_dpi(PNG_DPI)
    canvas = FigureCanvasAgg(fig)
    canvas.draw()  # type: ignore[no-untyped-call]
    rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    pixels = Image.fromarray(rgba).convert("RGB")
    pixels.save(path, dpi=(PNG_DPI, PNG_DPI), compress_level=COMPRESS_LEVEL)
    fig.set_dpi(before)


def save(fig: Figure, folder: Path, stem: str, formats: Sequence[str] | None = None) -> list[Path]:
    """Write a figure as `folder/stem.<format>` (default: of the current style), and empty it: same data, same bytes.

    Raises ValueError for a format whose metadata is not known to be clean.
    """
    clean: dict[str, dict[str, Any]] = {
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
        "png": {},
    }
    formats = current().formats if formats is None else formats
    unknown = sorted(set(formats) - set(clean))
    if unknown:
        raise ValueError(f"figure format {unknown[0]!r}; known: {', '.join(clean)}")
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with drawing():
        if not current().titles:
            untitle(fig)
        if current().data:
            written += figure_data.write(fig, folder, stem)
        if current().usetex:
            translate(fig, escape=True)
        refit(fig)
        for suffix in formats:
            path = folder / f"{stem}.{suffix}"
            if suffix == "png":
                _write_png(fig, path)
            else:
                fig.savefig(path, metadata=clean[suffix])
            fig.set_layout_engine("none")  # one layout for all formats
            written.append(path)
        if current().pgf is not None:
            # LaTeX sets it with the fonts of the document; it is laid out by the widths that those have here
            if not current().usetex:
                translate(fig, escape=False)
            written.append(folder / f"{stem}.pgf")
            with matplotlib.rc_context(rc={"axes.unicode_minus": False}):
                fig.savefig(written[-1], backend="pgf")
    fig.clear()
    return written

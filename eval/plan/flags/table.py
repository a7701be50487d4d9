"""The flags of `slamref run`, one field each, in parts by their readers.

Parser, config files, checks, the command in the report, step mode and player read this table. It imports no numerical
library, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from data.command import Command
from data.errors import UsageError
from data.wing import wings
from eval.figures import FIGURES
from eval.replay.external.spec import FORM, own_or_foreign
from eval.replay.flag import (
    Flag,
    folder,
    free_row,
    names,
    one_of,
    positive,
    row,
    rows,
    stretches,
    switch,
    text,
    texts,
    whole,
)
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS, TASKS, Setup
from eval.studies.shipped import scenarios

FORMATS = ("csv", "md", "tex")
KNOWN_FORMATS = (*FORMATS, "pdf")
FACTORS = ("1", "2", "5", "10", "20", "50", "auto")
KINDS = (FIGURES[0], *(name for wing in wings() for name in wing.figures), *FIGURES[1:])  # of figures of a log
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")
QUICK_RUNS = 2
TWINS = 99  # replicates of a log: a share of the level of 5 % still leaves ranks to those statistics that need them
NOT_NEGATIVE = whole(0, "must not be negative")
FIRST_FRAMES = whole(1, "a whole number from 1 up is needed")  # `--frames` of step and play
INCH = {"in": 1.0, "cm": 1.0 / 2.54, "mm": 1.0 / 25.4, "pt": 1.0 / 72.27}  # [in] of each unit; pt of TeX
SMALLEST, LARGEST = 1.5, 20.0  # [in] width of a figure whose axes and labels have room
TYPE = (4.0, 24.0)  # [pt] smallest and largest type


def inches(length: str) -> float:
    """A length such as `3.4in`, `8.6cm`, `86mm` or `252pt` in inches; NaN if it is invalid."""
    found = re.fullmatch(r"\s*([0-9.]+)\s*(in|cm|mm|pt)\s*", length)
    try:
        return float(found[1]) * INCH[found[2]] if found else math.nan
    except ValueError:
        return math.nan


def width(label: str, value: object) -> str:
    """The width of a figure."""
    wide = inches(str(value))
    if not math.isfinite(wide):
        raise UsageError(f"{label} {value}: a length with its unit is needed, as in 3.4in, 8.6cm, 86mm or 252pt")
    if not SMALLEST <= wide <= LARGEST:
        raise UsageError(f"{label} {value}: between {SMALLEST:g}in and {LARGEST:g}in is needed")
    return str(value).replace(" ", "")


def points(label: str, value: object) -> float:
    """A size of type [pt]."""
    size = positive(label, value)
    if not TYPE[0] <= size <= TYPE[1]:
        raise UsageError(f"{label} {size:g}: between {TYPE[0]:g} and {TYPE[1]:g} points is needed")
    return size


several = partial(row, (), texts, repeatable=True)  # a flag given once for each of its values
file_row = partial(row, None, text("a file"), "FILE")
switch_row = partial(row, False, switch, "")
free_switch = partial(free_row, False, switch, "")
KEEP_TRUTH = "score windows of bad ground truth, too, which are found and left out by default"
keep_truth_row = partial(switch_row, KEEP_TRUTH)


def choice(default: str, others: Iterable[str], metavar: str, help: str, kind: Callable[..., Any] = row) -> Any:
    """A flag with one of several names, the default among them."""
    return kind(default, one_of((default, *others)), metavar, help)


@dataclass(frozen=True)
class Selection:
    """Logs, tasks, estimators and association methods."""

    log: tuple[str, ...] = several(
        "PATH|NAME",
        "open log folder, CARMEN log (.log, .clf, also .gz, .bz2), or victoria-park, arena:SEED, circle:SEED, "
        "linear:SEED, corridor:SEED:people+no-odometry+KEY=VALUE (repeatable; default: victoria-park, arena:0, five "
        "corridors and 60 frames of visual:0)",
    )
    data: tuple[str, ...] = several(
        "DIR",
        "run every dataset in DIR: open logs, UTIAS MRCLAM folders or zips; with --scenario, find the recording of "
        "esde-replay in DIR",
    )
    scenario: tuple[str, ...] = several(
        "NAME|FILE|all",
        f"Monte Carlo study: {', '.join(scenarios())}, a TOML file, or all of these (repeatable)",
    )
    task: tuple[str, ...] = row(
        (), names(TASKS), "LIST", "localization, slam or both (default: localization where there is a map, else slam)"
    )
    estimator: tuple[str, ...] = row(
        DEFAULT_ESTIMATORS,
        own_or_foreign("estimator", least=1),
        "LIST",
        f"of {', '.join(ESTIMATORS)}, or your own as {FORM} (default: {','.join(DEFAULT_ESTIMATORS)})",
    )
    association: tuple[str, ...] = row(
        (),
        own_or_foreign("association"),
        "LIST",
        f"of {', '.join(ASSOCIATIONS)}, or your own (default: known where the log has labels, scan where it has laser "
        "scans only, jcbb for walls, else jcbb-hindsight)",
    )
    lab: str | None = row(
        None,
        text("a lab"),
        "NAME|FOLDER",
        "do a whole lab and answer its questions: corridor:SEED+KEY=VALUE (four conditions, all methods), visual:SEED, "
        "or a folder of recorded runs or images (--new-gate default: as --gate)",
    )


@dataclass(frozen=True)
class Matching:
    """How files of results are read and matched with the truth; `slamref score` has these flags, too."""

    cov: tuple[str, ...] = several(
        "[NAME=]FILE", "covariances of a TUM file: per line a stamp and the lower triangle of 6x6 (repeatable)"
    )
    times: tuple[str, ...] = several(
        "[NAME=]FILE", "stamps [s] of KITTI poses, one per line; truth=FILE: of the truth (repeatable)"
    )
    cov_frame: tuple[str, ...] = several(
        "[NAME=]FRAME",
        "frame of the covariances: world, local (right perturbation, body axes), left, or mixed (position in world "
        "axes, rotation in body axes; repeatable; default: that of the format)",
    )
    cov_order: tuple[str, ...] = several(
        "[NAME=]ORDER",
        "order of 6x6 covariances: translation-first or rotation-first (repeatable; default: the former)",
    )
    axes: tuple[str, ...] = several(
        "[NAME=]AXES",
        "axes of poses in 3-D: robot (z up) or camera (z forward, y down; repeatable; default: robot, of KITTI camera)",
    )
    unit: tuple[str, ...] = several(
        "[NAME=]UNIT",
        "unit of a file: of stamps s, ms, us, ns (default: as stated, else inferred), of headings rad, deg, of "
        "positions m, cm, mm (repeatable)",
    )
    time_offset: tuple[str, ...] = several(
        "[NAME=]S",
        "seconds added to the stamps of a result, or auto: by its speeds and turn rates and the truth's (repeatable)",
    )
    align: str = choice(
        "none",
        ("first", "se2", "se3", "sim3", "yaw"),
        "HOW",
        "align each result with the truth: none, first (first matched pose), se2 or se3 (best rigid fit), sim3 (with "
        "scale), yaw (position and heading, 4 dof); in space where both files are 3-D (default: none)",
    )
    pairs: str = choice(
        "evo",
        ("rpg", "openvins"),
        "WHOSE",
        "pairs of relative errors in 3-D: evo (1 m, 10 m), rpg (a tenth to half of the path) or openvins (8 to 40 m; "
        "default: evo)",
    )
    truth_gap: float = row(
        1.0, positive, "S", "largest gap [s] between two true poses that is interpolated (default: 1)"
    )


@dataclass(frozen=True)
class Scoring(Matching):
    """The flags of `slamref score`."""

    keep_truth: bool = keep_truth_row()


@dataclass(frozen=True)
class Results(Matching):
    """Results of other programs, and their truth."""

    result: tuple[str, ...] = several(
        "NAME=FILE",
        "score a trajectory of another program: CSV, TUM (with covariance), SQUARE, EuRoC, KITTI, ROS bag "
        "(FILE:/TOPIC), or the folder of a run (repeatable; docs/results-files.md)",
    )
    truth: str | None = file_row(
        "true path of the log, or of the results where there is no log, in any of these formats"
    )


@dataclass(frozen=True)
class Opening:
    """How logs are opened: their ground truth, logs with images, laser logs."""

    camera_translation: str = choice(
        "cm", ("mm", "m"), "UNIT", "unit of T in the configuration of a lab folder: cm, mm, m (default: cm)"
    )
    camera_reading: str = choice(
        "to-camera",
        ("to-body",),
        "WAY",
        "meaning of R, T in a lab folder: to-camera, p_c = R p_b + T, or to-body, p_b = R p_c + T (default: to-camera)",
    )
    corner_noise: str = choice(
        "lab", ("depth",), "KIND", "noise of picture corners: lab, 2 cm and 5 cm, or depth, quadratic (default: lab)"
    )
    trust_pickle: bool = switch_row("read object arrays of a lab folder, which can run code")
    exclude_truth: tuple[str, ...] = row(
        (),
        stretches,
        "FROM:TO",
        "do not score the ground truth there, both ends included, in s of the log or of the recording that it was "
        "converted from (repeatable)",
        repeatable=True,
    )
    keep_truth: bool = keep_truth_row()
    relations: str | None = file_row(
        "reference relations of the only laser log (default: NAME.relations.csv, or relations.csv in its folder)"
    )
    no_odometry: bool = switch_row("laser logs: the odometry is unknown, and scans alone tell the motion")


@dataclass(frozen=True)
class Study:
    """How much is simulated."""

    runs: int | None = row(
        None,
        NOT_NEGATIVE,
        "N",
        f"runs of the consistency study (default: 50, or as in the scenario; {QUICK_RUNS} with --quick, 0 with a log)",
    )
    seed: int = row(0, NOT_NEGATIVE, "N", "first seed of studies and twins (default: 0)")
    twins: int | None = row(
        None,
        NOT_NEGATIVE,
        "N",
        "diagnose each log without ground truth, from N bootstrap replicates; without a number 99 (default: 0; with "
        "--full 99 for ekf and batch)",
        bare=str(TWINS),
    )
    full: bool = switch_row("run the default suite with every method; takes minutes")


@dataclass(frozen=True)
class Output:
    """Files, tables and figures of the report."""

    quick: bool = switch_row("write a short report in seconds: fewer frames and figures, PNG only, no verdicts")
    out: Path = free_row(
        Path("results/report"), folder, "DIR", "result folder, replaced as a whole (default: results/report)"
    )
    formats: tuple[str, ...] = free_row(
        FORMATS, names(KNOWN_FORMATS), "LIST", "table formats; pdf: figures also as PDF (default: csv,md,tex)"
    )
    columns: tuple[str, ...] = free_row(
        (), names(), "LIST", "columns of the LaTeX tables, by their names in the CSV tables (default: all that fit)"
    )
    table_width: str = choice(
        "page",
        ("column",),
        "WIDTH",
        "width of the LaTeX tables: column (252 pt) or page (516 pt) of an IEEE paper (default: page)",
        free_row,
    )
    figures: tuple[str, ...] = free_row(
        (), names(KINDS), "LIST", f"only these figures of logs, of {', '.join(KINDS)} (default: all that apply)"
    )
    show: tuple[str, ...] = free_row(
        (), names(), "LIST", "draw only these estimators, as in ekf,batch; tables have all (default: all that fit)"
    )
    write_up: bool = free_switch("write write-up.tex, with tables and figures on one page per log, for pdflatex")
    lab_text: bool = free_switch(
        "write lab.txt for each run: its steps as the lab's program prints them, numbers from 1"
    )
    no_plots: bool = free_switch("write tables without figures")
    open: bool = free_switch("show the report in the browser")
    ellipses: str = choice(
        "1",
        FACTORS[1:],
        "FACTOR",
        f"enlargement of the ellipses of a camera log: {', '.join(FACTORS)} (auto: until visible; default: 1)",
        free_row,
    )
    animate: bool = free_switch("write a film (WebM) per log, task, estimator and association method")
    speed: float | None = free_row(
        None,
        positive,
        "FACTOR",
        "speed of the films in log seconds (without stamps: frames) per second (default: real time, or faster, for at "
        "most a minute)",
    )

    @property
    def kept(self) -> Path:
        """The parent of the result folder, where studies, twins and detections are cached for later runs."""
        return self.out.absolute().parent

    @property
    def ellipse_factor(self) -> int | None:
        """Enlargement of the ellipses; None: automatic."""
        return None if self.ellipses == "auto" else int(self.ellipses)


@dataclass(frozen=True)
class Drawing:
    """Figures for a paper: with any of these flags also as PDF, with their data (CSV)."""

    no_titles: bool = free_switch("figures without a title inside, as a caption says what they show")
    figure_width: str | None = free_row(
        None, width, "LENGTH", "width of all figures, as in 3.4in, 8.6cm, 252pt (default: 7in)"
    )
    font: str | None = free_row(None, text("a font's name"), "NAME", "font of all figures, as in Times")
    font_size: float = free_row(8.0, points, "PT", "size of titles and labels; ticks are 1 pt smaller (default: 8)")
    usetex: bool = free_switch("let LaTeX set the text in figures (latex, dvipng)")
    pgf: bool = free_switch("write figures also as .pgf, in the fonts of the document (pdflatex or xelatex)")


@dataclass(frozen=True)
class Execution:
    """Processes and messages."""

    jobs: int = free_row(1, whole(1, "at least one process is needed"), "N", "processes (default: one per core)")
    scheduler: str | None = free_row(
        None,
        text("an address, as in tcp://host:8786,"),
        "ADDRESS",
        "run studies and twins on a Dask cluster, as in tcp://host:8786",
    )
    quiet: bool = free_switch("print errors only", short="-q")
    verbose: bool = free_switch("print more", short="-v")


@dataclass(frozen=True)
class Options:
    """All flags, in parts by their readers; field names are the keys of config files (with `-` for `_`).

    `config` is empty: what the files hold is in the other fields.
    """

    selection: Selection = Selection()
    results: Results = Results()
    setup: Setup = Setup()
    opening: Opening = Opening()
    study: Study = Study()
    output: Output = Output()
    drawing: Drawing = Drawing()
    execution: Execution = Execution()
    config: tuple[str, ...] = several("FILE", "TOML file of flags (repeatable)", numbers=False)


ABOUT = {
    "log": "Run filters and smoothers on identical inputs, score them with one referee,\nand write a report.",
    "lab": "Do a whole lab and answer its questions at the top of the report.",
    "scenario": "Simulate a world many times and judge the consistency of each estimator.",
}
GROUPS = {
    "selection": "input, estimators and association",
    "results": "results of other programs",
    "setup": "association gates, SLAM and calibration",
    "opening": "ground truth, camera and laser logs",
    "study": "Monte Carlo studies and bootstrap replicates",
    "output": "output",
    "drawing": "figures for a paper",
    "execution": "execution",
    "": "configuration",
}
"""Titles of `--help-all`, by the part of `Options` that holds the flag."""
PROG = "python -m eval.run_all"


def help_text(name: str) -> str:
    """Help of everyday use, by the flag whose values words without a flag are, or the examples of `all` flags.

    The command stands there as `PROG`.
    """
    return (Path(__file__).parent / "texts" / f"{name}.txt").read_text(encoding="utf-8")


def parser(prog: str = PROG, positional: str = "log") -> Command:
    """The parser of the given flags only; positional words, under `words`, are values of the flag `positional`."""
    usage = f"{prog} [{positional.upper()} ...] [flags]"
    p = Command(prog, "PROG", ABOUT[positional], help_text("all").strip(), usage=usage, add_help=False)
    groups = {part: p.add_argument_group(title) for part, title in GROUPS.items()}
    words = groups["selection"].add_argument("words", nargs="*", metavar=positional.upper())
    words.help = f"the same as --{positional}"
    for each in rows(Options).values():
        add_flags(groups[each.part], [each])

    class Show(argparse.Action):
        def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
            sys.stdout.write(help_text(positional).replace("PROG", parser.prog))
            parser.exit(0)

    about = "show the flags of everyday use"
    groups[""].add_argument("-h", "--help", nargs=0, dest=argparse.SUPPRESS, action=Show, help=about)
    groups[""].add_argument("--help-all", action="help", help="show all flags")
    return p


def add_flags(p: argparse._ActionsContainer, wanted: Iterable[Flag]) -> None:
    """Add rows of a table to a parser as flags."""
    for each in wanted:
        kind: dict[str, object] = {"action": "append" if each.repeatable else "store", "metavar": each.metavar}
        if not each.metavar:
            kind = {"action": "store_const", "const": not each.default}
        elif each.bare:
            kind = {"nargs": "?", "const": each.bare, "metavar": each.metavar}
        spelled = [each.short, each.option] if each.short else [each.option]
        p.add_argument(*spelled, dest=each.name, default=argparse.SUPPRESS, help=each.help, **kind)  # type: ignore[arg-type]

"""The table of flags of `python -m eval.run_all`, one field a row, in parts by who reads them.

Parser, config files, checks, the command in the report, step mode and player read this table. Imports nothing heavy, so
that `--help` and a mistyped flag answer at once.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from data.command import Command
from data.errors import UsageError
from eval.plan.flags.help import ABOUT, EXAMPLES, GROUPS, PROG, show_everyday
from eval.plan.flags.variant import Variant
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
    switch,
    text,
    texts,
    whole,
)
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS, TASKS, Setup
from eval.studies.shipped import VALIDATIONS, scenarios

FORMATS = ("csv", "md", "tex")
KNOWN_FORMATS = (*FORMATS, "pdf")
FACTORS = ("1", "2", "5", "10", "20", "50", "auto")
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")
QUICK_RUNS = 2
NOT_NEGATIVE = whole(0, "must not be negative")
CONFIGS = Path(__file__).parents[2] / "configs"
INCH = {"in": 1.0, "cm": 1.0 / 2.54, "mm": 1.0 / 25.4, "pt": 1.0 / 72.27}
"""in. A unit of length; pt as TeX has it, 72.27 to the inch."""
SMALLEST, LARGEST = 1.5, 20.0
"""in. Widths of a figure between which axes, ticks and their labels have room."""
TYPE = (4.0, 24.0)
"""pt."""


def shipped() -> list[str]:
    """Names of the configurations that come with the package."""
    return sorted(f.stem for f in CONFIGS.glob("*.toml"))


def inches(length: str) -> float:
    """A length as `3.4in`, `8.6cm`, `86mm` or `252pt`; NaN for what is none."""
    found = re.fullmatch(r"\s*([0-9.]+)\s*(in|cm|mm|pt)\s*", length)
    try:
        return float(found[1]) * INCH[found[2]] if found else math.nan
    except ValueError:
        return math.nan


def width(label: str, value: object) -> str:
    """A length that a figure can be wide."""
    wide = inches(str(value))
    if not math.isfinite(wide):
        raise UsageError(f"{label} {value}: a length with its unit is needed, as in 3.4in, 8.6cm, 86mm or 252pt")
    if not SMALLEST <= wide <= LARGEST:
        raise UsageError(f"{label} {value}: between {SMALLEST:g}in and {LARGEST:g}in is needed")
    return str(value).replace(" ", "")


def points(label: str, value: object) -> float:
    """A size of type."""
    size = positive(label, value)
    if not TYPE[0] <= size <= TYPE[1]:
        raise UsageError(f"{label} {size:g}: between {TYPE[0]:g} and {TYPE[1]:g} points is needed")
    return size


@dataclass(frozen=True)
class Selection:
    """What is run on what."""

    log: tuple[str, ...] = row(
        (),
        texts,
        "PATH|NAME",
        "open log folder, CARMEN log (.log, .clf, also .gz), victoria-park, arena:SEED, circle:SEED, linear:SEED, or "
        "corridor:SEED:people+no-odometry+KEY=VALUE (repeatable; default: victoria-park, arena:0, corridor:0 in five "
        "variants, a short visual:0)",
        repeatable=True,
    )
    data: tuple[str, ...] = row(
        (),
        texts,
        "DIR",
        "add every dataset found in DIR: open logs, UTIAS MRCLAM folders or zips; with --scenario only where the "
        "recording of esde-replay is looked for",
        repeatable=True,
    )
    scenario: tuple[str, ...] = row(
        (),
        texts,
        "NAME|FILE|all",
        f"Monte Carlo study of a world: {', '.join(scenarios())}, a TOML file, or all of those; "
        f"{', '.join(VALIDATIONS)}: of the tests that need no truth, which all leaves out (repeatable)",
        repeatable=True,
    )
    task: tuple[str, ...] = row(
        (), names(TASKS), "LIST", "localization,slam (default: localization where there is a map, else slam)"
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
        "scans alone, else jcbb-hindsight, of walls jcbb)",
    )
    lab: str | None = row(
        None,
        text("a lab"),
        "NAME|FOLDER",
        "do a whole lab and answer its questions at the top of the report: corridor:SEED+KEY=VALUE (four conditions, "
        "every method, with and without map maintenance), visual:SEED, or a folder of recorded runs or with images; "
        "the lab's one gate (--new-gate as --gate) unless stated",
    )


@dataclass(frozen=True)
class Reading:
    """How files of results are read and matched with the truth; `score` has these flags, too."""

    cov: tuple[str, ...] = row(
        (),
        texts,
        "[NAME=]FILE",
        "covariances of a TUM file, as smfeval writes them: stamp and the lower triangle of 6x6 a line (NAME= where "
        "there are several results)",
        repeatable=True,
    )
    times: tuple[str, ...] = row(
        (),
        texts,
        "[NAME=]FILE",
        "stamps [s] of KITTI poses, one a line (NAME= for one of several; truth= for the truth)",
        repeatable=True,
    )
    cov_frame: tuple[str, ...] = row(
        (),
        texts,
        "[NAME=]FRAME",
        "what covariances are of: world (errors added in the world's axes), local (right perturbation, the body's "
        "axes) or left (default: as the format has it)",
        repeatable=True,
    )
    axes: str = row(
        "robot",
        one_of(("robot", "camera")),
        "AXES",
        "of poses in space, robot (z up, default) or camera (z forward, y down, as KITTI's)",
    )
    align: str = row(
        "none",
        one_of(("none", "first", "se2")),
        "HOW",
        "move each result onto the truth: none (default), first (the first matched pose) or se2 (best rigid fit); ours "
        "are never moved",
    )
    truth_gap: float = row(
        1.0, positive, "S", "no truth is interpolated between two that are farther apart (default: 1 s)"
    )


@dataclass(frozen=True)
class Results(Reading):
    """Results that other programs made: what is scored, against which truth."""

    result: tuple[str, ...] = row(
        (),
        texts,
        "NAME=FILE",
        "a trajectory that another program made, scored beside ours: our CSV, TUM (with covariance), SQUARE, EuRoC, "
        "KITTI, ROS bag (FILE:/TOPIC), or the folder of a run (repeatable; docs/results-files.md)",
        repeatable=True,
    )
    truth: str | None = row(
        None,
        text("a file"),
        "FILE",
        "the true path, in any of these formats: of the one --log, or alone with --result",
    )


@dataclass(frozen=True)
class Opening:
    """How logs with images and laser logs are opened."""

    camera_translation: str = row(
        "cm", one_of(("cm", "mm", "m")), "UNIT", "of T in a lab folder's configuration: cm (default), mm, m"
    )
    camera_reading: str = row(
        "to-camera",
        one_of(("to-camera", "to-body")),
        "WAY",
        "R, T of a lab folder: to-camera, p_c = R p_b + T (default), or to-body, the other way round",
    )
    corner_noise: str = row(
        "lab",
        one_of(("lab", "depth")),
        "KIND",
        "of picture corners: lab, 2 cm and 5 cm (default), or depth, along the ray and growing with its square",
    )
    trust_pickle: bool = row(False, switch, "", "read object arrays of a lab folder: they can run code")
    relations: str | None = row(
        None,
        text("a file"),
        "FILE",
        "reference relations of the one laser --log (default: NAME.relations.csv beside it, or relations.csv in its "
        "folder)",
    )


@dataclass(frozen=True)
class Study:
    """How much is simulated."""

    runs: int | None = row(
        None,
        NOT_NEGATIVE,
        "N",
        f"runs of the consistency study (default: 50, or what a scenario says; {QUICK_RUNS} with --quick; 0: none, the "
        "default with --log)",
    )
    seed: int = row(0, NOT_NEGATIVE, "N", "first seed of the consistency study and of twins (default: 0)")
    twins: int | None = row(
        None,
        NOT_NEGATIVE,
        "N",
        "draw every log N times again as it says of itself, for p values of what it says (default: 0; 100 with --full, "
        "for ekf and batch)",
    )
    full: bool = row(False, switch, "", "the default suite with every method; takes minutes")


@dataclass(frozen=True)
class Output:
    """What is written, and how tables and pictures of the report are made."""

    quick: bool = row(
        False, switch, "", "a short report in seconds: fewer frames and pictures, PNG only, too few runs for verdicts"
    )
    out: Path = free_row(
        Path("results/report"),
        folder,
        "DIR",
        "result folder, replaced as a whole when done (default: results/report)",
    )
    formats: tuple[str, ...] = free_row(
        FORMATS, names(KNOWN_FORMATS), "LIST", "of tables: csv,md,tex (default: all three); pdf: figures also as PDF"
    )
    columns: tuple[str, ...] = free_row(
        (),
        names(),
        "LIST",
        "columns of the LaTeX tables, in this order, by their names in metrics.csv, association.csv and "
        "consistency.csv (default: as many as there is room for)",
    )
    table_width: str = free_row(
        "page",
        one_of(("column", "page")),
        "WIDTH",
        "of the LaTeX tables: column (252 pt) or page (516 pt, default) of an IEEE paper",
    )
    write_up: bool = free_row(
        False, switch, "", "leave write-up.tex, which sets tables and figures, one page per log, for pdflatex"
    )
    lab_text: bool = free_row(
        False,
        switch,
        "",
        "leave lab.txt with each run: its steps as the lab's program prints them, numbers from 1",
    )
    no_plots: bool = free_row(False, switch, "", "tables only")
    open: bool = free_row(False, switch, "", "show the report in the browser when it is written")
    ellipses: str = free_row(
        "1",
        one_of(FACTORS),
        "FACTOR",
        f"ellipses in the plan of a camera log, so many times as large as they are: of {', '.join(FACTORS)} (default: "
        "1; auto: as large as is needed, as --lab shows beside it)",
    )
    animate: bool = free_row(False, switch, "", "a film (WebM) per log, task, estimator and association")
    speed: float | None = free_row(
        None,
        positive,
        "FACTOR",
        "of the films: seconds of the log in one of the film, frames where it has no stamps (default: real time, or "
        "the round factor with which it lasts no longer than a minute)",
    )

    @property
    def kept(self) -> Path:
        """The folder of the result folder: what is found again in the next run (of studies, twins, images) is there."""
        return self.out.absolute().parent

    @property
    def ellipse_factor(self) -> int | None:
        """By how much ellipses are enlarged, None for as is needed."""
        return None if self.ellipses == "auto" else int(self.ellipses)


@dataclass(frozen=True)
class Drawing:
    """How figures look in a paper."""

    figure_width: str | None = free_row(
        None, width, "LENGTH", "of all figures, as in 3.4in, 8.6cm, 252pt (default: 7in)"
    )
    font: str | None = free_row(None, text("a font's name"), "NAME", "of all figures, as in Times")
    font_size: float = free_row(8.0, points, "PT", "of titles and labels in figures; ticks have 1 pt less (default: 8)")
    usetex: bool = free_row(False, switch, "", "LaTeX sets the text in figures (latex, dvipng)")
    pgf: bool = free_row(False, switch, "", "figures as .pgf, too: the document's own fonts (pdflatex or xelatex)")


@dataclass(frozen=True)
class Execution:
    """Where the work is done, and what is said meanwhile."""

    jobs: int = free_row(1, whole(1, "at least one process is needed"), "N", "processes (default: one per core)")
    scheduler: str | None = free_row(
        None,
        text("an address, as in tcp://host:8786,"),
        "ADDRESS",
        "do the runs of studies and twins on a Dask cluster, as in tcp://host:8786",
    )
    quiet: bool = free_row(False, switch, "", "print only errors", short="-q")
    verbose: bool = free_row(False, switch, "", "print more", short="-v")


@dataclass(frozen=True)
class Options:
    """What was asked for, a part for each who reads it; names of fields are the config file's keys (with `-` for `_`).

    Attributes:
        config: the files that must be read again for the same numbers: all, if one of them holds a variant.
        stated: the other keys that those files state.
        variants: what they hold in their tables [variant].
    """

    selection: Selection = Selection()
    results: Results = Results()
    setup: Setup = Setup()
    opening: Opening = Opening()
    study: Study = Study()
    output: Output = Output()
    drawing: Drawing = Drawing()
    execution: Execution = Execution()
    config: tuple[str, ...] = row(
        (),
        texts,
        "FILE|NAME",
        f"TOML file with the same keys, or a shipped one: {', '.join(shipped())}",
        repeatable=True,
    )
    stated: tuple[str, ...] = ()
    variants: tuple[Variant, ...] = ()


def parser(prog: str = PROG, positional: str = "log") -> Command:
    """The flags; words without one are values of the flag `positional`, under the name `words`.

    Only what was given is in the result, so that a config file can fill in the rest.
    """
    usage = f"{prog} [{positional.upper()} ...] [flags]"
    p = Command(prog, PROG, ABOUT[positional], EXAMPLES, usage=usage, add_help=False)
    groups = {part: p.add_argument_group(title) for part, title in GROUPS.items()}
    words = groups["selection"].add_argument("words", nargs="*", metavar=positional.upper())
    words.help = f"the same as --{positional}"
    for flag in rows(Options).values():
        add_flags(groups[flag.part], [flag])
    show = show_everyday(positional)
    groups[""].add_argument(
        "-h", "--help", nargs=0, dest=argparse.SUPPRESS, action=show, help="the flags of everyday use"
    )
    groups[""].add_argument("--help-all", action="help", help="all flags")
    return p


def add_flags(p: argparse._ActionsContainer, wanted: Iterable[Flag]) -> None:
    """Rows of a table as flags of a parser."""
    for each in wanted:
        kind: dict[str, object] = {"action": "append" if each.repeatable else "store", "metavar": each.metavar}
        if not each.metavar:
            kind = {"action": "store_const", "const": not each.default}
        elif each.bare:
            kind = {"nargs": "?", "const": each.bare, "metavar": each.metavar}
        spelled = [each.short, each.option] if each.short else [each.option]
        p.add_argument(*spelled, dest=each.name, default=argparse.SUPPRESS, help=each.help, **kind)  # type: ignore[arg-type]

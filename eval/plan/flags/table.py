"""The table of flags of `python -m eval.run_all`, one field a row.

Parser, config files, checks, the command in the report and step mode read this table; its middle part, `Setup`, serves
scenario files, too. Imports nothing heavy, so that `--help` and a mistyped flag answer at once.

Flags of a lab's hand-in: which lab is done as a whole, and whether a text to be handed in is left beside it.

Flags of tables and figures for a paper: which columns, how wide, in which type. No number depends on them.

Flags of results that other programs made: what is scored, against which truth, and how its files are read.

The same recording through other numbers, as one more row: how a published tutorial treats it.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path

from data.errors import UsageError
from eval.plan.flags.examples import EPILOG, PROG
from eval.replay.external.spec import FORM, own_or_foreign
from eval.replay.flag import (
    Flag,
    flag,
    folder,
    names,
    numbers,
    one_of,
    positive,
    positive_or_none,
    probability,
    rows,
    switch,
    text,
    texts,
    whole,
)
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS, TASKS, Setup
from eval.studies.shipped import VALIDATIONS, scenarios

FACTORS = ("1", "2", "5", "10", "20", "50", "auto")


@dataclass(frozen=True)
class LabFlags:
    """The rows of `run_all`."""

    lab: str | None = field(
        default=None,
        metadata=flag(
            text("a lab"), "NAME|FOLDER", "do a whole lab and answer its questions at the top of the report: "
            "corridor:SEED+KEY=VALUE (four conditions, every method, with and without map maintenance), visual:SEED, "
            "or a folder of recorded runs or with images; the lab's one gate (--new-gate as --gate) unless stated",
        ),
    )  # fmt: skip
    ellipses: str = field(
        default="1",
        metadata=flag(
            one_of(FACTORS), "FACTOR", f"ellipses in the plan of a camera log, so many times as large as they are: of "
            f"{', '.join(FACTORS)} (default: 1; auto: as large as is needed, as --lab shows beside it)", numbers=False,
        ),
    )  # fmt: skip
    lab_text: bool = field(
        default=False,
        metadata=flag(
            switch, "", "leave lab.txt with each run: its steps as the lab's program prints them, numbers from 1",
            numbers=False,
        ),
    )  # fmt: skip
    write_up: bool = field(
        default=False,
        metadata=flag(
            switch, "", "leave write-up.tex, which sets tables and figures, one page per log, for pdflatex",
            numbers=False,
        ),
    )  # fmt: skip

    @property
    def ellipse_factor(self) -> int | None:
        """By how much ellipses are enlarged, None for as is needed."""
        return None if self.ellipses == "auto" else int(self.ellipses)


INCH = {"in": 1.0, "cm": 1.0 / 2.54, "mm": 1.0 / 25.4, "pt": 1.0 / 72.27}
"""in. A unit of length; pt as TeX has it, 72.27 to the inch."""
SMALLEST, LARGEST = 1.5, 20.0
"""in. Widths of a figure between which axes, ticks and their labels have room."""
TYPE = (4.0, 24.0)
"""pt."""


def inches(length: str) -> float:
    """A length as `3.4in`, `8.6cm`, `86mm` or `252pt`."""
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


def columns(label: str, value: object) -> tuple[str, ...]:
    """Names separated by commas or as a list, each once; whether there are such columns is asked later."""
    given = tuple(name.strip() for part in texts(label, value) for name in part.split(",") if name.strip())
    if len(set(given)) != len(given):
        raise UsageError(f"{label} {','.join(given)}: named twice")
    return given


@dataclass(frozen=True)
class Paper:
    """How tables and figures are made for a paper."""

    columns: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            columns, "LIST", "columns of the LaTeX tables, in this order, by their names in metrics.csv, "
            "association.csv and consistency.csv (default: as many as there is room for)", numbers=False,
        ),
    )  # fmt: skip
    table_width: str = field(
        default="page",
        metadata=flag(
            one_of(("column", "page")), "WIDTH", "of the LaTeX tables: column (252 pt) or page (516 pt, default) of an "
            "IEEE paper", numbers=False,
        ),
    )  # fmt: skip
    figure_width: str | None = field(
        default=None,
        metadata=flag(width, "LENGTH", "of all figures, as in 3.4in, 8.6cm, 252pt (default: 7in)", numbers=False),
    )
    font: str | None = field(
        default=None, metadata=flag(text("a font's name"), "NAME", "of all figures, as in Times", numbers=False)
    )
    font_size: float = field(
        default=8.0, metadata=flag(points, "PT", "of titles and labels in figures; ticks have 1 pt less (default: 8)",
                                   numbers=False)
    )  # fmt: skip
    usetex: bool = field(
        default=False, metadata=flag(switch, "", "LaTeX sets the text in figures (latex, dvipng)", numbers=False)
    )
    pgf: bool = field(
        default=False,
        metadata=flag(
            switch, "", "figures as .pgf, too: the document's own fonts (pdflatex or xelatex)", numbers=False
        ),
    )


ALIGNMENTS = ("none", "first", "se2")
AXES = ("robot", "camera")


@dataclass(frozen=True)
class Reading:
    """How the files of results are read and matched with the truth; `score` has these flags, too."""

    cov: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "[NAME=]FILE", "covariances of a TUM file, as smfeval writes them: stamp and the lower triangle of "
            "6x6 a line (NAME= where there are several results)", repeatable=True,
        ),
    )  # fmt: skip
    times: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "[NAME=]FILE", "stamps [s] of KITTI poses, one a line (NAME= for one of several; truth= for the "
            "truth)", repeatable=True,
        ),
    )  # fmt: skip
    cov_frame: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "[NAME=]FRAME", "what covariances are of: world (errors added in the world's axes), local (right "
            "perturbation, the body's axes) or left (default: as the format has it)", repeatable=True,
        ),
    )  # fmt: skip
    axes: str = field(
        default="robot",
        metadata=flag(
            one_of(AXES), "AXES", "of poses in space, robot (z up, default) or camera (z forward, y down, as KITTI's)"
        ),
    )  # fmt: skip
    align: str = field(
        default="none",
        metadata=flag(
            one_of(ALIGNMENTS), "HOW", "move each result onto the truth: none (default), first (the first matched "
            "pose) or se2 (best rigid fit); ours are never moved",
        ),
    )  # fmt: skip
    truth_gap: float = field(
        default=1.0,
        metadata=flag(
            positive, "S", "no truth is interpolated between two that are farther apart (default: 1 s)"
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Results(Reading):
    """The rows of `run_all`."""

    result: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "NAME=FILE", "a trajectory that another program made, scored beside ours: our CSV, TUM (with "
            "covariance), SQUARE, EuRoC, KITTI, ROS bag (FILE:/TOPIC), or the folder of a run (repeatable; "
            "docs/results-files.md)", repeatable=True,
        ),
    )  # fmt: skip
    truth: str | None = field(
        default=None,
        metadata=flag(
            text("a file"), "FILE", "the true path, in any of these formats: of the one --log, or alone with --result"
        ),
    )  # fmt: skip


def alphas_of(label: str, value: object) -> tuple[float, ...]:
    """Four numbers, or six."""
    found: tuple[float, ...] = numbers(6 if isinstance(value, (list, tuple)) and len(value) == 6 else 4)(label, value)
    return found


@dataclass(frozen=True)
class Variant:
    """The same recording through other numbers, as one more row: how a published tutorial treats it.

    Attributes:
        name: appended to the log's name.
        task: the one task it is about.
        grid: s, instants to which odometry and readings are brought.
        model: motion model; noise: the convention of its alphas (see `data.motion.velocity.VelocityNoise`).
        sigma: of range [m] and bearing [rad].
        prior_variance: of x, y [m^2] and heading [rad^2].
        each: one update per observation instead of one per frame.
        new_variance: m^2, variance of a new landmark, uncorrelated; None: exact augmentation.
        new_variance_per_square: the same as a share of the squared range.
        association: how it pairs; gate, new_gate: probabilities, None for no gate.
        start: s after the first ground-truth row; the log begins no earlier.
        own_odometry, gapless, skip_led_by: see `data.formats.mrclam.load.Grid`.
        filled_prior: all nine entries of the prior's covariance are its variance, not the three on the diagonal.
        gain_before_prediction, running_minimum: faults of the programs, see `eval.plan.tutorials`.
        original: what the original program gives on `original_log`: sum of squared errors of position [m^2], and
            position RMSE [m].
        notes: what the original does otherwise than the algorithm it teaches, and what of it is not reproduced.
    """

    name: str = field(metadata=flag(text("a name")))
    task: str = field(metadata=flag(one_of(TASKS)))
    grid: float = field(metadata=flag(positive))
    model: str = field(metadata=flag(one_of(("unicycle", "half_angle"))))
    alphas: tuple[float, ...] = field(metadata=flag(alphas_of))
    sigma: tuple[float, float] = field(metadata=flag(numbers(2)))
    prior_variance: float = field(metadata=flag(positive))
    noise: str = field(default="displacement", metadata=flag(one_of(("displacement", "textbook"))))
    each: bool = field(default=False, metadata=flag(switch))
    new_variance: float | None = field(default=None, metadata=flag(positive_or_none))
    new_variance_per_square: float | None = field(default=None, metadata=flag(positive_or_none))
    association: str = field(default="known", metadata=flag(one_of(ASSOCIATIONS)))
    gate: float | None = field(default=None, metadata=flag(probability))
    new_gate: float | None = field(default=None, metadata=flag(probability))
    start: float | None = field(default=None, metadata=flag(positive_or_none))
    own_odometry: bool = field(default=False, metadata=flag(switch))
    gapless: bool = field(default=False, metadata=flag(switch))
    skip_led_by: int | None = field(default=None, metadata=flag(whole(0, "must not be negative")))
    filled_prior: bool = field(default=False, metadata=flag(switch))
    gain_before_prediction: bool = field(default=False, metadata=flag(switch))
    running_minimum: bool = field(default=False, metadata=flag(switch))
    original: tuple[float, float] | None = field(default=None, metadata=flag(numbers(2)))
    original_log: str = field(default="", metadata=flag(text("a name")))
    notes: tuple[str, ...] = field(default=(), metadata=flag(texts))

    def __post_init__(self) -> None:
        if len(self.alphas) == 6 and self.noise != "textbook":
            raise UsageError(f"{self.name}: six alphas go with noise = 'textbook', {self.noise!r} takes four")
        if self.gain_before_prediction and (self.task, self.association) != ("localization", "known"):
            raise UsageError(f"{self.name}: gain_before_prediction is for localization with labels")
        if self.running_minimum and self.association != "ml-ratio":
            raise UsageError(f"{self.name}: running_minimum is of the association ml-ratio")


FORMATS = ("csv", "md", "tex")
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")
QUICK_RUNS = 2
CONFIGS = Path(__file__).parents[2] / "configs"


def shipped() -> list[str]:
    """Names of the configurations that come with the package."""
    return sorted(f.stem for f in CONFIGS.glob("*.toml"))


@dataclass(frozen=True)
class Selection:
    """What is run: these rows come before those of `Setup`."""

    log: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "PATH|NAME", "open log folder, CARMEN log (.log, .clf, also .gz), victoria-park, arena:SEED, "
            "circle:SEED, linear:SEED, or corridor:SEED:people+no-odometry+KEY=VALUE (repeatable; default: "
            "victoria-park, arena:0, corridor:0 in five variants, a short visual:0)", repeatable=True,
        ),
    )  # fmt: skip
    data: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "DIR", "add every dataset found in DIR: open logs, UTIAS MRCLAM folders or zips; with --scenario "
            "only where the recording of esde-replay is looked for", repeatable=True,
        ),
    )  # fmt: skip
    scenario: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "NAME|FILE|all", f"Monte Carlo study of a world: {', '.join(scenarios())}, a TOML file, or all of "
            f"those; {', '.join(VALIDATIONS)}: of the tests that need no truth, which all leaves out (repeatable)",
            repeatable=True,
        ),
    )  # fmt: skip
    task: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            names(TASKS), "LIST", "localization,slam (default: localization where there is a map, else slam)"
        ),
    )  # fmt: skip
    estimator: tuple[str, ...] = field(
        default=DEFAULT_ESTIMATORS,
        metadata=flag(
            own_or_foreign("estimator", least=1), "LIST",
            f"of {', '.join(ESTIMATORS)}, or your own as {FORM} (default: {','.join(DEFAULT_ESTIMATORS)})",
        ),
    )  # fmt: skip
    association: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            own_or_foreign("association"), "LIST",
            f"of {', '.join(ASSOCIATIONS)}, or your own (default: known where the log has labels, scan where it "
            "has laser scans alone, else jcbb-hindsight, of walls jcbb)",
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Options(Paper, Setup, Results, LabFlags, Selection):
    """What was asked for, the setup included; field names are the config file's keys (with `-` for `_`).

    Attributes:
        config: the files that must be read again for the same numbers: all, if one of them holds a variant.
        stated: the other keys that those files state.
        variants: what they hold in their tables [variant].
    """

    camera_translation: str = field(
        default="cm",
        metadata=flag(
            one_of(("cm", "mm", "m")), "UNIT", "of T in a lab folder's configuration: cm (default), mm, m"
        ),
    )  # fmt: skip
    camera_reading: str = field(
        default="to-camera",
        metadata=flag(
            one_of(("to-camera", "to-body")), "WAY",
            "R, T of a lab folder: to-camera, p_c = R p_b + T (default), or to-body, the other way round",
        ),
    )  # fmt: skip
    corner_noise: str = field(
        default="lab",
        metadata=flag(
            one_of(("lab", "depth")), "KIND", "of picture corners: lab, 2 cm and 5 cm (default), or depth, along the "
            "ray and growing with its square",
        ),
    )  # fmt: skip
    trust_pickle: bool = field(
        default=False, metadata=flag(switch, "", "read object arrays of a lab folder: they can run code")
    )
    relations: str | None = field(
        default=None,
        metadata=flag(
            text("a file"), "FILE", "reference relations of the one laser --log (default: NAME.relations.csv beside "
            "it, or relations.csv in its folder)",
        ),
    )  # fmt: skip
    runs: int | None = field(
        default=None,
        metadata=flag(
            whole(0, "must not be negative"), "N",
            f"runs of the consistency study (default: 50, or what a scenario says; {QUICK_RUNS} with --quick; "
            "0: none, the default with --log)",
        ),
    )  # fmt: skip
    seed: int = field(
        default=0,
        metadata=flag(
            whole(0, "must not be negative"), "N", "first seed of the consistency study and of twins (default: 0)"
        ),
    )
    twins: int | None = field(
        default=None,
        metadata=flag(
            whole(0, "must not be negative"), "N",
            "draw every log N times again as it says of itself, for p values of what it says (default: 0; 100 with "
            "--full, for ekf and batch)",
        ),
    )  # fmt: skip
    jobs: int = field(
        default=1,
        metadata=flag(
            whole(1, "at least one process is needed"), "N", "processes (default: one per core)", numbers=False
        ),
    )  # fmt: skip
    scheduler: str | None = field(
        default=None,
        metadata=flag(
            text("an address, as in tcp://host:8786,"), "ADDRESS",
            "do the runs of studies and twins on a Dask cluster, as in tcp://host:8786", numbers=False,
        ),
    )  # fmt: skip
    quick: bool = field(
        default=False,
        metadata=flag(
            switch, "", "a short report in seconds: fewer frames and pictures, PNG only, too few runs for verdicts"
        ),
    )  # fmt: skip
    full: bool = field(default=False, metadata=flag(switch, "", "the default suite with every method; takes minutes"))
    out: Path = field(
        default=Path("results/report"),
        metadata=flag(
            folder, "DIR", "result folder, replaced as a whole when done (default: results/report)", numbers=False
        ),
    )  # fmt: skip
    formats: tuple[str, ...] = field(
        default=FORMATS,
        metadata=flag(names(FORMATS), "LIST", "table formats of csv,md,tex (default: all)", numbers=False),
    )
    no_plots: bool = field(default=False, metadata=flag(switch, "", "tables only", numbers=False))
    animate: bool = field(
        default=False,
        metadata=flag(switch, "", "a film (WebM) per log, task, estimator and association", numbers=False),
    )
    speed: float | None = field(
        default=None,
        metadata=flag(
            positive, "FACTOR", "of the films: seconds of the log in one of the film, frames where it has no stamps "
            "(default: real time, or the round factor with which it lasts no longer than a minute)", numbers=False,
        ),
    )  # fmt: skip
    config: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "FILE|NAME", "TOML file with the same keys, or a shipped one: " + ", ".join(shipped()),
            repeatable=True,
        ),
    )  # fmt: skip
    quiet: bool = field(default=False, metadata=flag(switch, "", "print only errors", numbers=False, short="-q"))
    verbose: bool = field(default=False, metadata=flag(switch, "", "print more", numbers=False, short="-v"))
    stated: tuple[str, ...] = ()
    variants: tuple[Variant, ...] = ()

    @property
    def setup(self) -> Setup:
        """How observations are paired and how much of the map is kept."""
        return Setup(**{f.name: getattr(self, f.name) for f in fields(Setup)})


def parser(prog: str = PROG) -> argparse.ArgumentParser:
    """The flags. Only what was given is in the result, so that a config file can fill in the rest."""
    p = argparse.ArgumentParser(
        prog=prog,
        description="Run filters and smoothers on identical inputs, score them with one referee, and write the report.",
        epilog=EPILOG.replace(PROG, prog),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_flags(p, rows(Options).values())
    return p


def add_flags(p: argparse.ArgumentParser, wanted: Iterable[Flag]) -> None:
    """Rows of a table as flags of a parser."""
    for row in wanted:
        options = [row.short, row.option] if row.short else [row.option]
        if not row.metavar:
            p.add_argument(
                *options, dest=row.name, action="store_const", const=not row.default, default=argparse.SUPPRESS,
                help=row.help,
            )  # fmt: skip
        elif row.bare:
            p.add_argument(
                *options, nargs="?", const=row.bare, metavar=row.metavar, default=argparse.SUPPRESS, help=row.help
            )
        else:
            p.add_argument(
                *options, action="append" if row.repeatable else "store", metavar=row.metavar,
                default=argparse.SUPPRESS, help=row.help,
            )  # fmt: skip

"""The flags of `slamref run`, one field each, in parts by their readers. It imports no numerical library."""

import argparse
import math
import re
import sys
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from data.command import Command
from data.errors import UsageError
from data.wing import wings
from eval.figures import FIGURES
from eval.plan.flags import TEXTS
from eval.replay import flag
from eval.replay.external.spec import FORM, own_or_foreign
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS, POSE_GATE, SENSED_GATE, STEPPING, TASKS, Setup
from eval.studies.shipped import scenarios

FORMATS = ("csv", "md", "tex")
KNOWN_FORMATS = (*FORMATS, "pdf")
FACTORS = ("1", "2", "5", "10", "20", "50", "auto")
KINDS = (FIGURES[0], *(name for wing in wings() for name in wing.figures), *FIGURES[1:])  # of figures of a log
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")
QUICK_RUNS = 2
TWINS = 99  # replicates of a log: a share of the level of 5 % still leaves ranks to those statistics that need them
NOT_NEGATIVE = flag.whole(0, "must not be negative")
FIRST_FRAMES = flag.whole(1, "a whole number from 1 up is needed")  # `--frames` of step and play
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
    size = flag.positive(label, value)
    if not TYPE[0] <= size <= TYPE[1]:
        raise UsageError(f"{label} {size:g}: between {TYPE[0]:g} and {TYPE[1]:g} points is needed")
    return size


_NAMES = {
    "estimators": ", ".join(ESTIMATORS), "associations": ", ".join(ASSOCIATIONS), "scenarios": ", ".join(scenarios()),
    "figures": ", ".join(KINDS), "factors": ", ".join(FACTORS), "default": ",".join(DEFAULT_ESTIMATORS), "form": FORM,
    "quick_runs": QUICK_RUNS, "twins": TWINS, "sensed": SENSED_GATE, "poses": POSE_GATE,
    "stepping": ", ".join(STEPPING),
}  # fmt: skip
_TEXTS: dict[str, Any] = tomllib.loads((TEXTS / "flags.toml").read_text(encoding="utf-8"))
ABOUT, GROUPS = _TEXTS.pop("about"), _TEXTS.pop("groups")
HELP: dict[str, str] = {name: text.format(**_NAMES) for name, text in _TEXTS.items()}  # of each flag by its name

several = partial(flag.row, (), flag.texts, repeatable=True)  # a flag given once for each of its values
file_row = partial(flag.row, None, flag.text("a file"), "FILE")
switch_row = partial(flag.row, False, flag.switch, "")
free_switch = partial(flag.free_row, False, flag.switch, "")
exclude_truth_row = partial(flag.row, (), flag.stretches, "FROM:TO", repeatable=True)


def choice(default: str, others: Iterable[str], metavar: str, kind: Callable[..., Any] = flag.row) -> Any:
    """A flag with one of several names, the default among them."""
    return kind(default, flag.one_of((default, *others)), metavar)


@dataclass(frozen=True)
class Selection:
    """Logs, tasks, estimators and association methods."""

    log: tuple[str, ...] = several("PATH|NAME")
    data: tuple[str, ...] = several("DIR")
    scenario: tuple[str, ...] = several("NAME|FILE|all")
    task: tuple[str, ...] = flag.row((), flag.names(TASKS), "LIST")
    estimator: tuple[str, ...] = flag.row(DEFAULT_ESTIMATORS, own_or_foreign("estimator", least=1), "LIST")
    association: tuple[str, ...] = flag.row((), own_or_foreign("association"), "LIST")
    lab: str | None = flag.row(None, flag.text("a lab"), "NAME|FOLDER")
    cooperative: bool = switch_row()


@dataclass(frozen=True)
class Matching:
    """How files of results are read and matched with the truth; `slamref score` has these flags, too."""

    cov: tuple[str, ...] = several("[NAME=]FILE")
    times: tuple[str, ...] = several("[NAME=]FILE")
    cov_frame: tuple[str, ...] = several("[NAME=]FRAME")
    cov_order: tuple[str, ...] = several("[NAME=]ORDER")
    axes: tuple[str, ...] = several("[NAME=]AXES")
    unit: tuple[str, ...] = several("[NAME=]UNIT")
    time_offset: tuple[str, ...] = several("[NAME=]S")
    align: str = choice("none", ("first", "shift", "se2", "se3", "sim3", "yaw"), "HOW")
    pairs: str = choice("evo", ("rpg", "openvins", "kitti"), "WHOSE")
    truth_gap: float | None = flag.row(None, flag.positive, "S")


@dataclass(frozen=True)
class Scoring(Matching):
    """The flags of `slamref score`."""

    columns: tuple[str, ...] = several("KEY=NAME,...", HELP["path_columns"])
    exclude_truth: tuple[str, ...] = exclude_truth_row()
    keep_truth: bool = switch_row()


@dataclass(frozen=True)
class Results(Matching):
    """Results of other programs, and their truth."""

    result: tuple[str, ...] = several("NAME=FILE")
    truth: str | None = file_row()


@dataclass(frozen=True)
class Opening:
    """How logs are opened: their ground truth, logs with images, laser logs."""

    camera_translation: str = choice("cm", ("mm", "m"), "UNIT")
    camera_reading: str = choice("to-camera", ("to-body",), "WAY")
    corner_noise: str = choice("lab", ("depth",), "KIND")
    trust_pickle: bool = switch_row()
    exclude_truth: tuple[str, ...] = exclude_truth_row()
    keep_truth: bool = switch_row()
    relations: str | None = file_row()
    no_odometry: bool = switch_row()


@dataclass(frozen=True)
class Study:
    """How much is simulated."""

    runs: int | None = flag.row(None, NOT_NEGATIVE, "N")
    seed: int = flag.row(0, NOT_NEGATIVE, "N")
    twins: int | None = flag.row(None, NOT_NEGATIVE, "N", bare=str(TWINS))
    full: bool = switch_row()


@dataclass(frozen=True)
class Output:
    """Files, tables and figures of the report."""

    quick: bool = switch_row()
    out: Path = flag.free_row(Path("results/report"), flag.folder, "DIR")
    formats: tuple[str, ...] = flag.free_row(FORMATS, flag.names(KNOWN_FORMATS), "LIST")
    columns: tuple[str, ...] = flag.free_row((), flag.names(), "LIST")
    table_width: str = choice("page", ("column",), "WIDTH", flag.free_row)
    figures: tuple[str, ...] = flag.free_row((), flag.names(KINDS), "LIST")
    show: tuple[str, ...] = flag.free_row((), flag.names(), "LIST")
    write_up: bool = free_switch()
    lab_text: bool = free_switch()
    no_plots: bool = free_switch()
    open: bool = free_switch()
    ellipses: str = choice("1", FACTORS[1:], "FACTOR", flag.free_row)
    animate: bool = free_switch()
    speed: float | None = flag.free_row(None, flag.positive, "FACTOR")

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

    no_titles: bool = free_switch()
    figure_width: str | None = flag.free_row(None, width, "LENGTH")
    font: str | None = flag.free_row(None, flag.text("a font's name"), "NAME")
    font_size: float = flag.free_row(8.0, points, "PT")
    usetex: bool = free_switch()
    pgf: bool = free_switch()


@dataclass(frozen=True)
class Execution:
    """Processes and messages."""

    jobs: int = flag.free_row(1, flag.whole(1, "at least one process is needed"), "N")
    scheduler: str | None = flag.free_row(None, flag.text("an address, as in tcp://host:8786,"), "ADDRESS")
    quiet: bool = free_switch(short="-q")
    verbose: bool = free_switch(short="-v")


@dataclass(frozen=True)
class Options:
    """All flags, in parts by their readers; field names are the keys of config files (with `-` for `_`). `config` is
    empty: what the files hold is in the other fields.
    """

    selection: Selection = Selection()
    results: Results = Results()
    setup: Setup = Setup()
    opening: Opening = Opening()
    study: Study = Study()
    output: Output = Output()
    drawing: Drawing = Drawing()
    execution: Execution = Execution()
    config: tuple[str, ...] = several("FILE", numbers=False)


PROG = "python -m eval.run_all"


def help_text(name: str) -> str:
    """Help of everyday use, by the flag of words without a flag, or examples of `all` flags; `PROG`: the command."""
    return (TEXTS / f"{name}.txt").read_text(encoding="utf-8")


def parser(prog: str = PROG, positional: str = "log") -> Command:
    """The parser of the given flags only; positional words, under `words`, are values of the flag `positional`."""
    usage = f"{prog} [{positional.upper()} ...] [flags]"
    epilog = help_text("all").strip()
    if positional != "log":  # own examples, which stand below the flags of everyday use
        _, status, ends = epilog.partition("\nexit status")
        own = re.findall(r"^ +(PROG .+)\n", help_text(positional), re.M)
        epilog = "\n  ".join(["examples, of other flags in slamref run --help-all:", *own]) + f"\n{status}{ends}"
    p = Command(prog, "PROG", ABOUT[positional], epilog, usage=usage, add_help=False)
    groups = {part: p.add_argument_group(title) for part, title in GROUPS.items()}
    words = groups["selection"].add_argument("words", nargs="*", metavar=positional.upper())
    words.help = f"the same as --{positional}"
    for each in flag.rows(Options).values():
        add_flags(groups[each.part], [each])

    class Show(argparse.Action):
        def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
            sys.stdout.write(help_text(positional).replace("PROG", parser.prog))
            parser.exit(0)

    about = "show the flags of everyday use"
    groups[""].add_argument("-h", "--help", nargs=0, dest=argparse.SUPPRESS, action=Show, help=about)
    groups[""].add_argument("--help-all", action="help", help="show all flags")
    return p


def add_flags(p: argparse._ActionsContainer, wanted: Iterable[flag.Flag]) -> None:
    """Add rows of a table to a parser as flags."""
    for each in wanted:
        kind: dict[str, Any] = {"action": "append" if each.repeatable else "store", "metavar": each.metavar}
        if not each.metavar:
            kind = {"action": "store_const", "const": not each.default}
        elif each.bare:
            kind = {"nargs": "?", "const": each.bare, "metavar": each.metavar}
        spelled = [each.short, each.option] if each.short else [each.option]
        p.add_argument(*spelled, dest=each.name, default=argparse.SUPPRESS, help=each.help or HELP[each.name], **kind)

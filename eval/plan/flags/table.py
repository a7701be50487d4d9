"""The table of flags of `python -m eval.run_all`, one field a row.

Parser, config files, checks, the command in the report and step mode read this table; its middle part, `Setup`, serves
scenario files, too. Imports nothing heavy, so that `--help` and a mistyped flag answer at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path

from eval.plan.flags.examples import EPILOG, PROG
from eval.plan.flags.lab import LabFlags
from eval.plan.flags.paper import Paper
from eval.plan.flags.results import Results
from eval.plan.flags.variant import Variant
from eval.replay.flag import Flag, flag, folder, names, one_of, positive, rows, switch, text, texts, whole
from eval.replay.foreign.spec import FORM, own_or_foreign
from eval.replay.names import ASSOCIATIONS, ESTIMATORS, TASKS
from eval.replay.settings import Setup
from eval.studies.shipped import VALIDATIONS, scenarios

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

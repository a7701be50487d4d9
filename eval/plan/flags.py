"""The table of flags of `python -m eval.run_all`, one field a row, with an example of each in `--help`.

Parser, config files, checks, the command in the report and step mode read this table; its middle part, `Setup`, serves
scenario files, too. Imports nothing heavy, so that `--help` and a mistyped flag answer at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path

from eval.plan.variant import Variant
from eval.replay.flag import Flag, flag, folder, names, one_of, rows, switch, text, texts, whole
from eval.replay.names import ASSOCIATIONS, ESTIMATORS, TASKS
from eval.replay.settings import Setup
from eval.studies.shipped import VALIDATIONS, scenarios

PROG = "python -m eval.run_all"
FORMATS = ("csv", "md", "tex")
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")
QUICK_RUNS = 2
CONFIGS = Path(__file__).parents[1] / "configs"


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
            names(ESTIMATORS, least=1), "LIST",
            f"of {', '.join(ESTIMATORS)} (default: {','.join(DEFAULT_ESTIMATORS)})",
        ),
    )  # fmt: skip
    association: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            names(ASSOCIATIONS), "LIST",
            f"of {', '.join(ASSOCIATIONS)} (default: known where the log has labels, scan where it "
            "has laser scans alone, else jcbb)",
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Options(Setup, Selection):
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
    animate: bool = field(default=False, metadata=flag(switch, "", "an MP4 per log, task and estimator", numbers=False))
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


EPILOG = """\
examples:
  python -m eval.run_all                                    the default report, in results/report
  python -m eval.run_all --quick                            the same, shortened (a check that all works)
  python -m eval.run_all --log my_log --log arena:3         an open log folder and a simulated log
  python -m eval.run_all --log intel.log.gz --keyframe-distance 0.8    a laser log (CARMEN): scans matched, loops closed
  python -m eval.run_all --log victoria-park --task slam    one log, one task
  python -m eval.run_all --log visual:0                     a rendered camera log: pictures found, corners used
  python -m eval.run_all --log my_lab_folder --camera-translation m --camera-reading to-body --trust-pickle
  python -m eval.run_all --log visual:0:frames=40 --corner-noise depth
  python -m eval.run_all --log corridor:0:people+range=8    the corridor lab: people in the way, any constant changed
  python -m eval.run_all --log intel.log.gz --relations intel.relations.csv    a CARMEN laser log, scored by relations
  python -m eval.run_all --data ~/datasets                  every dataset found in a folder, two levels deep
  python -m eval.run_all --log my_log --estimator ekf,batch-cauchy --association known
  python -m eval.run_all --log arena:0 --task slam --estimator ekf,ekf-invariant,isam2,batch
  python -m eval.run_all --log my_log --twins 100           trust without ground truth: p values, and whose fault it is
  python -m eval.run_all --log my_log --gate-known 0.999    leave labelled readings out that fit badly, or keep them
  python -m eval.run_all --log my_log --gate-known none     all, which is the default where no sensor read the labels
  python -m eval.run_all --log my_log --gate-known 0.9999 --no-gate-smoothers    the smoothers keep them
  python -m eval.run_all --log my_log --task slam --association known,nn,jcbb    unknown labels beside known ones
  python -m eval.run_all --log corridor:0 --association jcbb --gate 0.95 --new-gate 0.999
  python -m eval.run_all --log my_log --association ml --gate none   no gate: every reading is paired
  python -m eval.run_all --log my_log --association nn --in-view     the EKF, too, offers only what may be in view
  python -m eval.run_all --log corridor:0:people --association jcbb --maintain    drop landmarks seen only once
  python -m eval.run_all --log victoria-park --estimator ekf --forget-after 60
  python -m eval.run_all --log victoria-park --estimator ekf --deactivate-after 60
  python -m eval.run_all --full                             every method with every estimator; takes minutes
  python -m eval.run_all --runs 100 --seed 1000 --jobs 2    the consistency study: 100 arenas, two processes
  python -m eval.run_all --scenario circle --runs 100       a published study: ours beside the printed numbers
  python -m eval.run_all --scenario my_world.toml --estimator ekf,ekf-fej,batch
  python -m eval.run_all --scenario all --data DIR          every shipped scenario; DIR: the recording of esde-replay
  python -m eval.run_all --scenario trust --jobs 2           is what a log says about itself to be trusted? an hour
  python -m eval.run_all --scenario arena --runs 1000 --scheduler tcp://host:8786    on a Dask cluster
  python -m eval.run_all --log arena:0 --estimator isam2,fixed-lag --lag 20
  python -m eval.run_all --formats csv,tex --out results/paper --no-plots
  python -m eval.run_all --log arena:0 --animate            a film of each estimator beside the figures
  python -m eval.run_all --config my_run.toml -v            the same keys from a file; flags win; a table
                                                            [corridor] (seed, people, range, ...) is a log, too
  python -m eval.run_all --log DIR --config tutorial-step1 --config tutorial-step3   (DIR made by data.convert mrclam)
  python -m eval.run_all -q                                 print nothing but errors

exit status: 0 fine, 1 an estimator that is declared consistent was rejected, 2 wrong usage or bad data"""


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
        else:
            p.add_argument(
                *options, action="append" if row.repeatable else "store", metavar=row.metavar,
                default=argparse.SUPPRESS, help=row.help,
            )  # fmt: skip

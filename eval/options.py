"""Everything a person can ask of `python -m eval.run_all`: flags, config files, and the checks on their combination.

Imports nothing heavy, so that `--help` and a mistyped flag answer at once.
"""

from __future__ import annotations

import argparse
import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from data.errors import UsageError

TASKS = ("localization", "slam")
ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch", "batch-huber", "batch-cauchy")
ASSOCIATIONS = ("known",)
FORMATS = ("csv", "md", "tex")
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")
QUICK_RUNS = 4
CONFIGS = Path(__file__).parent / "configs"


@dataclass(frozen=True)
class Variant:
    """The same recording through other numbers, as one more row: how a published tutorial treats it.

    Attributes:
        name: appended to the log's name.
        task: the one task it is about.
        grid: s, instants to which odometry and readings are brought.
        model: motion model; alphas: displacement noise (see `data.motion.VelocityNoise`).
        sigma: of range [m] and bearing [rad].
        prior_variance: of x, y [m^2] and heading [rad^2].
        each: one update per observation instead of one per frame.
        new_variance: m^2, variance of a new landmark, uncorrelated; None: exact augmentation.
        notes: what is not reproduced of the original, one sentence each.
    """

    name: str
    task: str
    grid: float
    model: str
    alphas: tuple[float, float, float, float]
    sigma: tuple[float, float]
    prior_variance: float
    each: bool = False
    new_variance: float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Options:
    """What was asked for; field names are the config file's keys (with `-` for `_`)."""

    log: tuple[str, ...] = ()
    data: tuple[str, ...] = ()
    task: tuple[str, ...] = ()
    estimator: tuple[str, ...] = DEFAULT_ESTIMATORS
    association: tuple[str, ...] = ("known",)
    gate: float | None = 0.99
    gate_known: float | None = None
    runs: int | None = None
    seed: int = 0
    jobs: int = 1
    quick: bool = False
    out: Path = Path("results/report")
    formats: tuple[str, ...] = FORMATS
    no_plots: bool = False
    animate: bool = False
    quiet: bool = False
    verbose: bool = False
    variants: tuple[Variant, ...] = ()


EPILOG = """\
examples:
  python -m eval.run_all                                    the default report, in results/report
  python -m eval.run_all --quick                            the same, shortened (a check that all works)
  python -m eval.run_all --log my_log --log arena:3         an open log folder and a simulated log
  python -m eval.run_all --log victoria-park --task slam    one log, one task
  python -m eval.run_all --log corridor:0:people+range=8    the corridor lab: people in the way, any constant changed
  python -m eval.run_all --data ~/datasets                  every dataset found in a folder, two levels deep
  python -m eval.run_all --log my_log --estimator ekf,batch-cauchy --association known
  python -m eval.run_all --log my_log --gate-known 0.9999   leave labelled readings out that fit badly
  python -m eval.run_all --log my_log --gate none           no gate for the association methods
  python -m eval.run_all --runs 100 --seed 1000 --jobs 2    the consistency study: 100 arenas, two processes
  python -m eval.run_all --formats csv,tex --out results/paper --no-plots
  python -m eval.run_all --log arena:0 --animate            a film of each estimator beside the figures
  python -m eval.run_all --config my_run.toml -v            the same keys from a file; flags win
  python -m eval.run_all --log DIR --config tutorial-step1 --config tutorial-step3   (DIR made by data.convert mrclam)
  python -m eval.run_all -q                                 print nothing but errors

exit status: 0 fine, 1 an estimator that is declared consistent was rejected, 2 wrong usage or bad data"""


def parser() -> argparse.ArgumentParser:
    """The flags. Defaults are left out here (None), so that a config file can tell what was given."""
    p = argparse.ArgumentParser(
        prog="python -m eval.run_all",
        description="Run filters and smoothers on identical inputs, score them with one referee, and write the report.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = p.add_argument
    add(
        "--log",
        action="append",
        metavar="PATH|NAME",
        help="open log folder, victoria-park, arena:SEED, corridor:SEED, or corridor:SEED:people+no-odometry+KEY=VALUE "
        "(repeatable; default: victoria-park and arena:0)",
    )
    add(
        "--data",
        action="append",
        metavar="DIR",
        help="add every dataset found in DIR: open logs, UTIAS MRCLAM folders or zips",
    )
    add("--task", metavar="LIST", help="localization,slam (default: localization where there is a map, else slam)")
    add("--estimator", metavar="LIST", help=f"of {', '.join(ESTIMATORS)} (default: {','.join(DEFAULT_ESTIMATORS)})")
    add("--association", metavar="LIST", help=f"of {', '.join(ASSOCIATIONS)} (default: known)")
    add(
        "--gate",
        metavar="P",
        help="chi-square probability of the association gate, or none (default: 0.99; known is not gated)",
    )
    add("--gate-known", metavar="P", help="gate for readings paired by label, too (default: none)")
    add(
        "--runs",
        metavar="N",
        help=f"runs of the consistency study (default: 50; {QUICK_RUNS} with --quick; 0: none, the default with --log)",
    )
    add("--seed", metavar="N", help="first seed of the consistency study (default: 0)")
    add("--jobs", metavar="N", help="processes (default: one per core)")
    add("--quick", action="store_true", default=None, help="a short report in seconds; too few runs for verdicts")
    add("--out", metavar="DIR", help="result folder, replaced as a whole when done (default: results/report)")
    add("--formats", metavar="LIST", help="table formats of csv,md,tex (default: all)")
    add("--no-plots", action="store_true", default=None, help="tables only")
    add("--animate", action="store_true", default=None, help="an MP4 per log, task and estimator")
    add(
        "--config",
        action="append",
        metavar="FILE|NAME",
        help="TOML file with the same keys, or a shipped one: " + ", ".join(shipped()),
    )
    add("-q", "--quiet", action="store_true", default=None, help="print only errors")
    add("-v", "--verbose", action="store_true", default=None, help="print more")
    return p


def shipped() -> list[str]:
    """Names of the configurations that come with the package."""
    return sorted(f.stem for f in CONFIGS.glob("*.toml"))


def read_options(argv: Sequence[str] | None = None) -> Options:
    """Options from the command line and its config files; raises UsageError for what makes no sense."""
    given = {k: v for k, v in vars(parser().parse_args(argv)).items() if v is not None}
    merged: dict[str, object] = {}
    variants: list[Variant] = []
    for name in given.pop("config", []):
        keys = _read_config(name)
        if "variant" in keys:
            variants.append(_variant(name, keys.pop("variant")))
        merged.update(keys)
    merged.update(given)
    options = Options(variants=tuple(variants), **{k: _value(k, v) for k, v in merged.items()})  # type: ignore[arg-type]
    if "jobs" not in merged:
        options = replace(options, jobs=os.cpu_count() or 1)
    if variants and not options.task:
        options = replace(options, task=tuple(dict.fromkeys(v.task for v in variants)))
    _check(options)
    return options


def _read_config(name: str) -> dict[str, object]:
    path = Path(name)
    if not path.exists() and (CONFIGS / f"{name}.toml").exists():
        path = CONFIGS / f"{name}.toml"
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError(f"--config {name}: no such file; shipped: {', '.join(shipped())}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as fault:
        raise UsageError(f"--config {name}: {fault}") from None
    keys = {k.replace("-", "_"): v for k, v in content.items()}
    known = {f.name for f in fields(Options)} - {"variants"} | {"variant"}
    unknown = sorted(set(keys) - known)
    if unknown:
        raise UsageError(f"--config {name}: unknown key {unknown[0]!r}; known: {', '.join(sorted(known))}")
    return keys


def _variant(name: str, table: object) -> Variant:
    known = {f.name for f in fields(Variant)}
    if not isinstance(table, dict) or set(table) - known:
        raise UsageError(f"--config {name}: [variant] takes the keys {', '.join(sorted(known))}")
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in table.items()}
    try:
        return Variant(**values)
    except TypeError as fault:
        raise UsageError(f"--config {name}: [variant] {fault}") from None


def _value(key: str, value: object) -> object:
    """A flag's text or a config file's value in the type the option has."""
    flag = "--" + key.replace("_", "-")
    if key in ("log", "data", "task", "estimator", "association", "formats"):
        if isinstance(value, str):
            value = [value]
        if not isinstance(value, (list, tuple)) or not all(isinstance(v, str) for v in value):
            raise UsageError(f"{flag} {value!r}: a list of names is needed")
        separate = key not in ("log", "data")
        return tuple(part.strip() for v in value for part in (v.split(",") if separate else [v]) if part.strip())
    if key in ("gate", "gate_known"):
        if value == "none":
            return None
        return _number(flag, value, float)
    if key in ("runs", "seed", "jobs"):
        return _number(flag, value, int)
    if key == "out":
        return Path(str(value))
    if not isinstance(value, bool):
        raise UsageError(f"{flag} = {value!r}: true or false is needed")
    return value


def _number(flag: str, value: object, kind: type[int] | type[float]) -> int | float:
    try:
        if isinstance(value, bool) or (kind is int and isinstance(value, float)):
            raise ValueError
        return kind(str(value))
    except (ValueError, TypeError):
        what = "whole number" if kind is int else "number"
        raise UsageError(f"{flag} {value}: a {what} is needed") from None


def _check(o: Options) -> None:
    for flag, given, known in (
        ("--task", o.task, TASKS),
        ("--estimator", o.estimator, ESTIMATORS),
        ("--association", o.association, ASSOCIATIONS),
        ("--formats", o.formats, FORMATS),
    ):
        for name in given:
            if name not in known:
                raise UsageError(f"{flag} {name}: unknown; known: {', '.join(known)}")
        if len(set(given)) != len(given):
            raise UsageError(f"{flag} {','.join(given)}: named twice")
    for flag, p in (("--gate", o.gate), ("--gate-known", o.gate_known)):
        if p is not None and not 0.0 < p < 1.0:
            raise UsageError(f"{flag} {p:g}: a probability between 0 and 1 (both excluded), or none")
    if not o.estimator:
        raise UsageError("--estimator: at least one is needed")
    if not o.association:
        raise UsageError("--association: at least one is needed")
    if o.runs is not None and o.runs < 0:
        raise UsageError(f"--runs {o.runs}: must not be negative")
    if o.seed < 0:
        raise UsageError(f"--seed {o.seed}: must not be negative")
    if o.jobs < 1:
        raise UsageError(f"--jobs {o.jobs}: at least one process is needed")
    if o.quiet and o.verbose:
        raise UsageError("-q and -v exclude each other")
    if o.animate and o.no_plots:
        raise UsageError("--animate makes pictures and --no-plots forbids them")
    if o.out.exists() and not o.out.is_dir():
        raise UsageError(f"--out {o.out}: exists and is not a folder")

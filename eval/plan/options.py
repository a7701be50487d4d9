"""What a person asked of `python -m eval.run_all`: flags and config files as one checked `Options`.

Imports nothing heavy, so that `--help` and a mistyped flag answer at once.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from data.errors import UsageError
from eval.plan.flags import CHOICES, CONFIGS, DEFAULT_ESTIMATORS, FORMATS, parser, shipped
from eval.plan.variant import Variant
from eval.replay.names import ASSOCIATIONS, ESTIMATORS, TASKS
from eval.replay.settings import Setup


@dataclass(frozen=True)
class Options(Setup):
    """What was asked for, the setup included; field names are the config file's keys (with `-` for `_`)."""

    log: tuple[str, ...] = ()
    data: tuple[str, ...] = ()
    scenario: tuple[str, ...] = ()
    task: tuple[str, ...] = ()
    estimator: tuple[str, ...] = DEFAULT_ESTIMATORS
    association: tuple[str, ...] = ()
    runs: int | None = None
    seed: int = 0
    jobs: int = 1
    scheduler: str | None = None
    camera_translation: str = "cm"
    camera_reading: str = "to-camera"
    corner_noise: str = "lab"
    trust_pickle: bool = False
    quick: bool = False
    full: bool = False
    out: Path = Path("results/report")
    formats: tuple[str, ...] = FORMATS
    no_plots: bool = False
    animate: bool = False
    quiet: bool = False
    verbose: bool = False
    variants: tuple[Variant, ...] = ()

    @property
    def setup(self) -> Setup:
        """How observations are paired and how much of the map is kept."""
        return Setup(**{f.name: getattr(self, f.name) for f in fields(Setup)})


def read_options(argv: Sequence[str] | None = None) -> Options:
    """Options from the command line and its config files; raises UsageError for what makes no sense."""
    given = {k: v for k, v in vars(parser().parse_args(argv)).items() if v is not None}
    merged: dict[str, object] = {}
    variants: list[Variant] = []
    for name in given.pop("config", []):
        keys = _read_config(name)
        if "corridor" in keys:
            keys["log"] = [*_names(keys.get("log")), _corridor(name, keys.pop("corridor"))]
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
    known = {f.name for f in fields(Options)} - {"variants"} | {"variant", "corridor"}
    unknown = sorted(set(keys) - known)
    if unknown:
        raise UsageError(f"--config {name}: unknown key {unknown[0]!r}; known: {', '.join(sorted(known))}")
    return keys


def _names(value: object) -> list[object]:
    return list(value) if isinstance(value, list) else [] if value is None else [value]


def _corridor(name: str, table: object) -> str:
    """The log's name that a table of constants stands for: `seed`, and keys and values as in the name."""
    if not isinstance(table, dict):
        raise UsageError(f"--config {name}: [corridor] is a table, with seed, people, odometry, range, ...")
    constants = {k: {True: "on", False: "off"}[v] if isinstance(v, bool) else v for k, v in table.items()}
    seed = constants.pop("seed", 0)
    parts = "+".join(f"{k}={v}" for k, v in constants.items())
    return f"corridor:{seed}" + (f":{parts}" if parts else "")


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
    if key in ("log", "data", "scenario", "task", "estimator", "association", "formats"):
        if isinstance(value, str):
            value = [value]
        if not isinstance(value, (list, tuple)) or not all(isinstance(v, str) for v in value):
            raise UsageError(f"{flag} {value!r}: a list of names is needed")
        separate = key not in ("log", "data", "scenario")
        return tuple(part.strip() for v in value for part in (v.split(",") if separate else [v]) if part.strip())
    if key in ("gate", "new_gate", "gate_known"):
        if value == "none":
            return None
        return _number(flag, value, float)
    if key in ("forget_after", "deactivate_after", "lag"):
        return _number(flag, value, float)
    if key in ("runs", "seed", "jobs"):
        return _number(flag, value, int)
    if key in CHOICES:
        if value not in CHOICES[key]:
            raise UsageError(f"{flag} {value!r}: unknown; known: {', '.join(CHOICES[key])}")
        return value
    if key == "scheduler":
        if not isinstance(value, str) or not value:
            raise UsageError(f"{flag} {value!r}: an address is needed, as in tcp://host:8786")
        return value
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
    for flag, p in (("--gate", o.gate), ("--new-gate", o.new_gate), ("--gate-known", o.gate_known)):
        if p is not None and not 0.0 < p < 1.0:
            raise UsageError(f"{flag} {p:g}: a probability between 0 and 1 (both excluded), or none")
    if not o.estimator:
        raise UsageError("--estimator: at least one is needed")
    for flag, span in (
        ("--forget-after", o.forget_after),
        ("--deactivate-after", o.deactivate_after),
        ("--lag", o.lag),
    ):
        if span is not None and not 0.0 < span < math.inf:
            raise UsageError(f"{flag} {span:g}: a positive number is needed")
    if o.forget_after is not None and o.deactivate_after is not None and o.deactivate_after >= o.forget_after:
        raise UsageError(
            f"--deactivate-after {o.deactivate_after:g}: must be less than --forget-after {o.forget_after:g}, "
            "or nothing is ever parked"
        )
    if o.deactivate_after is not None and "ekf-invariant" in o.estimator:
        raise UsageError(
            "--deactivate-after: ekf-invariant moves all landmarks together, parked ones would stay behind"
        )
    if o.deactivate_after is not None and "ekf-fej" in o.estimator:
        raise UsageError("--deactivate-after: ekf-fej keeps first estimates, a parked landmark would lose its own")
    if o.quick and o.full:
        raise UsageError("--quick and --full exclude each other")
    if o.full and (o.log or o.scenario):
        raise UsageError("--full is the default suite in full; it takes no --log and no --scenario")
    if o.scenario:
        for flag, stated in (
            ("--log", o.log), ("--task", o.task), ("--association", o.association), ("--config", o.variants),
        ):  # fmt: skip
            if stated:
                raise UsageError(f"{flag} and --scenario exclude each other: a scenario states its own")
        for f in fields(Setup):
            if getattr(o, f.name) != f.default:
                raise UsageError(f"--{f.name.replace('_', '-')} and --scenario exclude each other: [setup] in its file")
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

"""Referee for 2-D SLAM: errors, consistency and data association of filters and smoothers on identical logs.

Six steps, from a log to a table and its warnings:

    import slamref

    log = slamref.open_log("arena:0")                                        # or the path of a log folder
    runs = slamref.compare(log.inputs(labels=True), "slam", ("ekf", "isam2", "batch"))
    trial = slamref.Trial(log, "slam", tuple(runs))
    print(slamref.score([trial]).metrics)                                    # RMSE, NEES, NIS, ...
    print([slamref.sentence(n) for n in slamref.notices([trial])])           # warnings
    print(slamref.judge(trial).verdict)                                      # whose path to use

Logs: `open_log`, `Log` (`Log.from_arrays`).
Runs: `compare` with `Setup`; `make_estimator` (one estimator, step by step).
Data association: `Expectation` (candidates and covariances), `decide`, and the decisions `NEW` and `DISCARD`.
Results: `Trial`, `score`, `judge` (a `Judgement`), `notices`, `Notice`, `sentence`; `score_files` for files of other
programs.
Your own estimators and association methods: `Samples`, and `check_estimator`, `check_association` (for tests),
`estimator_findings`, `association_findings` (as lists).
Many logs: `study` (a `Study` with verdicts). A log without ground truth: `twins` (a `Diagnosis`).
Factor graphs: `audit` (any gtsam graph with values).

Units are m, rad and s. A pose is (x, y, theta) in the world frame; its covariance (3, 3) has the same coordinates.
Names are loaded on first use. This module is also the command `slamref`; `slamref --help` lists its subcommands.
"""

import sys
import tomllib
import warnings
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

MODULES = {
    "association.decide": "decide", "association.expectation": "Expectation", "data.log": "Log",
    "data.logs": "open_log", "data.notice": "Notice", "data.result": "NEW DISCARD", "data.words": "sentence",
    "eval.checks.checking": "check_estimator check_association estimator_findings association_findings",
    "eval.compare": "compare", "eval.judgement.judgement": "judge Judgement", "eval.referee.diagnostics": "notices",
    "eval.referee.score": "Trial score", "eval.replay.estimators": "make_estimator",
    "eval.replay.external.adapter": "Samples", "eval.replay.settings": "Setup",
    "eval.report.calls": "study Study twins score_files Diagnosis",
}  # fmt: skip
"""Where the names are; type checkers read `eval/slamref.pyi`."""
HOMES = {name: module for module, names in MODULES.items() for name in names.split()}
OF_WINGS = ("audit",)
__all__ = sorted([*HOMES, *OF_WINGS, "__version__"])
TEXTS = Path(__file__).parent / "eval/plan/flags/texts"
PACKAGES = ("association", "data", "ekf", "eval", "graph", "wings")


def commands() -> dict[str, tuple[str, str]]:
    """The subcommands, those of wings last."""
    from data.wing import wings

    found: dict[str, tuple[str, str]] = tomllib.loads((TEXTS / "commands.toml").read_text(encoding="utf-8"))
    return found | {name: command for wing in wings() for name, command in wing.commands.items()}


def _hidden() -> dict[str, Path]:
    """Files that hide packages of ours, for example a `data.py` beside the user's script."""
    here, found = Path(__file__).resolve().parent, {}
    for package in PACKAGES:
        spec = find_spec(package)
        places = [*(spec.submodule_search_locations or ()), spec.origin] if spec is not None else []
        place = next((Path(place) for place in places if place), None)
        if place is not None and place.resolve() not in (here / package, here / package / "__init__.py"):
            found[package] = place
    return found


@cache
def _first() -> None:
    """Put our packages before files that hide them, with a warning; ImportError where one of these is in use before."""
    hidden = _hidden()
    if hidden:
        sys.path.insert(0, str(Path(__file__).parent))
        for package, place in _hidden().items():
            raise ImportError(f"{place} hides the package {package!r} of slamref; rename it, or import slamref first")
        for package in PACKAGES:  # the user's file is another module, which nothing of ours may get
            import_module(package)
        places = ", ".join(map(str, hidden.values()))
        warnings.warn(f"packages of slamref have the names of {places}, which this program cannot import", stacklevel=3)


def _of_wings() -> dict[str, str]:
    """Names of the Python API that wings have, and their modules."""
    from data.wing import wings

    return {name: module for wing in wings() for name, module in wing.api.items()}


def __getattr__(name: str) -> Any:
    """A public name, loaded on first use. ImportError, in a line, where a file in use hides a package of ours."""
    if name == "__version__":
        from importlib.metadata import version

        return version("slamref")
    if name in __all__:
        _first()
        return getattr(import_module(HOMES[name] if name in HOMES else _of_wings()[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


def main(argv: Sequence[str] | None = None) -> int:
    """The command `slamref`: call a subcommand and return its exit status; 2 for an unknown one."""
    # other packages `data` or `eval`, in the working directory or on PYTHONPATH, must not hide ours
    sys.path.insert(0, str(Path(__file__).parent))
    from data.terminal import ended

    words = list(sys.argv[1:] if argv is None else argv)
    return ended(lambda: _command(words))


def _command(words: list[str]) -> int:
    from data.command import completed
    from data.terminal import meant

    known = commands()
    name, *rest = completed(words, known) or [""]
    if name in known:
        module, _, function = known[name][0].partition(":")
        status: int = getattr(import_module(module), function)(rest, f"slamref {name}")
        return status
    if name in ("", "-h", "--help", "--version"):
        lines = "".join(f"  {command:<15}{about}\n" for command, (_, about) in known.items())
        usage = f"usage: slamref COMMAND ...\n\n{lines}\nslamref COMMAND --help shows its flags, with examples.\n"
        version = f"slamref {__getattr__('__version__')}\n" if name == "--version" else ""
        sys.stdout.write(version or (usage if name else (TEXTS / "first.txt").read_text(encoding="utf-8")))
        return 0
    hint = meant(name, known) or f"; type one of {', '.join(known)}"
    sys.stderr.write(f"slamref: {name}: no such command{hint}\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())

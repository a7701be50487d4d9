"""slamref from Python, loaded when asked for, and the command `slamref`, which calls the commands of `eval` and `data`.

import slamref

log = slamref.open_log("arena:0")
runs = slamref.compare(log.inputs(labels=True), "slam", ("ekf", "isam2", "batch"))
print(slamref.score([slamref.Trial(log, "slam", tuple(runs))]).metrics)
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from association.decide import decide
    from association.expectation import Expectation
    from data.logs import open_log
    from data.notice import Notice
    from data.result import DISCARD, NEW
    from data.words import sentence
    from eval.checks.checking import association_findings, check_association, check_estimator, estimator_findings
    from eval.compare import compare
    from eval.referee.diagnostics import notices
    from eval.referee.score import Trial, score
    from eval.replay.estimators import make_estimator
    from eval.replay.external.adapter import Samples

    __version__: str

__all__ = [
    "DISCARD",
    "NEW",
    "Expectation",
    "Notice",
    "Samples",
    "Trial",
    "__version__",
    "association_findings",
    "check_association",
    "check_estimator",
    "compare",
    "decide",
    "estimator_findings",
    "make_estimator",
    "notices",
    "open_log",
    "score",
    "sentence",
]

HOMES = {
    "open_log": "data.logs",
    "compare": "eval.compare",
    "make_estimator": "eval.replay.estimators",
    "decide": "association.decide",
    "Trial": "eval.referee.score",
    "score": "eval.referee.score",
    "notices": "eval.referee.diagnostics",
    "Notice": "data.notice",
    "sentence": "data.words",
    "check_estimator": "eval.checks.checking",
    "check_association": "eval.checks.checking",
    "estimator_findings": "eval.checks.checking",
    "association_findings": "eval.checks.checking",
    "Expectation": "association.expectation",
    "Samples": "eval.replay.external.adapter",
    "NEW": "data.result",
    "DISCARD": "data.result",
}
COMMANDS = {
    "run": ("eval.run_all", "run filters and smoothers on identical inputs, referee them, write the report"),
    "step": ("eval.step", "walk through a log one Enter at a time"),
    "live": (
        "eval.live.__main__",
        "run filters and smoothers on line while a small robot drives, recorded, with a page",
    ),
    "play": ("eval.play", "write a page that plays a log in the browser"),
    "twin": ("eval.twin", "draw a log again as it says of itself, with a truth"),
    "convert": ("data.convert.__main__", "turn a recording or a simulation into an open log folder"),
    "inspect": ("eval.inspect", "print what a log holds and what is odd about it"),
    "score": ("eval.score", "score a trajectory that another program made against a truth"),
    "check": ("eval.check", "check your own estimator or way of association, a sentence for each check"),
    "detect": ("eval.detect", "find reference pictures in a photo of your own"),
    "tune": ("eval.tune", "fit noise, biases and odometry scales to a labelled log"),
    "benchmark": ("eval.benchmark", "time the estimators beside their peers"),
    "warm": ("eval.warm", "compile every kernel once, into the cache"),
}
"""Module of each subcommand and what it does."""


def __getattr__(name: str) -> Any:
    """A public name, loaded now."""
    if name == "__version__":
        from importlib.metadata import version

        return version("slamref")
    if name in HOMES:
        return getattr(import_module(HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)


def main(argv: Sequence[str] | None = None) -> int:
    """The command `slamref`: hands on to a subcommand and returns its exit status; 2 if there is no such one."""
    # a package `data` or `eval` of somebody else, in the working directory or on PYTHONPATH, must not hide ours
    sys.path.insert(0, str(Path(__file__).parent))
    from data.terminal import ended

    return ended(lambda: _command(list(sys.argv[1:] if argv is None else argv) or ["--help"]))


def _command(words: list[str]) -> int:
    name, *rest = words
    if name in COMMANDS:
        status: int = import_module(COMMANDS[name][0]).main(rest, f"slamref {name}")
        return status
    if name in ("-h", "--help"):
        lines = [f"  {command:<11}{about}" for command, (_, about) in COMMANDS.items()]
        usage = ["usage: slamref COMMAND ...", "", *lines, "", "slamref COMMAND --help shows its flags, with examples."]
        sys.stdout.write("\n".join([*usage, ""]))
        return 0
    if name == "--version":
        sys.stdout.write(f"slamref {__getattr__('__version__')}\n")
        return 0
    sys.stderr.write(f"slamref: no command {name!r}; there are {', '.join(COMMANDS)} (see --help)\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())

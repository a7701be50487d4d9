"""Provenance of a result: command, versions, a digest of all inputs; settings that a lab left there are read again."""

from __future__ import annotations

import hashlib
import json
import platform
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from data.command import portable
from data.errors import UsageError
from data.log import Log
from eval.plan.experiment import sources_of
from eval.plan.first_use import kernels
from eval.plan.flags.table import Options
from eval.replay.external.spec import shown
from eval.replay.flag import rows

PACKAGES = ("gtsam", "numpy", "scipy", "numba", "pandas", "matplotlib", "opencv-python-headless")
REPORT = Path("results/report")  # where a lab's report is, unless `--report` names another folder


def command_of(options: Options) -> str:
    """The command that reproduces the numbers; output folder and number of processes do not affect them."""
    return shlex.join(portable(word) for word in words_of(options))


def words_of(options: Options) -> list[str]:
    """The words of that command, with its paths; flags from a config file are spelled out."""
    selection = options.selection
    command, positional = ("lab", "lab") if selection.lab is not None else ("study", "scenario")
    if selection.lab is None and not selection.scenario:
        command, positional = "run", "log"
    named, words = list[str](), list[str]()
    for row in rows(Options).values():
        value = row.of(options)
        in_lab = row.name == "new_gate" and selection.lab is not None
        default = options.setup.gate if in_lab else row.default  # a lab has one gate unless two are stated
        if row.numbers and value != default:
            if row.name in ("estimator", "association"):
                value = tuple(shown(text) for text in value)
            found = row.words(value)
            if row.name == positional:
                named = found if any(w.startswith("-") for w in found if w != row.option) else found[1::2]
            else:
                words += found
    return ["slamref", command, *named, *words]


def versions() -> dict[str, str]:
    """Versions of slamref, Python and the numerical libraries."""
    return {"python": platform.python_version(), **{p: version(p) for p in ("slamref", *PACKAGES)}}


def provenance(
    options: Options, logs: Iterable[Log], command: Sequence[str], foreign: Iterable[str] = (),
    results: Mapping[str, Mapping[str, str]] = {}, lab: Mapping[str, object] = {},
) -> str:  # fmt: skip
    """The text of provenance.json. `foreign`: names of estimators and association methods, foreign or built in;
    `results`: sha256 of each result by file; `lab`: a lab's settings by log.
    """
    content: dict[str, object] = {
        "command": [portable(word) for word in command], "kernels": kernels(), "versions": versions(),
        "platform": f"{sys.platform} {platform.machine()}", "seed": options.study.seed, "foreign": sources_of(foreign),
        "inputs": {log.name: {**_plain(log), "sha256": input_digest(log)} for log in logs},
    }  # fmt: skip
    if lab:
        content["lab"] = lab
    if results:
        content["results"] = {n: {portable(file): sha256 for file, sha256 in of.items()} for n, of in results.items()}
    return json.dumps(content, indent=2, sort_keys=True) + "\n"


def settings_of_lab(log: Callable[[], Log], report: Path | None) -> dict[str, object]:
    """The settings of the lab whose report is in a folder, if it ran on this very log (`log` opens it then); else none.
    UsageError: a folder was named (`report`), and holds no lab with this log.
    """
    try:
        kept = json.loads(((report or REPORT) / "provenance.json").read_text(encoding="utf-8"))
        lab, inputs = kept.get("lab", {}), kept.get("inputs", {})
    except (OSError, ValueError, AttributeError):
        lab, inputs = {}, {}  # no report, or not one of ours
    if lab:
        opened = log()
        if opened.name in lab and inputs[opened.name]["sha256"] == input_digest(opened):
            return dict(lab[opened.name])
    if report is not None:
        raise UsageError(f"--report {report}: no lab ran on this log there; `slamref lab NAME --out {report}` runs one")
    return {}


def settings_line(own: Options, taken: Options, report: Path | None) -> str:
    """The settings that differ from the command's `own` in flags; blank if none does."""
    words = [w for row in rows(Options).values() if row.of(taken) != row.of(own) for w in row.words(row.of(taken))]
    return f"settings of the lab in {report or REPORT}: {' '.join(words)}" if words else ""


def _plain(log: Log) -> dict[str, object]:
    return {
        str(k): portable(v) if isinstance(v, str) else v if isinstance(v, (int, float, list)) or v is None else str(v)
        for k, v in log.source.items()
    }


def input_digest(log: Log) -> str:
    """sha256 of all inputs of estimators and referee, for any file format."""
    digest = hashlib.sha256()
    t = log.truth
    truth = (t.pose, t.landmarks, t.landmark_of, t.relations, t.fix_inlier, t.closure_inlier)
    _feed(digest, (replace(log.recorded, systematic=None), *truth, log.label))
    return digest.hexdigest()


def _feed(digest: hashlib._Hash, value: object) -> None:
    """Add a value to the digest, with all values that it holds."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        digest.update(f"{value.dtype} {value.shape}".encode() + value.tobytes())
    elif is_dataclass(value):
        for f in fields(value):
            digest.update(f.name.encode())
            _feed(digest, getattr(value, f.name))
    elif isinstance(value, (tuple, list)):
        for each in value:
            _feed(digest, each)
    else:
        digest.update(repr(value).encode())

"""A submission runs in a child process, with limits of time and memory. This is no security boundary."""

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from data.digest import ROOT
from data.errors import DataError, SlamrefError, UsageError
from data.toml_table import TomlTable, load_toml, not_negative, positive
from eval.replay.external.adapter import in_one_line, load
from eval.replay.external.spec import settled
from eval.replay.run import one_thread
from wings.grade import HERE
from wings.grade.parts import First, Outcome, Part, Seeds

MODULES = {name: f"wings.grade.{name}" for name in ("corridor", "visual", "utias")} | {"filter": "wings.grade.filters"}
NUMBERS = ("with_fault", "seconds", "memory_mb", "similar")
REQUEST, ANSWERS, FILES = "request.json", "answers.jsonl", 1e8  # bytes, largest file that a submission may write
STARTING, POLL = 900.0, 0.02  # s: for our own questions and the first compilation; from look to look
NO, THREADS = subprocess.DEVNULL, ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Scheme:
    """A weights file: share of points where something is wrong, limits, and points by part of an assignment."""

    seeds: tuple[int, ...]
    with_fault: float
    seconds: float
    memory_mb: float
    similar: float
    weights: Mapping[str, float]

    def points(self, outcome: Outcome) -> float:
        """Points of a part: in proportion to right answers, less where any is wrong; rounded down to a tenth."""
        share = outcome.right / max(outcome.of, 1) * (1.0 if outcome.flawless else self.with_fault)
        return math.floor(10.0 * self.weights[outcome.part] * share + 1e-9) / 10.0


def read_scheme(path: Path | None, assignment: str) -> Scheme:
    """The scheme of a file, complete for an assignment; UsageError otherwise. None: the shipped one."""

    def fault(what: str) -> UsageError:
        return UsageError(f"--weights {path}: {what}")

    keys = {"": ("seeds", *NUMBERS, *MODULES)}
    parts = TomlTable(fault, load_toml(HERE / "weights.toml", fault), keys).table_of(assignment).table
    table = TomlTable(fault, load_toml(path or HERE / "weights.toml", fault), keys)
    seeds = table.numbers("seeds", None, "whole numbers from 0 up are", lambda n: n >= 0 and n == int(n))
    limits = {name: table.number(name, None, "a positive number", positive) for name in NUMBERS}
    own = table.table_of(assignment, tuple(parts))
    weights = {part: own.number(part, 0.0, "a number from 0 up", not_negative) for part in parts}
    return Scheme(tuple(int(s) for s in seeds), **limits, weights=weights)


def outcomes(file: Path, assignment: str, scheme: Scheme, data: Path | None = None) -> list[Outcome]:
    """What became of each part of a submission that has points. Raises DataError for bad `data`."""
    found: dict[str, Outcome] = {}
    wanted = [part for part, points in scheme.weights.items() if points > 0.0]
    while left := [part for part in wanted if part not in found]:
        with tempfile.TemporaryDirectory() as place:
            what = [assignment, left, str(file.absolute()), scheme.seeds, data and str(data.absolute())]
            (Path(place) / REQUEST).write_text(json.dumps([*what, scheme.seconds, scheme.memory_mb]), encoding="utf-8")
            lines, why = _watched(Path(place), scheme.seconds)
        for line in lines:
            if "fault" in line:
                raise DataError(line["fault"])
            if "part" in line:
                found[line["part"]] = Outcome(**line | {"first": line["first"] and First(*line["first"])})
        for part in [part for part in left if part not in found][:1] if why else ():
            found[part] = Outcome(part, stopped=why)
    return [found[part] for part in wanted]


def _watched(place: Path, seconds: float) -> tuple[list[dict[str, Any]], str]:
    """Lines that a child wrote, and why it did not end by itself; it and its children are gone afterwards."""
    command, environment = [sys.executable, "-m", __spec__.name, str(place)], os.environ | dict.fromkeys(THREADS, "1")
    child = subprocess.Popen(command, cwd=ROOT, env=environment, start_new_session=True, stdin=NO, stdout=NO, stderr=NO)
    lines, since, limit = list[dict[str, Any]](), time.monotonic(), STARTING
    try:
        while child.poll() is None and time.monotonic() - since < limit:
            time.sleep(POLL)
            if len(now := _lines(place / ANSWERS)) != len(lines):
                lines, since, limit = now, time.monotonic(), seconds
        status = child.poll()
    finally:
        with suppress(OSError, AttributeError):  # no process is left; Windows has no groups
            os.killpg(child.pid, signal.SIGKILL)
        child.kill()
        child.wait()
    lines = _lines(place / ANSWERS)
    why = f"no answer within {seconds:g} s" if status is None else f"the process ended with status {status}"
    return lines, "" if lines and {"end", "fault"} & set(lines[-1]) else why


def _lines(answers: Path) -> list[dict[str, Any]]:
    """Whole lines of a file that is being written."""
    text = answers.read_text(encoding="utf-8") if answers.exists() else ""
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def limit(seconds: float, memory_mb: float) -> None:
    """Limit this process from now on, where the system can: memory, processor time, size of files."""
    if sys.platform == "win32":  # the parent's clock remains
        return
    import resource

    sizes = Path("/proc/self/statm")
    used = int(sizes.read_text().split()[0]) * resource.getpagesize() if sizes.exists() else 0
    spent = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    for kind, most in {"AS": used + memory_mb * 1e6, "CPU": spent + seconds + 1.0, "FSIZE": FILES, "CORE": 0}.items():
        with suppress(ValueError, OSError):  # a lower limit holds already
            resource.setrlimit(getattr(resource, f"RLIMIT_{kind}"), (int(most), int(most)))


def main(place: Path) -> None:
    """The child: questions are prepared first, the submission is loaded under the limits."""
    assignment, names, file, seeds, data, seconds, memory_mb = json.loads((place / REQUEST).read_text(encoding="utf-8"))
    with (place / ANSWERS).open("w", encoding="utf-8", buffering=1) as out, one_thread():
        parts = [p for p in import_module(MODULES[assignment]).PARTS if p.name in names]
        try:
            prepared = [p.prepare(Seeds(tuple(seeds), data and Path(data))) for p in parts]
        except SlamrefError as fault:
            out.write(json.dumps({"fault": str(fault)}) + "\n")
            return
        os.chdir(place)
        warnings.simplefilter("ignore")
        limit(seconds * len(parts), memory_mb)
        out.write("{}\n")  # from now on the parent's clock counts
        for part, questions in zip(parts, prepared, strict=True):
            out.write(json.dumps(asdict(graded(Path(file), part, questions))) + "\n")
        out.write(json.dumps({"end": True}) + "\n")


def graded(file: Path, part: Part, questions: Any) -> Outcome:
    """The outcome of a part of a submission's file, in this process."""
    try:
        text = f"{file.stem}.{part.name}={file}:{part.attribute}"
        return part.grade(load(settled("grade", text, "estimator")), questions)
    except UsageError as fault:
        return Outcome(part.name, stopped=str(fault).rpartition(f"{part.attribute}: ")[2])
    except Exception as fault:  # noqa: BLE001 - whatever the student's code raised through our checks
        return Outcome(part.name, stopped=in_one_line(fault))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

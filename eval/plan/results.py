"""Results of other programs (`--result`, `--truth`): read before any work, and scored with the runs of their log."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import cast

import numpy as np

from data.columns.header import HEADER
from data.csv_table import is_number
from data.dates import ISO
from data.earth import east_north_up
from data.errors import DataError, UsageError, did_you_mean
from data.formats.open_log import load_folder
from data.formats.recordings.ros import file_and_topic, is_bag
from data.formats.results import path as paths
from data.formats.results.path import ROWS, STATED, Clock, GivenPath, Manner, restamped
from data.formats.results.reading import read_path
from data.formats.results.tables import Companions, companions
from data.formats.tables.files import ANGLE, DIMENSIONS, TIME, factor, pairs
from data.inputs import IntArray
from data.log import Log
from data.notice import Code, Notice, notice
from data.se2 import Array
from eval.plan.flags.table import Matching, Results
from eval.referee.given.in_space import NONE
from eval.referee.given.pairing import Pair, about_file, about_pair, called, same_clock, same_frames, time_offset
from eval.referee.given.runs import GivenRun, MapAndDecisions, TruePath, given_run, truth_log, with_truth
from eval.referee.score import Trial
from eval.replay.flag import rows
from eval.replay.settings import ESTIMATORS

OFFSET, AUTO = "--time-offset", "auto"
TRUTH = "truth"  # its name, as in `--times truth=FILE`
PHASES = ("online", "final")
PLAIN = Matching()
NAME = re.compile(r"[\w][\w.+-]*")


@dataclass(frozen=True, eq=False)
class Result:
    """A result: its paths by phase, its map and decisions, if any, and what is added to its stamps [s], or `AUTO`."""

    name: str
    paths: dict[str, GivenPath]
    companions: Companions
    offset: float | str | None = None


def named_results(asked: Sequence[str]) -> dict[str, str]:
    """The files of `NAME=FILE` by name; UsageError for an invalid one."""
    named: dict[str, str] = {}
    for text in asked:
        name, equals, file = text.partition("=")
        if not equals or not file:
            raise UsageError(f"--result {text}: NAME=FILE is needed, as in mine=est.tum")
        if not NAME.fullmatch(name) or name == TRUTH:
            raise UsageError(f"--result {text}: {name!r} is no name; use letters, digits and . _ + -, not {TRUTH}")
        if name in ESTIMATORS:
            raise UsageError(f"--result {text}: {name} is one of our estimators; give it another name")
        if name in named:
            raise UsageError(f"--result {text}: two results are named {name}; rename one")
        named[name] = file
    return named


def _result(name: str, file: str, manner: Manner) -> Result:
    """A result from a file, or from the folder of a run with both phases."""
    path = Path(file)
    if path.is_dir() and not is_bag(path):
        there = {phase: path / f"{phase}.csv" for phase in PHASES if (path / f"{phase}.csv").is_file()}
        if not there:
            raise DataError.at(path, "a folder without online.csv and final.csv; name a file, or the folder of a run")
        return Result(name, {p: read_path(str(f), manner) for p, f in there.items()}, companions(path))
    return Result(name, {phase_of(path): read_path(file, manner)}, companions(path.parent))


def phase_of(path: Path) -> str:
    """Online for the file name `online`, else final."""
    return "online" if path.stem == "online" else "final"


def manner_of(name: str, names: Sequence[str], reading: Matching) -> Manner:
    """How a result or the truth is read; a value with `NAME=` overrides one for all."""
    units = _of_file("--unit", _units(names, reading), name, names, (*UNITS, *"xyz"))
    stamps, angles = units.get("time"), units.get("angle")
    lengths = {axis: text for axis in "xyz" if (text := units.get(axis, units.get("length")))}
    of = _of_file("--columns", pairs(list(getattr(reading, "columns", ())), "columns"), name, names, KEYS)
    columns = {role.replace("theta", "yaw"): column for role, column in of.items()}
    fixed = {role: float(c) for role, c in columns.items() if is_number(c) and not (c.isdecimal() and int(c))}

    def path(flag: str, values: Sequence[str], *, alone: bool = False) -> Path | None:
        value = _of(flag, values, name, names, alone=alone)
        return None if value is None else Path(value)

    inverse, axes = paths.READ_AS[_of("--axes", reading.axes, name, names, [*paths.READ_AS][1:]) or ""]
    return Manner(
        path("--cov", reading.cov, alone=True), path("--times", reading.times),
        _of("--cov-frame", reading.cov_frame, name, names, paths.FRAMES), axes or None, inverse,
        _of("--cov-order", reading.cov_order, name, names, paths.COV_ORDERS),
        factor("time", stamps, f"--unit {stamps}") if stamps and stamps not in (*paths.DIGITS, ISO) else stamps,
        None if angles is None else factor("angle", angles, f"--unit {angles}"),
        {axis: factor("length", text, f"--unit {axis}={text}") for axis, text in lengths.items()},
        {role: column for role, column in columns.items() if role not in fixed}, fixed, name == TRUTH,
        compass=angles == "compass",
    )  # fmt: skip


def _units(names: Sequence[str], reading: Matching) -> dict[str, str]:
    """The stated units by what they are of: time, angle, length, or one axis, with the name of a file before it."""
    found: dict[str, str] = {}
    for text in filter(None, ",".join(reading.unit).split(",")):
        key, _, unit = text.rpartition("=")
        bare = _known("--unit", re.sub(r"^-?[\d.]*(e-?\d+)?", "", unit), [*chain(*UNITS.values())])  # -0.01mm
        kind = next(kind for kind, units in UNITS.items() if bare in units)
        who, _, what = key.rpartition(".")
        who, what = (who, what) if what in (*KEYS, *UNITS) and key not in names else (key, kind)
        of = f"{who}.{what if what in tuple('xyz') else kind}"
        if found.setdefault(of, unit) != unit:
            raise UsageError(f"--unit {text}: given twice for one result; write NAME=... for each")
    return found


def _of_file(flag: str, stated: dict[str, str], name: str, names: Sequence[str], keys: Sequence[str]) -> dict[str, str]:
    """Values of a flag for a file, by what they are of: those of its name, else those of all."""
    found: dict[str, dict[str, str]] = {"": {}, name: {}}
    for key, value in stated.items():
        who, _, of = key.rpartition(".")
        _known(flag, of, keys)
        _known(flag, who, ("", *names, TRUTH))
        found.get(who, {})[of] = value
    return found[""] | found[name]


KEYS = ("t", "x", "y", "z", "lat", "lon", "alt", "theta", "roll", "pitch", "qx", "qy", "qz", "qw")


def offset_of(name: str, names: Sequence[str], reading: Matching) -> float | str | None:
    """Seconds to add to the stamps of a result, or `AUTO`; None: not stated; UsageError for anything else."""
    if _of(OFFSET, [v for v in reading.time_offset if v.startswith(f"{TRUTH}=")], TRUTH, (), alone=True) is not None:
        raise UsageError(f"{OFFSET} {TRUTH}=...: the truth's clock counts; move the result by the negative")
    value = _of(OFFSET, reading.time_offset, name, names)
    if value is None or value == AUTO:
        return value
    if not (is_number(value) and math.isfinite(float(value))):
        raise UsageError(f"{OFFSET} {value}: a number of seconds or {AUTO} is needed")
    return float(value)


UNITS = {"time": (*TIME, ISO), "angle": (*ANGLE,), "length": (*DIMENSIONS["length"],)}


def _of(
    flag: str, values: Sequence[str], name: str, names: Sequence[str], known: Sequence[str] = (), *, alone: bool = False
) -> str | None:
    """A flag's value for a name of `known`; `alone`: one without a name is for the only result, never the truth."""
    parts = [(text, *text.partition("=")) for text in values]
    own = [value for _, who, equals, value in parts if equals and who == name]
    common = [text for text, who, equals, _ in parts if not equals or who not in (*names, TRUTH)]
    for twice in (own, common):
        if len(twice) > 1:
            raise UsageError(f"{flag} {twice[1]}: given twice for one result; write NAME=... for each")
    if alone and common and len(names) != 1:
        one = f"NAME={common[0]} with NAME one of {', '.join(names)}" if names else "--result NAME=FILE"
        raise UsageError(f"{flag} {common[0]}: of which result? {one} is needed")
    found = own if own or (alone and name == TRUTH) else common
    return _known(flag, found[0], known or found) if found else None


def _known(flag: str, value: str, known: Sequence[str]) -> str:
    if value not in known:
        raise UsageError(f"{flag} {value}: unknown{did_you_mean(value, known)}; known: {', '.join(known)}")
    return value


def true_path(file: str, names: Sequence[str], reading: Matching, *, rows: bool = False) -> GivenPath:
    """The true path in a file, whose `rows` hold the estimate, too, or in a log folder; its covariance is not used."""
    if (Path(file) / HEADER).is_file():
        log = load_folder(file)
        if log.truth.pose is None:
            raise DataError.at(file, "has no true poses (truth.csv)")
        clock = Clock("s", paths.ROWS if log.recorded.time_is_index else STATED)
        datum, own = tuple(cast("list[float]", log.source.get("datum", ()))), f"log {log.name!r}"
        return GivenPath(own, "a log folder", log.recorded.time, log.truth.pose, clock=clock, datum=datum)
    return read_path(file, replace(manner_of(TRUTH, names, reading), frame=None, order=None, rows=rows))


def truth_of(log: Log, path: GivenPath | None) -> TruePath | None:
    """The truth at its own stamps: that of a file, else of the log, else None."""
    if path is not None:
        if path.clock.by == paths.ROWS and len(path.time) != len(log.recorded):
            what = f"{len(path.time)} poses without stamps, {len(log.recorded)} frames: which belong together?"
            raise DataError.at(path.file, f"{what} A pose for each frame, or --times truth=FILE, a stamp [s] a line")
        return TruePath.of(path)
    return None if log.truth.pose is None else TruePath(log.recorded.time, log.truth.pose)


def runs_of(result: Result, log: Log, task: str, truth: TruePath | None, reading: Matching) -> Iterator[GivenRun]:
    """The runs of a result on a log, one, or one per phase if their stamps differ, with questions among their notes.
    DataError: no pose matches the truth, units of stamps disagree, or decisions are of other observations.
    """
    kept = _kept(result, log)
    paths, truth, asked = _comparable(result, log, truth, reading)
    groups = [paths]
    listed = list(paths.items())
    if len(listed) > 1 and not np.array_equal(listed[0][1].time, listed[1][1].time):
        groups = [dict([p]) for p in listed]
    for group in groups:
        run = given_run(
            result.name, task, group, log, truth, align=reading.align, gap=reading.truth_gap, pairs=reading.pairs,
            kept=kept,
        )  # fmt: skip
        phase, last = next((p, group[p]) for p in ("final", "online") if p in group)
        if truth is not None and run.match is not None and not run.match.matched:
            why = "; the log has no stamps, so t is the index of a frame" if log.recorded.time_is_index else ""
            raise DataError(unmatched(last, truth) + why)
        notes = [*asked, *about_file(last)]
        if truth is not None and run.match is not None:
            scored = replace(last, pose=run.trajectory(phase).pose)
            notes += about_pair(Pair(scored, truth.path, run.match.truth, run.space.get(phase), run.aligned != NONE))
            notes += () if truth.path is None else about_file(truth.path)
        named = {} if truth is None or truth.path is None else {truth.path.file: TRUTH}
        yield replace(run, notes=(*run.notes, *called(notes, named | {last.file: result.name})))


def _comparable(
    result: Result, log: Log, truth: TruePath | None, reading: Matching
) -> tuple[dict[str, GivenPath], TruePath | None, list[Notice]]:
    """Paths and truth on one clock, and in one pair of frames; questions where it is not known."""
    paths = result.paths
    if truth is None or log.recorded.time_is_index or not len(truth.time):
        if result.offset:
            why = "there is no truth" if truth is None else "the log has no stamps"
            raise UsageError(f"{OFFSET} {result.offset}: {why}")
        return paths, truth, []
    other = truth.path or GivenPath(f"log {log.name!r}", "", truth.time, truth.pose, clock=Clock("s", STATED))
    made: dict[str, GivenPath] = {}
    for phase, path in paths.items():
        made[phase], other = same_clock(path, other, result.name, moved=isinstance(result.offset, float))
    made, moved = _moved(made, other, result.offset)
    if truth.path is None:
        return made, truth, moved
    asked: list[Notice] = []
    for phase, path in made.items():
        made[phase], asked = same_frames(path, other, reading.align)
    return made, TruePath.of(other), [*moved, *asked]


def _moved(
    paths: dict[str, GivenPath], truth: GivenPath, offset: float | str | None
) -> tuple[dict[str, GivenPath], list[Notice]]:
    """Paths with stamps moved by an offset, that of the last phase if it is `AUTO`, and a notice of it."""
    if not offset:
        return paths, []
    seconds, error = (offset, None) if isinstance(offset, float) else (0.0, None)
    if isinstance(offset, str):
        last = paths.get("final", next(iter(paths.values())))
        seconds, error = time_offset(last.file, last.time, last.pose, truth.time, truth.pose)
    moved = {phase: restamped(path, path.time + seconds, path.clock) for phase, path in paths.items()}
    return moved, [notice(Code.TIME_OFFSET, seconds=seconds, error=error)]


def unmatched(path: GivenPath, truth: TruePath) -> str:
    """The message about a result without any match."""
    known = truth.time[np.isfinite(truth.pose[:, :2]).all(axis=1)]
    of = f"truth is known from {_span(known)}" if len(known) else "no true pose is known"
    found = f"{path.file}: none of its {len(path)} stamps, {_span(path.time)}, has a truth: {of}"
    if len(known) > 1 and known[0] <= path.time[-1] and path.time[0] <= known[-1]:
        gap = float(np.diff(known).max())
        return f"{found}, with poses up to {gap:.4g} s apart; --truth-gap {math.ceil(gap)} interpolates them"
    return f"{found}; both need one clock (`--time-offset auto` estimates an offset)"


def _span(time: Array) -> str:
    return f"{float(time[0])!r} to {float(time[-1])!r} s"


def _kept(result: Result, log: Log) -> MapAndDecisions:
    """Map and decisions of a result, after a check that these are about the observations of the log."""
    b = result.companions
    if b.decisions is None or not len(log.recorded.observations.frame):
        return MapAndDecisions(b.landmarks)
    decisions: IntArray = b.decisions
    frame = log.recorded.observations.frame
    m = len(frame)
    within = np.arange(m) - log.recorded.start[frame]
    if len(decisions) < m:
        raise DataError.at(str(b.file), f"{len(decisions)} decisions; log {log.name!r} has {m} observations")
    off = np.flatnonzero((decisions[:m, 0] != frame) | (decisions[:m, 1] != within))
    if len(off):
        k = int(off[0])
        found, needed = (f"frame {i}, observation {j}" for i, j in (decisions[k, :2], (frame[k], within[k])))
        raise DataError.at(str(b.file), f"{found}; {needed} of log {log.name!r} is needed", line=k + 2)
    return MapAndDecisions(b.landmarks, *decisions[:m, 2:].T)


@dataclass(frozen=True, eq=False)
class Asked:
    """Results to score, and their truth."""

    results: tuple[Result, ...] = ()
    file: GivenPath | None = None  # given truth; None: that of the log
    truth: TruePath | None = None  # at its own stamps, known with the log; None: unknown
    reading: Matching = PLAIN  # flags

    def settled(self, log: Log) -> tuple[Log, Asked]:
        """The log with the given truth, if any, and the results with their truth."""
        file = None if self.file is None else about_datum(self.file, log)
        results = [replace(r, paths={k: about_datum(p, log) for k, p in r.paths.items()}) for r in self.results]
        truth = truth_of(log, file)
        lost = [p.file for r in results for p in r.paths.values() if p.datum and "datum" not in log.source]
        if lost and file is None and truth is not None and self.reading.align == NONE:
            raise DataError.at(lost[0], f"latitudes; log {log.name!r} has no datum; --align se2 fits them to its truth")
        if file is None:
            return log, replace(self, truth=truth, results=tuple(results))
        if file.clock.by == ROWS and len(file) == len(log.recorded):  # a pose for each frame
            file = restamped(file, log.recorded.time, Clock("s", STATED))
            truth = TruePath.of(file)
        changed, found = with_truth(log, file, self.reading.truth_gap)
        if not found.matched:
            own = GivenPath(f"log {log.name!r}", "", log.recorded.time, log.recorded.increments.mean)
            raise DataError(unmatched(own, TruePath(file.time, file.pose)))
        return changed, replace(self, truth=truth, results=tuple(results))


def about_datum(path: GivenPath, log: Log) -> GivenPath:
    """A path of latitudes about the datum of a log that states one; any other is unchanged."""
    datum = log.source.get("datum")
    if not path.datum or not isinstance(datum, list):
        return path
    here, origin = (np.array([*place[:2], 0.0]) for place in (path.datum, datum))
    shift = east_north_up(here[None], origin)[0] * [1.0, 1.0, 0.0]
    space = path.space and replace(path.space, position=path.space.position + shift)
    notes = tuple(re.sub(r"(and longitude) \S+ \S+ deg$", rf"\1 {datum[0]}, {datum[1]} deg", n) for n in path.notes)
    return replace(path, pose=path.pose + shift, space=space, datum=(*datum,), notes=notes)


NOTHING = Asked()


def asked_results(reading: Results, logs: Sequence[str], folders: Sequence[str]) -> Asked:
    """The results and truth of the flags; UsageError for an invalid combination."""
    for row in rows(Matching).values():
        if getattr(reading, row.name) != row.default and not (reading.result or reading.truth):
            raise UsageError(f"{row.option}: for results only; type --result NAME=FILE, too")
    if not reading.result and reading.truth is None:
        return NOTHING
    flag = f"--result {reading.result[0]}" if reading.result else f"--truth {reading.truth}"
    if len(logs) > 1 or folders:
        raise UsageError(f"{flag}: belongs to one log; name one log")
    if not logs and reading.truth is None:
        raise UsageError(f"{flag}: on which log? name one, or type --truth FILE")
    if not logs and not reading.result:
        raise UsageError(f"{flag}: nothing to score; type --result NAME=FILE, or name the log of this truth")
    named = named_results(reading.result)
    names = list(named)
    file = None if reading.truth is None else true_path(reading.truth, names, reading)
    datum = () if file is None else file.datum
    results = []
    for name, path in named.items():
        result = _result(name, path, replace(manner_of(name, names, reading), datum=datum))
        results.append(replace(result, offset=offset_of(name, names, reading)))
    return Asked(tuple(results), file, None if file is None else TruePath.of(file), reading)


def truth_alone(asked: Asked) -> Log:
    """A log of the truth alone, named after its file, or after the folder of a file named `truth`."""
    assert asked.file is not None  # the caller asks for it only then
    path = file_and_topic(asked.file.file)[0]
    name = path.absolute().parent.name if path.stem in ("truth", "groundtruth", "data") else path.stem
    return truth_log(name or "truth", asked.file)


def with_results(trials: Sequence[Trial], asked: Asked) -> tuple[Trial, ...]:
    """The trials with the results: results with a map join that of SLAM, others the first."""
    made = list(trials)
    hosts = [i for i, t in enumerate(made) if t.variant_of is None]
    for result in asked.results:
        slam = [i for i in hosts if made[i].task == "slam" and result.companions.landmarks is not None]
        i = (slam or hosts)[0]
        host = made[i]
        runs = tuple(runs_of(result, host.log, host.task, asked.truth, asked.reading))
        made[i] = replace(host, runs=(*host.runs, *runs))
    return tuple(made)

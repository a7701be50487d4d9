"""Odometry of another program's table as increments between frames: velocities, poses, steps or wheel ticks.

A second one becomes closures between successive frames (`--second-odometry FILE`).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data import se2
from data.csv_table import Table, is_name
from data.errors import DataError, UsageError
from data.formats.messages import runs_of
from data.formats.recordings.laser import TravelNoise, increments_of
from data.formats.results.path import COARSE, STEPS
from data.formats.results.reading import words_of
from data.formats.second_odometry import closures_between, covered, of_twists, own_name
from data.formats.tables.files import BEYOND, QUATERNION, SECOND, TWIST, Columns, described, factor, headings, meaning
from data.formats.text import TextTable
from data.inputs import Increments
from data.motion.velocity import VelocityModel, VelocityNoise, preintegrate, told
from data.pose_measurements import Closures
from data.se2 import Array
from data.terminal import counted
from data.timeline import usual_gap

SAID = tomllib.loads(Path(__file__).with_name("noise.toml").read_text(encoding="utf-8"))
KINDS = {
    "velocities": ("v", "omega"), "poses": ("x", "y", "theta"), "steps": ("dx", "dy", "dtheta"),
    "ticks": ("left", "right"), "car": ("v", "steering"), "sideways": ("v", "vy", "omega"), "course": ("v", "theta"),
}  # fmt: skip
"""Columns of each kind of odometry; steps are the motion since the row before, in the body frame there, and may lack
dy; a car has speeds of its rear, angles of its front wheels; vy (to the left), and v beside theta, must be stated."""
STAMPED = ("velocities", "car")  # Kinds that need stamps, and whose noise is of velocities


@dataclass(frozen=True)
class Wheels:
    """Wheels of ticks."""

    track_width: float  # m; of a car the distance between its axles; 0: a heading tells the turns
    metres: tuple[float, float]  # per tick, left and right
    each: bool = False  # each row counts from the one before
    wrap: int = 0  # number of ticks at which a counter restarts; 0: never
    rate: bool = False  # ticks are per s
    backward: bool = False  # rates hold since the row before


class StepNoise(NamedTuple):
    """Standard deviations of each row's motion along and across [m] and of its turn [rad], whatever its length."""

    along: float
    across: float
    turn: float


Noises = VelocityNoise | TravelNoise | StepNoise


@dataclass(frozen=True, eq=False)
class Odometry:
    """One file's odometry."""

    table: Table  # its rows, for messages
    time: Array  # (K,) s, strictly increasing; row numbers without stamps
    stamped: bool  # whether there are stamps
    motion: Array  # (K, 2) velocities [m/s, rad/s], or (K, 3) poses, composed or recorded
    rows: Array  # (F,) s, the instant of each row of the file, merged and blank ones too; NaN: it has none

    @property
    def velocities(self) -> bool:
        """Whether the rows are velocities; else they are poses."""
        return bool(self.motion.shape[1] == 2)

    @property
    def span(self) -> tuple[float, float]:
        """First and last instant [s] whose motion is told: of velocities the last row holds as long as is usual."""
        return told(self.time) if self.velocities else (float(self.time[0]), float(self.time[-1]))

    def held_backward(self) -> Odometry:
        """Velocities that hold until the next sample, from rows that held since the one before; the last holds on."""
        return replace(self, motion=np.concatenate([self.motion[1:], self.motion[-1:]]))

    def since(self, begin: float) -> Odometry:
        """The odometry from an instant between its stamps on, the first stamp."""
        rows = np.flatnonzero(self.time > begin)
        before = rows[0] - 1
        time, motion = self.time[rows], self.motion[rows]
        if self.velocities and begin - self.time[before] > usual_gap(self.time):  # in a gap
            return replace(self, time=time, motion=motion)
        first = self.motion[before : rows[0]]
        if not self.velocities:
            first = se2.interpolate(self.time, self.motion, np.array([begin]))
        return replace(self, time=np.append(begin, time), motion=np.concatenate([first, motion]))

    def increments(self, at: Array, noise: Noises, model: str = "unicycle") -> tuple[Increments, int]:
        """Motion between instants `at` (N,), and the number of gaps (velocities) or floored covariances (poses)."""
        if isinstance(noise, VelocityNoise):
            return preintegrate(VelocityModel(noise, model), self.time, self.motion[:, 0], self.motion[:, 1], at)
        if isinstance(noise, StepNoise):
            # the rate of a row's error, as of a velocity over its interval; the first row has no motion
            rate = np.diag(np.square(noise)) / np.diff(self.time, prepend=-np.inf)[:, None, None] ** 2
            return of_twists(self.time, self.motion, rate, at), 0
        same = np.array_equal(at, self.time)
        return increments_of(self.motion if same else se2.interpolate(self.time, self.motion, at), noise)


def kind_of(file: TextTable, columns: Columns, role: str, truth: TextTable | None = None) -> str:
    """The only kind of odometry whose columns a file has, v and omega before poses; DataError for none or several."""
    notes, columns = columns.notes, columns.quiet
    pose = {"poses": pose_columns(file, columns, role), "steps": ("dx", "dtheta")}
    turns = any(columns.has(file, role, (q,)) for q in ("omega", "steering"))
    aside = columns.stated(role, ("vy",)) or "vy" in columns.given
    if aside and (turns or not columns.has(file, role, ("theta",))):
        return "sideways"
    if (columns.stated(role, ("v",)) or "v" in columns.given) and columns.has(file, role, ("theta",)) and not turns:
        return "course"
    kinds = {k: pose.get(k, qs) for k, qs in KINDS.items() if k not in ("sideways", "course")}
    found = [k for k, qs in kinds.items() if columns.has(file, role, qs)]
    stated = [k for k in found if columns.stated(role, KINDS[k])]
    if len(found) > 1 and not stated and columns.taken(file, role, ("x", "y"), truth):
        found.remove("poses")
    found = [k for k in found if k != "ticks" or [k] in (found, stated) or {*KINDS[k]} <= {*file.names, *columns.given}]
    both, v = {"velocities", "poses"} <= {*found} and not stated, columns.find(file, role, "v")
    if both and meaning(file.names[v or 0])[1][1].endswith(TWIST["v"]):
        found.remove("velocities")  # of which a message's pose is made
    named = stated or [k for k in found if {*KINDS[k]} <= {*file.names}]
    if len(named or found) == 1:
        return (named or found)[0]
    if named == ["velocities", "poses"] and not stated:
        notes.append(f"{file.path.name}: {role} is v and omega; --{role}-kind poses reads x, y, theta instead")
        return named[0]
    listed = "; ".join(f"{k} ({', '.join(qs)})" for k, qs in KINDS.items())
    if not found:
        what = f"no odometry: {described(file)}; one of {listed} is needed"
        own = "" if role == "odometry" else f"{role}."
        if any(re.search("(?i)acc|^a_?[xy]$", name) for name in file.names):
            what += f" ({SAID['accelerations']})"
        if sum(re.search(FOUR, name) is not None for name in file.names) >= 4:
            what += f" ({SAID['four-wheels']})"
        what += f"; name them as in --columns {own}v=SPEED,{own}omega=TURN_RATE"
        raise DataError.at(file.path, what + f"; if there is none, {SAID['none']}" * (not own))
    raise DataError.at(file.path, f"holds {' and '.join(named or found)}; choose one with --{role}-kind {found[0]}")


def pose_columns(file: TextTable, columns: Columns, role: str) -> tuple[str, ...]:
    """x, y and theta, or a quaternion instead of a missing theta; of a truth without either x and y."""
    if role == "truth" and columns.stated(role, ("dx",)):
        raise DataError.at(file.path, "steps as a truth; true poses x, y, theta are needed, which the steps lead to")
    typed, whole = {*columns.given}, columns.has(file, role, QUATERNION)
    named = typed & {"qx", f"{role}.qx"} and not typed & {"theta", f"{role}.theta"}
    own = None if named else columns.find(file, role, "theta")
    theta = own is not None and (own in file.filled or not whole)
    turn = QUATERNION if whole and not theta else () if role == "truth" and not theta else ("theta",)
    return ("x", "y", *turn)


def read_odometry(
    file: TextTable, columns: Columns, kind: str, wheels: Wheels | None, role: str = "odometry", between: bool = False
) -> Odometry:
    """The odometry of a file, of K steps `between` K + 1 poses; DataError if invalid, UsageError without wheels."""
    quantities = pose_columns(file, columns, role) if kind == "poses" else KINDS[kind]
    if kind == "steps" and columns.find(file, role, "dy") is None:
        columns.notes.append(f"{file.path.name}: assumed: steps have no dy, so the robot moves ahead alone")
        quantities = ("dx", "dtheta")
    moved = kind in (*STAMPED, "sideways", "course")
    aside = kind == "course" and (columns.stated(role, ("vy",)) or "vy" in columns.given)
    quantities = (*quantities, *["vy"] * aside, *["theta"] * (kind == "ticks" and columns.stated(role, ("theta",))))
    if moved:
        _intervals(file, columns, role)
    stamped, period = columns.find(file, role, "t") is not None, columns.period
    summed = not stamped and period is None and moved and columns.find(file, role, "dt") is not None
    if not stamped and not summed and moved and period is None:
        columns.require(file, role, ("t",))
    more = ("dt",) * summed
    table, skipped = columns.table(file, role, (*["t"] * stamped, *quantities), optional=more, may_be_blank=more)
    since = period * np.arange(len(table), dtype=float) if period is not None and not stamped else None
    if summed:
        each = table.get("dt")
        each = each[np.isfinite(each)].repeat(len(each)) if np.isfinite(each).sum() == 1 else each
        table.require(each > 0.0, "dt", "{} is no time > 0")
        since = np.cumsum(each) - each
    if since is not None:
        table, stamped = replace(table, columns={**table.columns, "t": since}), True
    if len(table) == 0:
        raise DataError.at(file.path, f"no row has {', '.join(quantities)}")
    notes = columns.notes
    table = _without_strays(table, f"{file.path.name}: lines", notes, kind) if stamped and since is None else table
    time = table.columns["t"] if stamped else np.arange(len(table), dtype=float)
    instants = np.full(len(file), np.nan)
    instants[np.searchsorted(file.line, table.line)] = time
    if since is None and stamped and (lost := np.isnan(instants)).any():
        instants[lost] = columns.stamps(file, role, lost)
    if stamped:
        back = np.diff(time) < 0.0
        if back.any() and (runs := runs_of(file.path)):
            raise DataError.at(file.path, f"stamps begin anew{runs}")
        few = "; leave such rows out" if back.mean() < SOME else f"; a time between rows is --columns {role}.dt=NAME"
        table.require_ascending("t", strictly=False, hint=few)
        # the last of rows with equal stamps is used: a row per observation repeats the odometry
        last = np.append(time[1:] > time[:-1], True)
        motion = table.stack(quantities)
        other = ~last[:-1] & (motion[1:] != motion[:-1]).any(axis=1)
        if other.sum() > COARSE * len(time):
            some = f"{int(other.sum())} of {len(time)} rows of other motion have the stamp of the next one"
            what = f"{some}; stamps with more digits than {time[0]:.15g} are needed"
            ways = f"of seconds and nanoseconds --columns {role}.t=SEC+NSEC; none: --period"
            raise DataError.at(file.path, f"{what} ({ways})")
        if not last.all():
            if kind == "steps" or (kind == "ticks" and wheels is not None and wheels.each):
                raise table.error(int(np.argmin(last)) + 1, "t", f"the stamp of the row before; {kind} need their own")
            shared = f"{int((~last).sum())} odometry rows share the stamp of the next one"
            notes.append(f"{file.path.name}: {shared}, which is used")
            table, time = table.part(last), time[last]
    if skipped:
        notes.append(f"{file.path.name}: {counted(skipped, 'row')} without odometry")
    values = table.columns
    if kind == "car":
        if wheels is None:
            raise UsageError("speed and steering of a car: --wheel-base M, the distance between its axles, is needed")
        values["omega"] = values["v"] * np.tan(values["steering"]) / wheels.track_width
    if kind in STAMPED:
        return Odometry(table, time, stamped, table.stack(("v", "omega")), instants)
    if kind == "poses":
        pose = np.stack([values["x"], values["y"], headings(values, columns.units.factor(role, "theta"))], axis=-1)
        pose = columns.turned(file, role, time, pose)
        pose[:, 2] = se2.wrap_angle(pose[:, 2])
        step = np.hypot(*np.diff(pose[:, :2], axis=0).T)
        leap = step > max(LEAP * float(np.median(step[step > 0.0])), RESET) if step.any() else step > 0.0
        if len(anew := np.flatnonzero(leap & (pose[1:] == pose[0]).all(axis=1))):
            k = int(anew[0]) + 1
            told = f"its pose leaps {step[k - 1]:.3g} m back to the first one: it was reset, so the odometry ends there"
            notes.append(f"{file.path.name}: line {table.line[k]}: {told}")
            table, time, pose = table.part(np.arange(k)), time[:k], pose[:k]
            instants[instants > time[-1]] = np.nan
    elif kind in ("sideways", "course"):  # each row holds until the next, along arcs
        held = np.minimum(np.diff(time), usual_gap(time))
        turn = held * values["omega"][:-1] if kind == "sideways" else np.diff(np.unwrap(values["theta"]))
        ahead, left = (se2.along_arcs(held * values.get(q, 0.0 * time)[:-1], turn) for q in ("v", "vy"))
        ahead[:, :2] += left[:, 1::-1] * [-1.0, 1.0]
        pose = se2.dead_reckoned(np.zeros(3), np.concatenate([np.zeros((1, 3)), ahead]))
    elif kind == "steps":
        steps = np.stack([values.get(q, 0.0 * values["dx"]) for q in KINDS["steps"]], axis=-1)
        if between and not np.isnan(instants[: len(time)]).any():
            steps = np.concatenate([np.zeros((1, 3)), steps])
            time = instants = np.append(time, time[-1] + (columns.period or 1.0))
            notes.append(f"{file.path.name}: its {len(values['dx'])} steps are between {len(time)} poses")
        pose = se2.dead_reckoned(np.zeros(3), np.concatenate([np.zeros((1, 3)), steps[1:]]))
        if steps[0].any():
            notes.append(f"{file.path.name}: the step of the first row precedes the log and is ignored")
    else:
        assert wheels is not None  # of ticks they are stated
        pose = _rolled(table.stack(KINDS["ticks"]), wheels, time, values.get("theta"))
    return Odometry(table, time, stamped, pose, instants)


def other_rate(file: TextTable, columns: Columns, odometry: Odometry, wheels: Wheels | None) -> None:
    """Note a turn rate in the odometry's table that is not read, and is the odometry's but for a factor."""
    rows, turn, role = np.searchsorted(file.line, odometry.table.line), odometry.motion[:, -1], "odometry"
    own = turn if odometry.velocities else np.diff(np.unwrap(turn)) / np.diff(odometry.time)
    free = [n for n in file.names if re.search(TURN_RATE, n) and (file.path, n) not in columns.read]
    told = odometry.velocities or (wheels is not None and wheels.track_width > 0.0)
    for name in free if told and len(rows) == len(turn) > MANY else ():
        with suppress(DataError, UsageError):  # no numbers, or of another unit
            unit, si = factor("angle/time", words_of(name)[1] or "rad/s", name), columns.units.factor(role, "omega")
            other = unit * file.numbers(file.names.index(name), np.ones(len(file), bool))[rows]
            (a, b), (_, c) = np.cov(own, other if odometry.velocities else 0.5 * (other[1:] + other[:-1]))
            if b * b > ALIKE * a * c and abs((k := float(np.sign(b) * np.sqrt(c / a))) - 1.0) > OFF:
                flag = f"track-width {wheels.track_width / k:.4g}" if wheels else f"unit omega={si * k:.4g}rad/s"
                columns.notes.append(f"{file.path.name}: {name} {SAID['other-rate'].format(times=k, flag=flag)}")


def path_of(texts: Mapping[str, TextTable], columns: Columns, kind: str) -> tuple[Array, Array] | None:
    """Stamps (K,) [s] and poses (K, 3) of a truth, else of an odometry; None without stamps, or of wheels and cars."""
    quiet = columns.quiet
    if "truth" in texts and quiet.has(texts["truth"], "truth", wants := ("t", "x", "y", "theta")):
        values = quiet.table(texts["truth"], "truth", wants, may_be_blank=wants[1:])[0].stack(wants)
        values = values[np.isfinite(values).all(axis=1)]
        if len(values) > 1:
            return values[:, 0], quiet.turned(texts["truth"], "truth", values[:, 0], values[:, 1:])
    timed = kind in ("poses", "steps") or quiet.find(texts["odometry"], "odometry", "t") is not None
    if kind in ("ticks", "car") or not timed:
        return None
    odometry = read_odometry(texts["odometry"], quiet, kind, None)
    if not odometry.velocities:
        return odometry.time, odometry.motion
    way, turn = odometry.motion[:-1].T * np.diff(odometry.time)
    return odometry.time, se2.dead_reckoned(np.zeros(3), np.concatenate([np.zeros((1, 3)), se2.along_arcs(way, turn)]))


def _intervals(file: TextTable, columns: Columns, role: str) -> None:
    """Take a column named as stamps that do not ascend, all about as small, for the time until the next row."""
    if (column := columns.find(file, role, "t")) is None or columns.units.dates(role):
        return
    each = columns.stamps(file, role, np.array([row[column] != "" for row in file.rows]))
    usual, back = float(np.median(each)) if len(each) > MANY else 0.0, np.mean(np.diff(each) < 0.0)
    if not (back > SOME and usual < STEPS[1] and each.min() > 0.0 and each.max() < BEYOND * usual):
        return
    name = file.names[column]
    columns.intervals |= {(file.path, part, column) for part in columns.roles}
    columns.given = {**columns.given, f"{role}.dt": name}
    columns.notes.append(f"{file.path.name}: inferred: --columns {role}.dt={name}, as {name} does not ascend")


FOUR = "(?i)(front|rear|back|(^|_)[fbr])_?(left|right|[lr](?![a-z]))"  # In the name of each of four wheels
TURN_RATE = r"(?i)(gyro|(yaw|turn).?rate|angular.*|omega|(^|[_.])w)_?z?(\W.*)?$"  # Names of columns of turn rates
ALIKE, OFF = 0.8, 0.05  # Share of the variance that a factor explains, at least, and its least difference from 1
LEAP, RESET = 5.0, 0.1  # Usual steps, and m, of a leap to the first pose, of an odometry that is set to zero
MANY, SOME = 20, 0.1  # Fewest rows, and least share of steps back, of a column of times that are no stamps


def _without_strays(table: Table, lines: str, notes: list[str], kind: str) -> Table:
    """Without a first or last row that a long pause parts from all others; of poses and ticks all pauses are noted."""
    time, line = table.columns["t"], table.line.tolist()
    step, last, kept = np.diff(time), len(time) - 2, np.ones(len(time), bool)
    usual = float(np.median(step)) if len(step) > MANY else np.inf
    for k in np.flatnonzero(step > max(PAUSE * usual, LONG)).tolist():
        kept[[0, -1]] &= [k > 0, k < last]
        left = f"; line {line[k and k + 1]} is left out" * (k in (0, last))
        if left or kind not in STAMPED:
            notes.append(f"{lines} {line[k]} and {line[k + 1]} are {step[k]:.6g} s apart, others {usual:.3g} s{left}")
    return table.part(kept)


PAUSE, LONG = 1000.0, 100.0  # Times the usual interval, and s, that rows of one drive are not apart


def _rolled(ticks: Array, wheels: Wheels, time: Array, theta: Array | None = None) -> Array:
    """Poses (K, 3) of a two-wheeled robot from its ticks (K, 2), left and right: arcs, of its headings if stated."""
    turned = ticks.copy() if wheels.each else np.diff(ticks, axis=0, prepend=ticks[:1])
    turned[0] = 0.0
    if wheels.rate:
        turned[1:] = (ticks[1:] if wheels.backward else ticks[:-1]) * np.diff(time)[:, None]
    if wheels.wrap:
        turned = (turned + 0.5 * wheels.wrap) % wheels.wrap - 0.5 * wheels.wrap
    way = turned * np.array(wheels.metres)
    turn = np.diff(way)[:, 0] / wheels.track_width if theta is None else np.diff(np.unwrap(theta), prepend=theta[:1])
    return se2.dead_reckoned(np.zeros(3), se2.along_arcs(way.mean(axis=1), turn))


@dataclass(frozen=True)
class Second:
    """What is stated of a second odometry: its kind, and noise as of the first."""

    kind: str
    noise: Noises


def read_second(file: TextTable, second: Second, columns: Columns, first: Odometry) -> Odometry:
    """The second odometry of a file; DataError for stamps or rows unlike the first's, or the same motion once more."""
    found = read_odometry(file, columns, second.kind, None, SECOND)
    if found.stamped != first.stamped:
        columns.require(file, SECOND if first.stamped else "odometry", ("t",))
    if not found.stamped and len(found.time) != len(first.time):
        what = f"{counted(len(found.time), 'row')}, the odometry has {len(first.time)}"
        raise DataError.at(file.path, f"{what}; without stamps each row of one needs a row of the other")
    if np.array_equal(found.time, first.time) and np.array_equal(found.motion, first.motion):
        raise DataError.at(file.path, "the motion of the odometry once more; another one is needed")
    return found


def second_closures(
    file: TextTable, odometry: Odometry, second: Second, time: Array, taken: Collection[str], notes: list[str]
) -> Closures:
    """Closures between successive frames at `time` (N,), of velocities without gaps; `taken`: other names."""
    stem = file.path.stem
    name = own_name(stem if is_name(stem) else SECOND, taken)
    frames = np.flatnonzero(covered(odometry.time, time))
    if len(frames) < 2:
        span = f"{odometry.time[0]:.15g} to {odometry.time[-1]:.15g}"
        what = f"{SECOND} from {span} s covers {counted(len(frames), 'frame')} of {time[0]:.15g} to {time[-1]:.15g} s"
        raise DataError.at(file.path, f"{what}; two are needed; state the unit as in --unit {SECOND}.t=ms")
    motion, _ = odometry.increments(time[frames], second.noise)
    gaps = None
    if odometry.velocities:
        broken = np.cumsum(np.diff(odometry.time, prepend=odometry.time[0]) > usual_gap(odometry.time) + 1e-6)
        row = np.searchsorted(odometry.time, time[frames])
        gaps = broken[row[1:]] != broken[row[:-1]]
    found = closures_between(frames, motion, name, gaps)
    pairs = f"{len(found)} of {len(time) - 1} pairs of successive frames"
    notes.append(f"{file.path.name}: a second odometry, as closures between {pairs}, source {name}")
    return found

"""UTIAS MRCLAM: files and calibration of a dataset, and one robot of it as a log.

In a folder or in the published zip (never unpacked):

    Barcodes.dat               subject, barcode                          subjects 1-5 are robots
    Landmark_Groundtruth.dat   subject, x [m], y [m], x std, y std
    RobotN_Groundtruth.dat     time [s], x [m], y [m], heading [rad]     may be absent
    RobotN_Odometry.dat        time [s], forward velocity [m/s], angular velocity [rad/s]
    RobotN_Measurement.dat     time [s], barcode (not subject), range [m], bearing [rad]

Numbers separated by white space; a line that starts with # is a comment; stamps never decrease, some are equal.
Published by K.Y.K. Leung, Y. Halpern, T.D. Barfoot and H.H.T. Liu, IJRR 30(8), 2011.

Calibration and noise are tuned on Dataset 9 robot 3 only; every other log tests them. Corrections are applied once on
loading, before preintegration, so filter and smoother see the same numbers.

Frames are the instants with observations (one per image) and keyframes in between, or a grid; the odometry is
preintegrated between them. Times are seconds after the robot's first ground-truth row (or odometry row, without ground
truth); `Inputs.time` counts from the log's first frame.
"""

from __future__ import annotations

import hashlib
import math
import re
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from data.columns.scans import open_archive
from data.csv_table import Table, bytes_of, cut_off, lines_of, number_rows
from data.digest import file_sha256
from data.errors import DataError, UsageError
from data.formats.recordings.laser import FLOOR
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.velocity import MAX_HOLD, VelocityModel, VelocityNoise, floor_covariances, preintegrate
from data.origin import Origin
from data.se2 import Array, BoolArray
from data.sensors import RangeBearing
from data.terminal import counted
from data.timeline import MAX_GAP, frame_times, truth_at
from data.truth import Truth

MOTION = VelocityModel(VelocityNoise("density", (0.03, 0.06)))  # Noise of the odometry: m and rad per sqrt(s)
MIN_COSINE = 0.5  # Smallest divisor of depth; bearings of this camera end at 33 degrees
POSITIVE = ("scale_v", "scale_omega", "range_scale", "sigma_range", "sigma_bearing")
FINITE = ("odometry_delay", "latency", "range_bias", "bearing_bias")


@dataclass(frozen=True)
class Calibration:
    """Corrections and noise of odometry and camera. The defaults correct nothing; UsageError for an invalid value."""

    scale_v: float = 1.0  # factor on the forward velocity of the odometry file
    scale_omega: float = 1.0  # factor on its angular velocity
    turn_limit: float = math.inf  # rad/s; largest turn rate of the robot (after `scale_omega`)
    turn_drag: float = 0.0  # m/rad; speed lost per turn rate (as limited), without reversing
    midpoint_hold: bool = False  # a command acts from half-way between the stamp before and its own (at most 0.5 s)
    odometry_delay: float = 0.0  # s from the stamp of a command to its effect
    latency: float = 0.0  # s from the exposure of an image to its stamp
    range_is_depth: bool = False  # the measured range is the depth, true range * cos(measured bearing)
    range_scale: float = 1.0  # range_scale, range_bias [m]: measured = scale * true range (or depth) + bias
    range_bias: float = 0.0
    bearing_bias: float = 0.0  # rad; measured bearing = true bearing + bearing_bias
    sigma_range: float = 0.15  # sigma_range: m, sigma_bearing: rad, standard deviations of a corrected observation
    sigma_bearing: float = 0.1
    sigma_range_growth: float = 0.0  # m/m; the range sigma is sigma_range + sigma_range_growth * (corrected range)
    motion: VelocityModel = MOTION  # how odometry becomes increments, and its noise

    def __post_init__(self) -> None:
        rules: tuple[tuple[str, Callable[[float], bool], tuple[str, ...]], ...] = (
            ("a positive number is needed", lambda v: 0.0 < v < math.inf, POSITIVE),
            ("a positive turn rate is needed", lambda v: v > 0.0, ("turn_limit",)),
            ("must not be negative", lambda v: 0.0 <= v < math.inf, ("sigma_range_growth", "turn_drag")),
            ("a finite number is needed", math.isfinite, FINITE),
        )
        for what, fine, names in rules:
            for name in names:
                if not fine(getattr(self, name)):
                    raise UsageError(f"calibration: {name} = {getattr(self, name)}; {what}")

    def with_sigma(self, sigma_range: float, sigma_bearing: float) -> Calibration:
        """The same with standard deviations [m, rad] that do not depend on the range."""
        return replace(self, sigma_range=sigma_range, sigma_bearing=sigma_bearing, sigma_range_growth=0.0)

    def velocities(self, v: Array, omega: Array) -> tuple[Array, Array]:
        """Corrected velocities [m/s, rad/s] (K,) of commands (K,)."""
        turn = np.clip(self.scale_omega * omega, -self.turn_limit, self.turn_limit)
        return np.sign(v) * np.maximum(self.scale_v * np.abs(v) - self.turn_drag * np.abs(turn), 0.0), turn

    def instants(self, seconds: Array) -> Array:
        """Times at which commands stamped at `seconds` (K,), ascending, begin to act."""
        before = np.minimum(np.diff(seconds, prepend=seconds[:1]), MAX_HOLD)
        begin: Array = seconds - 0.5 * before if self.midpoint_hold else seconds
        return begin + self.odometry_delay

    def readings(self, z: Array) -> Array:
        """Corrected range [m] and bearing [rad] (M, 2) of raw ones; ranges are >= 0."""
        distance = np.maximum((z[:, 0] - self.range_bias) / self.range_scale, 0.0)
        if self.range_is_depth:
            distance = distance / np.maximum(np.cos(z[:, 1]), MIN_COSINE)
        return np.stack([distance, z[:, 1] - self.bearing_bias], axis=-1)

    def noise(self, z: Array) -> Array:
        """R (M, 2, 2) of corrected observations (M, 2), from the measured range."""
        R = np.zeros((len(z), 2, 2))
        R[:, 0, 0] = np.square(self.sigma_range + self.sigma_range_growth * z[:, 0])
        R[:, 1, 1] = self.sigma_bearing**2
        return R


FROZEN = Calibration(
    scale_v=1.07, turn_drag=0.073, turn_limit=0.59, midpoint_hold=True, odometry_delay=0.11, latency=0.04,
    range_is_depth=True, range_scale=1.01, range_bias=0.06, sigma_range=0.05, sigma_range_growth=0.03,
    sigma_bearing=0.05, motion=VelocityModel(VelocityNoise("density", (0.03, 0.08))),
)  # fmt: skip
"""The default calibration; docs/notes/utias.md says how each number was measured."""


BARCODES, LANDMARKS = "Barcodes.dat", "Landmark_Groundtruth.dat"
ROBOT_FILE = re.compile(r"Robot([1-9][0-9]*)_(Groundtruth|Odometry|Measurement)\.dat")


@dataclass(frozen=True)
class Files:
    """The files of a dataset in its folder, on disk or in a zip; `sha256`: of files read so far, or the zip's."""

    name: str
    home: Path | zipfile.Path
    sha256: dict[str, str]

    @property
    def names(self) -> frozenset[str]:
        """Names of the files."""
        return frozenset(p.name for p in self.home.iterdir() if p.is_file())

    def path(self, name: str) -> str:
        """The path of a file in errors."""
        return str(self.home / name)

    def content(self, name: str) -> bytes:
        """Bytes of a file; DataError if it is missing or damaged."""
        if name not in self.names:
            there = f"; robots with odometry and measurements here: {', '.join(map(str, self.robots())) or 'none'}"
            raise DataError.at(self.path(name), "no such file" + (there if ROBOT_FILE.fullmatch(name) else ""))
        if isinstance(self.home, Path):
            content = bytes_of(self.home / name)
            self.sha256[name] = hashlib.sha256(content).hexdigest()
            return content
        try:
            return (self.home / name).read_bytes()
        # RuntimeError: an encrypted member; NotImplementedError: an unknown method
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
            raise DataError.at(self.path(name), f"cannot be read from the zip: {error}") from None

    def robots(self) -> list[int]:
        """Robots with odometry and measurements, ascending."""
        names = self.names
        numbers = {int(m[1]) for m in map(ROBOT_FILE.fullmatch, names) if m is not None}
        return sorted(n for n in numbers if {robot_file(n, "Odometry"), robot_file(n, "Measurement")} <= names)


def robot_file(robot: int, what: str) -> str:
    """Name of a robot's file: `what` is Groundtruth, Odometry or Measurement."""
    return f"Robot{robot}_{what}.dat"


def open_files(source: Path) -> Files:
    """Files in a folder or zip, or in its only subfolder that holds any. DataError: neither, no dataset, or several."""
    if not source.exists():
        raise DataError.at(source, "no such folder or zip file")
    try:
        top = source if source.is_dir() else zipfile.Path(open_archive(source, whole=True))
        folders = [top, *sorted((p for p in top.iterdir() if p.is_dir()), key=lambda p: p.name)]
        its = ((f, Files(f.name, f, {}).names) for f in folders)
        dirs = [f for f, names in its if names & {BARCODES, LANDMARKS} or any(map(ROBOT_FILE.fullmatch, names))]
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        what = f"cannot be read: {error}" if source.is_dir() else f"not a readable zip file or folder: {error}"
        raise DataError.at(source, what) from None
    if not dirs:
        raise DataError.at(source / BARCODES, "no such file, nor any other MRCLAM file, here or one folder below")
    if len(dirs) > 1 and dirs[0] is not top:
        raise DataError.at(source, f"holds more than one dataset ({', '.join(f.name for f in dirs)}); name one of them")
    home = dirs[0]
    if isinstance(home, Path):
        return Files(home.resolve().name, home, {})
    return Files(source.stem if home is top else home.name, home, {source.name: file_sha256(source)})


ROBOTS = range(1, 6)  # Subjects that are robots, in every dataset of the collection
LONGEST = 1e6  # s, longest recording; keyframes up to a broken stamp would fill the memory


def parse(path: str, content: bytes, columns: tuple[str, ...]) -> Table:
    """Rows of finite numbers, checked to be complete; DataError names file, line and column."""
    lines = lines_of(content)
    fields = [line.split() for line in lines]
    data = [i for i, row in enumerate(fields) if row and not row[0].startswith(b"#")]
    if not data:
        raise DataError.at(path, f"no rows; wanted {', '.join(columns)}", line=len(lines))
    rows = [fields[i] for i in data]
    for i, row in zip(data, rows, strict=True):
        if len(row) != len(columns):
            last = cut_off(len(row), len(columns), last=i == data[-1])
            what = f"{len(row)} fields where {len(columns)} are needed ({', '.join(columns)}){last}"
            raise DataError.at(path, what, line=i + 1)
    line = np.array(data, np.int64) + 1
    table = Table(path, dict(zip(columns, number_rows(path, line.tolist(), rows, columns).T, strict=True)), line=line)
    table.require_finite(columns)
    decimals = [len(row[-1].partition(b".")[2]) for row in rows]
    if lines[-1].strip() and len(rows) > 1 and decimals[-1] < min(decimals[:-1]):
        last = rows[-1][-1].decode("utf-8", "replace")
        what = f"{last} has fewer decimals than any other row, and no line end; the file was cut off"
        raise table.error(len(rows) - 1, columns[-1], what)
    return table


def _stamped(files: Files, name: str, columns: tuple[str, ...]) -> Table:
    """A file whose first column is a stamp that never decreases."""
    table = parse(files.path(name), files.content(name), ("time", *columns))
    table.require_ascending("time", strictly=False)
    stamp = table.columns["time"]
    far = f"{{}} is more than {LONGEST:g} s after the first row; stamps are in seconds"
    table.require(stamp - stamp[0] <= LONGEST, "time", far)
    return table


def read_landmarks(files: Files, replacement: Path | None = None) -> LandmarkMap:
    """Surveyed landmarks by subject, ascending; `replacement` is read instead of the dataset's file."""
    columns = ("subject", "x", "y", "x std-dev", "y std-dev")
    if replacement is None:
        table = parse(files.path(LANDMARKS), files.content(LANDMARKS), columns)
    else:
        content = bytes_of(replacement)
        files.sha256[replacement.name] = hashlib.sha256(content).hexdigest()
        table = parse(str(replacement), content, columns)
    subject = table.integers("subject", 0)
    table.require(~np.isin(subject, ROBOTS), "subject", "{} is a robot's number (1 to 5), not a landmark's")
    table.require_distinct("subject", subject, "{} is in two rows")
    for column in ("x std-dev", "y std-dev"):
        table.require(table.columns[column] >= 0.0, column, "{} is a negative standard deviation")
    order = np.argsort(subject)
    sigma = table.stack(("x std-dev", "y std-dev"))[order]
    return LandmarkMap(subject[order], table.stack(("x", "y"))[order], sigma=sigma if sigma.any() else None)


UNKNOWN_BARCODE = -2


def dropped(
    at: Array, barcode: Array, subject: IntArray, survey: LandmarkMap, odometry: Array
) -> tuple[BoolArray, list[str]]:
    """Which observations (M,) are not used, and a note for each reason: seen at stamps (M,) by barcodes (M,) of
    subjects (M,); `survey`: landmarks with known places; odometry (K, 3): t, v, omega.
    """
    nobody, robot = subject == UNKNOWN_BARCODE, np.isin(subject, ROBOTS)
    stray = ~nobody & ~robot & ~np.isin(subject, survey.id)
    known = ~(nobody | robot | stray)
    codes = ", ".join(f"{b:g}" for b in np.unique(barcode[nobody]))
    who = ", ".join(map(str, np.unique(subject[stray])))
    lost = np.zeros(len(at), bool)
    notes = []
    for which, why in (
        (nobody, f"of a barcode that no subject has ({codes}): skipped"),
        (robot, f"of other robots ({100.0 * robot.sum() / max(len(robot), 1):.0f} % of all): dropped"),
        (stray, f"of subjects that the landmark file does not have ({who}): dropped"),
        (known & (at < odometry[0, 0]), "before the first odometry: dropped"),
        (known & (at > odometry[-1, 0]), "after the last odometry: dropped"),
    ):
        lost |= which
        notes += [f"{counted(int(which.sum()), 'observation')} {why}."] * bool(which.any())
    return lost, notes


STALE = 0.05  # s, largest age of an observation on a grid, as in the classic tutorials


def lay_out(
    at: Array, odometry: Array, first: float, last: float, grid: float | None, motion: VelocityModel
) -> tuple[Array, Increments, IntArray, list[str]]:
    """Frames from `first` to `last` [s]: time (N,), increments, the frame (M,) of each observation or -1, and notes
    about dropped observations and gaps; `at` (M,): stamps; odometry (K, 3): t, v, omega.

    Without `grid` frames are the observations' instants and keyframes. With it they are that many s apart, the odometry
    is interpolated, and observations move to the nearest frame.
    """
    notes = []
    if grid is None:
        inside = (at >= first) & (at <= last)
        time = frame_times(at[inside], first, last)
        frame = np.where(inside, np.searchsorted(time, at), -1)
    else:
        time = np.asarray(first + grid * np.arange(math.floor((last - first) / grid + 1e-9) + 1))
        t = odometry[:, 0]
        after = np.searchsorted(t, time, side="left").clip(0, len(t) - 1)
        before = (np.searchsorted(t, time, side="right") - 1).clip(0)
        told = time[t[after] - t[before] <= MAX_HOLD]  # none in a gap
        odometry = np.column_stack([told, *(np.interp(told, t, values) for values in odometry[:, 1:].T)])
        nearest = np.rint((at - first) / grid).astype(np.int64)
        inside = (nearest >= 0) & (nearest < len(time))
        stale = inside & (time[nearest.clip(0, len(time) - 1)] - at > STALE)
        if stale.any():
            many = counted(int(stale.sum()), "observation")
            notes.append(f"{many} more than {STALE:g} s before their frame: dropped.")
        frame = np.where(inside & ~stale, nearest, -1)
    increments, gaps = preintegrate(motion, odometry[:, 0], odometry[:, 1], odometry[:, 2], time)
    if gaps:
        many = f"{counted(gaps, 'gap')} of more than {MAX_HOLD:g} s in the odometry"
        notes.append(f"{many}: the increments' covariance grows there.")
    return time, increments, frame.astype(np.int64), notes


SENSOR = RangeBearing(max_range=10.0, min_angle=-0.6, max_angle=0.6)
"""The camera; recordings have ranges up to 9.2 m and bearings up to 0.58 rad to either side."""
CORRECTED = "Landmark_Groundtruth.corrected.dat"  # Corrected landmarks, for a dataset whose own has rows exchanged


def robots(source: Path) -> list[int]:
    """Robots of a dataset (folder or zip) with odometry and measurements, ascending."""
    return open_files(Path(source)).robots()


def is_mrclam(source: Path) -> bool:
    """Whether a folder or zip holds an MRCLAM dataset with at least one robot."""
    source = Path(source)
    if not source.is_dir() and not (source.is_file() and zipfile.is_zipfile(source)):
        return False
    try:
        return bool(robots(source))
    except DataError:
        return False


def corrected_landmarks(source: Path) -> Path | None:
    """`Landmark_Groundtruth.corrected.dat` in or beside a dataset, if it has the same places."""
    source = Path(source)
    files = open_files(source)
    published = read_landmarks(files)
    for folder in (source, source.parent) if source.is_dir() else (source.parent,):
        path = folder / CORRECTED
        if path.is_file():
            found = read_landmarks(files, path)
            same_places = sorted(found.xy.tolist()) == sorted(published.xy.tolist())
            if same_places and found.id.tolist() == published.id.tolist():
                return path
    return None


@dataclass(frozen=True)
class Treatment:
    """Processing of a recording. Raises UsageError for an invalid value."""

    start: float | None = None  # start, stop: s, the wanted window (origin: see the module)
    stop: float | None = None
    landmarks: Path | None = None  # file instead of the dataset's Landmark_Groundtruth.dat
    exclude_truth: Sequence[tuple[float, float]] = ()  # stretches (from, to) [s] of bad truth, ends included
    grid: float | None = None  # s, resample to frames this far apart, as in the classic tutorials
    calibration: Calibration = FROZEN  # corrections and noise of odometry and camera
    prior_sigma: tuple[float, float] = (0.05, 0.05)  # (m, rad), standard deviations of position and heading at first

    def __post_init__(self) -> None:
        for name, value in (("start", self.start), ("stop", self.stop)):
            if value is not None and not math.isfinite(value):
                raise UsageError(f"{name} {value}: a number of seconds is needed")
        if self.start is not None and self.stop is not None and not self.start < self.stop:
            raise UsageError(f"stop {self.stop:g} s does not come after start {self.start:g} s")
        for begin, end in self.exclude_truth:
            if not begin < end:
                raise UsageError(f"exclude truth {begin:g}:{end:g}: the end must come after the start")
        if self.grid is not None and not 0.0 < self.grid <= MAX_GAP:
            raise UsageError(f"grid {self.grid:g} s: more than 0 and at most {MAX_GAP:g} s is needed")
        if not all(0.0 <= s < math.inf for s in self.prior_sigma):
            raise UsageError(f"prior sigma {self.prior_sigma}: numbers from 0 up are needed")

    def described(self) -> dict[str, object]:
        """Settings that differ from the default, for the log's source."""
        path, bad = self.landmarks, [list(map(float, s)) for s in self.exclude_truth]
        given = {
            "start": self.start, "stop": self.stop, "landmarks": path and path.name,
            "landmarks_sha256": path and file_sha256(path), "exclude_truth": bad or None, "grid": self.grid,
        }  # fmt: skip
        return {key: value for key, value in given.items() if value is not None}


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a robot recorded, corrected; times in s after `origin`, a Unix stamp."""

    robot: int
    origin: float
    odometry: Array  # odometry: (K, 3) instant, v, omega; truth: (G, 4) t, x, y, theta, or None
    truth: Array | None
    at: Array  # instants of observations (M,); z (M, 2); seen (M,): subjects, or `UNKNOWN_BARCODE`; barcode (M,)
    z: Array
    seen: IntArray
    barcode: Array
    first: float  # first, last: s, the window of the log; notes: about it
    last: float
    notes: tuple[str, ...]


def subjects_of(files: Files) -> dict[int, int]:
    """The subject of each barcode."""
    table = parse(files.path(BARCODES), files.content(BARCODES), ("subject", "barcode"))
    subject, barcode = (table.integers(name, 0) for name in ("subject", "barcode"))
    table.require_distinct("subject", subject, "{} is in two rows")
    table.require_distinct("barcode", barcode, "{} is in two rows")
    return dict(zip(barcode.tolist(), subject.tolist(), strict=True))


def read_robot(
    files: Files, robot: int, subjects: dict[int, int], treatment: Treatment, origin: float | None = None
) -> Recorded:
    """What one robot recorded; `origin`: of its times, None: its first ground-truth (or odometry) row."""
    calibration = treatment.calibration
    commands = _stamped(files, robot_file(robot, "Odometry"), ("forward velocity", "angular velocity")).all()
    table = _stamped(files, robot_file(robot, "Measurement"), ("barcode", "range", "bearing"))
    table.integers("barcode", 0)
    table.require(table.columns["range"] >= 0.0, "range", "{} is a negative range")
    measured, name = table.all(), robot_file(robot, "Groundtruth")
    rows = _stamped(files, name, ("x", "y", "orientation")).all() if name in files.names else None
    origin = float((commands if rows is None else rows)[0, 0]) if origin is None else origin
    velocities = calibration.velocities(commands[:, 1], commands[:, 2])
    odometry = np.column_stack([np.round(calibration.instants(_since(commands[:, 0], origin)), 6), *velocities])
    truth = None if rows is None else np.column_stack([_since(rows[:, 0], origin), rows[:, 1:]])
    first, last, notes = _window(files.path(robot_file(robot, "Odometry")), odometry[:, 0], truth, treatment)
    seen_at, z = _since(measured[:, 0], origin, -calibration.latency), calibration.readings(measured[:, 2:])
    seen = np.array([subjects.get(int(b), UNKNOWN_BARCODE) for b in measured[:, 1]], np.int64)
    return Recorded(robot, origin, odometry, truth, seen_at, z, seen, measured[:, 1], first, last, tuple(notes))


def load_mrclam(source: Path, robot: int, treatment: Treatment = Treatment()) -> Log:
    """The log of one robot (1 to 5); `source` is the published zip, a folder with its files, or its parent.

    Barcodes are sensed labels. The log starts at the first instant with truth and odometry, with the true pose as prior
    mean, and ends with the odometry. Without ground truth the prior is the zero pose and the map is withheld.

    Raises DataError for missing or invalid files, or nothing in the window.
    """
    files = open_files(Path(source))
    survey = read_landmarks(files, treatment.landmarks)
    return robot_log(Path(source), files, survey, read_robot(files, robot, subjects_of(files), treatment), treatment)


def robot_log(
    source: Path, files: Files, survey: LandmarkMap, given: Recorded, treatment: Treatment, also: Array | None = None
) -> Log:
    """The log of what a robot recorded; `also` (Q,): further instants [s] of frames."""
    calibration, robot, truth, odometry = treatment.calibration, given.robot, given.truth, given.odometry
    lost, said = dropped(given.at, given.barcode, given.seen, survey, odometry)
    notes = [*given.notes, *said]
    seen_at, z, seen = given.at[~lost], given.z[~lost], given.seen[~lost]
    at = seen_at if also is None else np.concatenate([seen_at, also])
    time, increments, frame, said = lay_out(at, odometry, given.first, given.last, treatment.grid, calibration.motion)
    frame = frame[: len(seen_at)]
    notes += said
    frame, z, seen = frame[frame >= 0], z[frame >= 0], seen[frame >= 0]
    pose, prior = None, Prior(np.zeros(3), np.diag(np.square(treatment.prior_sigma)[[0, 0, 1]]))
    if truth is not None:
        pose = _true_at(truth, treatment, time)
        prior = replace(prior, mean=pose[0])
        ignored = treatment.exclude_truth
        notes += [f"Ground truth ignored from {a:g} to {b:g} s after its first row." for a, b in ignored]
    else:
        notes.append(
            "No ground truth: the log starts at the zero pose, its frame is the robot's own, and the map is withheld."
        )
    covariance, floored = floor_covariances(increments.covariance, FLOOR)
    recorded = Inputs(
        prior=prior, time=time - time[0], increments=Increments(increments.mean, covariance),
        observations=Observations(frame, z, calibration.noise(z)), sensor=SENSOR,
        map=None if truth is None else survey, covariance_floor=FLOOR, floored=floored,
    )  # fmt: skip
    provenance = {
        "kind": "mrclam", "file": source.absolute().name, "dataset": files.name, "robot": robot,
        "first_stamp": round(given.origin + float(time[0]), 6), "clock": round(float(time[0]), 6),
        **treatment.described(),
        "calibration": asdict(calibration), "sha256": dict(sorted(files.sha256.items())),
    }  # fmt: skip
    return Log(
        name=f"{files.name.lower().replace('_dataset', '')}-robot{robot}", recorded=recorded,
        truth=Truth(pose, recorded.map, seen), labels_are_sensed=True, source=provenance, notes=tuple(notes),
        origins={
            "odometry_noise": _origin(calibration, "motion"),
            "observation_noise": _origin(calibration, "sigma_range", "sigma_range_growth", "sigma_bearing"),
            "prior": Origin.ASSUMED if treatment.prior_sigma == Treatment.prior_sigma else Origin.GIVEN,
        },
    )  # fmt: skip


def _origin(calibration: Calibration, *names: str) -> Origin:
    """Of the numbers with these names: measured once, or none corrected, or changed by flags."""
    kinds = ((FROZEN, Origin.INFERRED), (Calibration(), Origin.ASSUMED))
    same = (origin for known, origin in kinds if all(getattr(calibration, n) == getattr(known, n) for n in names))
    return next(same, Origin.GIVEN)


def _true_at(truth: Array, treatment: Treatment, instants: Array) -> Array:
    """Poses (N, 3) by stamped ones (K, 4), NaN where unknown or bad."""
    pose = truth_at(truth[:, 0], truth[:, 1:], instants)
    for begin, end in treatment.exclude_truth:
        pose[(instants >= begin) & (instants <= end)] = np.nan
    return pose


def _since(stamps: Array, origin: float, shift: float = 0.0) -> Array:
    """Seconds after `origin`, moved by `shift`, rounded to microseconds, the precision of large stamps."""
    return np.asarray(np.round(stamps - origin + shift, 6))


def _window(path: str, odometry: Array, truth: Array | None, treatment: Treatment) -> tuple[float, float, list[str]]:
    """First and last instant of the log, and a note about what precedes the first; odometry: its instants (K,)."""
    start, stop = treatment.start, treatment.stop
    begin, last = float(odometry[0]), float(odometry[-1]) if stop is None else min(stop, float(odometry[-1]))
    first, why = begin, "the odometry starts there"
    if truth is not None and truth[0, 0] > first:
        first, why = float(truth[0, 0]), "the ground truth starts there"
    if start is not None and start > first:
        first, why = start, "asked for"
    if truth is not None:
        instants = np.append(first, truth[truth[:, 0] > first, 0])
        known = np.isfinite(_true_at(truth, treatment, instants)[:, 2])
        if not known.any():
            window = f" from {first:g} s on" if start else ""
            raise DataError.at(path, f"no instant with both odometry and ground truth{window}")
        if not known[0]:
            first, why = float(instants[np.argmax(known)]), "the first instant with truth"
    if not first < last:
        raise DataError.at(path, f"nothing between {first:g} s (the first instant of the log) and {last:g} s")
    row = "odometry" if truth is None else "ground-truth"
    if first > 0.0 and (truth is not None or first == start):
        return first, last, [f"Skipped the first {first:.3f} s after the first {row} row ({why})."]
    if begin < first:
        return first, last, [f"Skipped {first - begin:.3f} s of odometry ({why})."]
    return first, last, []

"""A recording in the university lab's format, read and written: configuration, log, and reference images.

    my_recording/
      config.mat           camera_to_body, landmark, pose_init (cm, degrees)
      log.mat|.npy|.npz    timestamp [s], commands [m/s, rad/s], rgb, xyz [mm] per frame; see below
      landmark/            a reference image for each row of landmark.xpos, in the order of their names

The two files are recognized by content, not by name; one file may hold both. Both may be in NumPy's forms, or pickles.

Logs of the lab's format as records, one per frame, in NumPy's files, Python's objects and MATLAB's structs.

Arrays are read one record at a time, by plain reads: a memory map would fill the memory. Objects and MATLAB's files are
read whole.
"""

import hashlib
import io
import math
import os
import pickle
import re
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from data.columns.scans import BROKEN, open_archive
from data.csv_table import bytes_of
from data.digest import file_sha256
from data.errors import LARGEST, DataError, UsageError
from data.formats import matlab
from data.formats.matlab import LIMIT, kind_of, save
from data.inputs import Prior
from data.pictures import CORNERS, VisualFrame, VisualRecording, VisualSetup
from data.se2 import Array, rotation, wrap_angle
from data.whole import whole_folder

FIELDS = ("timestamp", "commands", "rgb", "xyz")
NEEDS_TRUST = (
    "holds Python objects (a pickle), which can run code when loaded; save plain arrays, "
    "or add --trust-pickle if you trust the file's author"
)
UNPICKLING = (pickle.UnpicklingError, ImportError, AttributeError, IndexError, *BROKEN)  # No loadable pickle
SMALL = 2  # most dimensions of arrays that are read whole (timestamps and commands)
FRAME_FIRST, FIELD_FIRST = "[{frame}][{field!r}]", "[{field!r}][{frame}]"


@dataclass(frozen=True, eq=False)
class LogFile:
    """A file with a record per frame."""

    path: Path
    fields: tuple[str, ...]  # of a record
    count: int  # number of frames
    place: str  # form of a frame's field in the notation of the file's language, for messages
    records: Callable[[], Iterable[Mapping[str, Any]]]  # values by field, in the order of the frames


class Place(NamedTuple):
    """A value of a file, read as numbers; errors name it."""

    path: Path
    name: str

    def error(self, what: str) -> DataError:
        """The error of this value."""
        return DataError.at(self.path, f"{self.name}: {what}")

    def array(self, value: Any) -> NDArray[Any]:
        """Real numbers. Raises DataError for anything else."""
        value = unwrapped(value)
        if not isinstance(value, Mapping):
            try:
                value = np.asarray(value.tolist() if isinstance(value, np.ndarray) and value.dtype.hasobject else value)
            except ValueError as error:
                raise self.error(str(error)) from error
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
            raise self.error(f"{matlab.kind_of(value)}; numbers are needed")
        return value

    def finite(self, value: Any, count: int | None = None) -> Array:
        """Finite numbers in their shape, or `count` of them (count,) as a row or a column."""
        array = self.array(value)
        if count is not None and array.size != count:
            needed = "one number is" if count == 1 else f"{count} numbers are"
            raise self.error(f"size {size_of(array)}; {needed} needed")
        result: Array = array.astype(float)
        wrong = np.argwhere(~(np.abs(result) <= LARGEST))
        if len(wrong):
            number, at = result[tuple(wrong[0])], ",".join(str(k + 1) for k in wrong[0])
            where = f" (element {at})" if result.size > 1 else ""
            raise self.error(f"{number:g} is not a number between -1e15 and 1e15{where}")
        return result if count is None else result.ravel()


def size_of(value: NDArray[Any]) -> str:
    """The shape of an array as MATLAB writes it."""
    return "x".join(map(str, value.shape)) or "1"


def unwrapped(value: object) -> object:
    """The content of an array of one object or record, however deep; a record becomes a dict."""
    while isinstance(value, np.ndarray) and value.size == 1 and (value.dtype.hasobject or value.dtype.names):
        value = value.ravel()[0]
    if isinstance(value, np.void) and value.dtype.names:
        return {name: value[name] for name in value.dtype.names}
    return value


def load_objects(path: Path, *, trust: bool = True) -> object:
    """What a `.npy` or `.pkl` holds, unwrapped; with `trust` it may run code. Raises DataError if damaged."""
    with reading(path, *((UNPICKLING, "the pickle cannot be loaded") if trust else ())), path.open("rb") as file:
        return unwrapped(np.load(file, allow_pickle=trust) if path.suffix.lower() == ".npy" else pickle.load(file))


def mat_log(path: Path, name: str, variable: matlab.Variable) -> LogFile:
    """A MATLAB struct array, one element per frame, read whole when its frames are asked for."""

    def load() -> matlab.Value:
        return matlab.load(path, [name])[name]

    def records() -> Sequence[Mapping[str, Any]]:
        value = load()
        return value if isinstance(value, list) else [value]  # type: ignore[list-item]

    if not variable.fields:
        right = "a struct array, one element per frame, is needed"
        raise DataError.at(path, f"{name} is of kind {matlab.kind_of(load())}; {right}")
    return LogFile(path, variable.fields, variable.size, name + "({number}).{field}", records)


def object_log(path: Path, content: object) -> LogFile:
    """A list of dicts or records, one per frame, a dict of arrays, a row per frame, or one frame; either may lie in
    object arrays (N, 1) or (1, N), as `scipy.io.loadmat` returns. DataError for another shape.
    """
    # a recording of one frame has a number for its time
    if isinstance(content, Mapping) and np.ndim(content.get(FIELDS[0], 0)) > 0:
        frames = _frames_of_columns(path, content)
        return LogFile(path, tuple(frames[0]) if frames else (), len(frames), FIELD_FIRST, lambda: frames)
    if isinstance(content, np.ndarray):
        content = list(content.ravel())
    elif isinstance(content, Mapping):
        content = [content]
    if not isinstance(content, list | tuple):
        what = f"holds one {type(content).__name__}; a list of dicts, one per frame, or a dict of arrays is needed"
        raise DataError.at(path, what)
    items = []
    for i, item in enumerate(map(unwrapped, content)):
        if not isinstance(item, Mapping):
            raise DataError.at(path, f"[{i}]: a {type(item).__name__}; a dict of the frame's fields is needed")
        items.append(item)
    return LogFile(path, tuple(items[0]) if items else (), len(items), FRAME_FIRST, lambda: items)


def _frames_of_columns(path: Path, content: Mapping[str, Any]) -> list[dict[str, Any]]:
    columns = {name: _flat(content[name]) for name in FIELDS if name in content}
    for name, column in columns.items():
        if not isinstance(column, Sequence | np.ndarray):
            raise DataError.at(path, f"{name}: a {type(column).__name__}; an array with a row per frame is needed")
    times = columns[FIELDS[0]]
    if isinstance(times, np.ndarray) and times.ndim == 2 and len(times) == 1:  # MATLAB's row
        columns[FIELDS[0]] = times.ravel()
    _one_length(path, {name: len(column) for name, column in columns.items()})
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _flat(column: Any) -> Any:
    """A column with a row per frame: object arrays (N, 1) and (1, N) are laid flat."""
    is_flat = isinstance(column, np.ndarray) and column.dtype.hasobject and column.ndim == 2 and 1 in column.shape
    return column.ravel() if is_flat else column


def _one_length(path: Path, lengths: Mapping[str, int]) -> int:
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise DataError.at(path, f"rows: {counts}; as many rows as frames are needed in each")
    return next(iter(lengths.values()), 0)


@contextmanager
def reading(path: Path, broken: tuple[type[Exception], ...] = BROKEN, what: str = "damaged") -> Iterator[None]:
    """Errors of damaged bytes become a DataError."""
    try:
        yield
    except broken as error:
        raise DataError.at(path, f"{what}: {' '.join(str(error).split())[:200] or type(error).__name__}") from error
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from error


class Layout(NamedTuple):
    """The header of an array."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran: bool


def layout_of(stream: IO[bytes]) -> Layout:
    """The header of an array; leaves the stream at its first value."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise ValueError(f"an array of format {version[0]}.{version[1]}; 1.0 and 2.0 are read")
    return Layout(dtype, shape, fortran)


def _rows(stream: IO[bytes], layout: Layout) -> Iterator[Any]:
    """The rows of an array after its header, one in memory at a time."""
    shape = layout.shape[1:]
    size = math.prod(shape) * layout.dtype.itemsize
    for i in range(layout.shape[0]):
        content = stream.read(size)
        if len(content) < size:
            raise EOFError(f"ends early: {layout.shape[0]} frames are announced and {i} are there")
        yield np.frombuffer(content, layout.dtype).reshape(shape)[()]


def npy_log(path: Path) -> LogFile:
    """A structured array (N,) with the fields of a frame."""
    with reading(path), path.open("rb") as file:
        layout, offset = layout_of(file), file.tell()
        size = path.stat().st_size - offset
    if layout.dtype.names is None or len(layout.shape) != 1:
        what = f"an array of {layout.dtype} and shape {layout.shape}"
        raise DataError.at(path, f"{what}; a structured array (N,) is needed")
    count, names = layout.shape[0], layout.dtype.names
    if size < count * layout.dtype.itemsize:
        announced = f"{count} frames of {layout.dtype.itemsize} bytes are announced"
        raise DataError.at(path, f"damaged: ends early: {announced} and {size} bytes are there")

    def records() -> Iterator[dict[str, Any]]:
        with reading(path), path.open("rb") as file:
            file.seek(offset)
            for row in _rows(file, layout):
                yield {name: row[name] for name in names}

    return LogFile(path, names, count, FRAME_FIRST, records)


def npz_log(path: Path, *, trust_pickle: bool) -> LogFile:
    """An archive of an array (N, ...) per field."""
    layouts: dict[str, Layout] = {}
    whole: dict[str, NDArray[Any]] = {}
    with reading(path), open_archive(path, whole=False) as archive:
        for name in (name for name in FIELDS if f"{name}.npy" in archive.namelist()):
            with archive.open(f"{name}.npy") as member:
                layout = layouts[name] = layout_of(member)
            objects = layout.dtype.hasobject
            if objects and not trust_pickle:
                raise DataError.at(path, f"{name} {NEEDS_TRUST}")
            if not layout.shape:
                raise DataError.at(path, f"{name}: a single value; one row per frame is needed")
            if objects or (layout.fortran and len(layout.shape) <= SMALL):
                with np.load(path, allow_pickle=objects) as arrays:
                    whole[name] = _flat(arrays[name])
            elif layout.fortran:
                what = "frames are not contiguous in Fortran order; save numpy.ascontiguousarray of it"
                raise DataError.at(path, f"{name}: {what}")
    count = _one_length(path, {n: len(whole[n]) if n in whole else layout.shape[0] for n, layout in layouts.items()})

    def records() -> Iterator[dict[str, Any]]:
        with ExitStack() as stack:
            stack.enter_context(reading(path))
            archive = stack.enter_context(open_archive(path, whole=False))
            streams: list[Iterator[Any]] = []
            for name in layouts:
                if name in whole:
                    streams.append(iter(whole[name]))
                    continue
                member = stack.enter_context(archive.open(f"{name}.npy"))
                streams.append(_rows(member, layout_of(member)))
            for row in zip(*streams, strict=True):
                yield dict(zip(layouts, row, strict=True))

    return LogFile(path, tuple(layouts), count, "{field}[{frame}]", records)


REFERENCES = "landmark"  # folder of the reference images, one per row of the map
CM = 0.01  # m; the unit of map and prior, and T's default
TRANSLATION_UNITS = {"cm": CM, "mm": 0.001, "m": 1.0}
READINGS = ("to-camera", "to-body")
PARTS = {
    "camera_to_body": ("R", "T"), "landmark": ("xpos", "ypos"),
    "pose_init": ("x0", "y0", "theta0", "sigma_x", "sigma_y", "sigma_theta"),
}  # fmt: skip
"""Structs of the file and their fields."""
ORTHOGONAL = 1e-3  # largest deviation of R R' from the identity, for matrices typed with four digits


def read_configuration(path: Path, values: Mapping[str, object], *, translation_unit: str, reading: str) -> VisualSetup:
    """The setup from the structs of a file, or their fields alone; its corners have a row for each picture of the map.

    `reading`: "to-camera" if R and T are those of p_c = R p_b + T (the lab's formula); "to-body" if they are those of
    p_b = R p_c + T (as the name camera_to_body says).
    Raises DataError for missing or invalid fields, UsageError for an unknown unit or reading.
    """
    if translation_unit not in TRANSLATION_UNITS:
        raise UsageError(f"unit of T {translation_unit!r}; known: {', '.join(TRANSLATION_UNITS)}")
    if reading not in READINGS:
        raise UsageError(f"reading of camera_to_body {reading!r}; known: {', '.join(READINGS)}")
    fields = _fields(path, values)
    rotation_in_file = Place(path, "camera_to_body.R")
    R = rotation_in_file.finite(fields["R"])
    shown = str(R.tolist())
    if R.shape != (2, 2):
        raise rotation_in_file.error(f"size {size_of(R)}; a rotation matrix, 2x2, is needed")
    if np.abs(R @ R.T - np.eye(2)).max() > ORTHOGONAL:
        raise rotation_in_file.error(f"{shown} is no rotation; R R' = I is needed, as [[0, -1], [1, 0]]")
    if np.linalg.det(R) < 0:
        raise rotation_in_file.error(f"{shown} mirrors (det -1); a rotation as [[0, -1], [1, 0]] is needed")
    T = Place(path, "camera_to_body.T").finite(fields["T"], 2) * TRANSLATION_UNITS[translation_unit]
    if reading == "to-body":
        R, T = R.T, -R.T @ T
    # the nearest rotation of a rounded matrix
    angle, translation = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]), (float(T[0]), float(T[1]))
    pose = {n: float(Place(path, f"pose_init.{n}").finite(fields[n], 1)[0]) for n in PARTS["pose_init"]}
    sigma = np.array([pose["sigma_x"] * CM, pose["sigma_y"] * CM, math.radians(pose["sigma_theta"])])
    for name, value in zip(PARTS["pose_init"][3:], sigma, strict=True):
        if value < 0:
            raise DataError.at(path, f"pose_init.{name}: {pose[name]:g}; a standard deviation is not negative")
    mean = np.array([pose["x0"] * CM, pose["y0"] * CM, wrap_angle(math.radians(pose["theta0"]))])
    return VisualSetup(angle, translation, _corners(path, fields) * CM, Prior(mean, np.diag(sigma**2)))


def _fields(path: Path, values: Mapping[str, object]) -> dict[str, object]:
    """The fields of all structs, which have different names."""
    found: dict[str, object] = {}
    for part, needed in PARTS.items():
        inside = values.get(part, {field: values[field] for field in needed if field in values})
        if not isinstance(inside, Mapping):
            what = f"{kind_of(inside)} of size {size_of(np.asarray(inside))}"
            raise DataError.at(path, f"{part}: {what}; one struct is needed")
        if not inside:
            raise DataError.at(path, f"no struct {part}; {', '.join(PARTS)} are needed")
        for name in needed:
            if name not in inside:
                raise DataError.at(path, f"{part}: no field {name}; {', '.join(needed)} are needed")
        found |= {field: inside[field] for field in needed}
    return found


def _corners(path: Path, fields: Mapping[str, object]) -> Array:
    """Corners (L, 4, 2) of the map in the file's unit."""
    both: list[Array] = []
    for name in PARTS["landmark"]:
        place = Place(path, f"landmark.{name}")
        value = place.finite(fields[name])
        if value.ndim != 2 or value.shape[1] != CORNERS or not len(value):
            raise place.error(f"size {size_of(value)}; a row of 4 corners per picture is needed")
        if both and both[0].shape != value.shape:
            raise place.error(f"size {size_of(value)}, but xpos has size {size_of(both[0])}; the same is needed")
        both.append(value)
    corners = np.stack(both, axis=-1)
    for i, picture in enumerate(corners, start=1):
        if np.array_equal(picture[0], picture[1]):
            what = "a picture without width; corners run upper left, upper right, lower right, lower left"
            raise DataError.at(path, f"landmark.xpos({i},:), ypos({i},:): {what}")
    return corners


def configuration(setup: VisualSetup) -> dict[str, dict[str, Any]]:
    """The setup as the file's structs, p_c = R p_b + T with T in cm; DataError for a correlated prior."""
    P = setup.prior.covariance
    if np.any(P - np.diag(np.diag(P))):
        raise DataError("the prior's covariance is not diagonal; the lab's format has standard deviations only")
    sigma, mean = np.sqrt(np.diag(P)), setup.prior.mean
    return {
        "camera_to_body": {"R": rotation(setup.rotation), "T": np.array(setup.translation)[:, None] / CM},
        "landmark": {"xpos": setup.corners[..., 0] / CM, "ypos": setup.corners[..., 1] / CM},
        "pose_init": {
            "x0": mean[0] / CM, "y0": mean[1] / CM, "theta0": math.degrees(mean[2]), "sigma_x": sigma[0] / CM,
            "sigma_y": sigma[1] / CM, "sigma_theta": math.degrees(sigma[2]),
        },
    }  # fmt: skip


T = TypeVar("T")
LOG_VARIABLE = "log"
ALONE = frozenset({"xpos", "ypos"})  # fields by which an archive of a configuration's fields is known
ALL = {*PARTS, *(field for fields in PARTS.values() for field in fields)}
Values = Mapping[str, object]


class Sources:
    """Files of a folder that look like a configuration or a log, and errors of those that do not open."""

    def __init__(self, folder: Path, *, trust_pickle: bool = False) -> None:
        """`trust_pickle`: load Python objects, which can run code; else files that hold them are faults."""
        self._folder, self._trust = folder, trust_pickle
        self.configurations: dict[str, Callable[[], Values]] = {}  # by the file's name; structs, or their fields alone
        self.logs: dict[str, Callable[[], LogFile]] = {}
        self.untrusted: list[Path] = []  # files of Python objects
        self._faults: list[DataError] = []
        self._names: list[str] = []
        look = {".mat": self._look_at_mat, ".npy": self._look_at_npy, ".npz": self._look_at_npz}
        look |= dict.fromkeys((".pkl", ".pickle"), self._look_at_objects)
        for path in sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")):
            self._names.append(path.name)
            try:
                look.get(path.suffix.lower(), lambda _: None)(path)
            except DataError as fault:
                self._faults.append(fault)

    def _look_at_mat(self, path: Path) -> None:
        inside = matlab.variables(path)
        if set(inside) & set(PARTS):
            self.configurations[path.name] = lambda: matlab.load(path, PARTS)
        for name, variable in inside.items():
            if name == LOG_VARIABLE or {"rgb", "xyz"} <= set(variable.fields):
                self.logs[f"{path.name}:{name}"] = lambda n=name, v=variable: mat_log(path, n, v)  # type: ignore[misc]

    def _look_at_npy(self, path: Path) -> None:
        with reading(path), path.open("rb") as file:
            dtype = layout_of(file).dtype
        if dtype.hasobject:
            self._look_at_objects(path)
        elif set(dtype.names or ()) & set(FIELDS):
            self.logs[path.name] = lambda: npy_log(path)
        elif set(dtype.names or ()) & set(PARTS):
            self.configurations[path.name] = lambda: _named(load_objects(path, trust=False))

    def _look_at_npz(self, path: Path) -> None:
        with reading(path), open_archive(path, whole=False) as archive:
            inside = {n.removesuffix(".npy") for n in archive.namelist() if n.endswith(".npy")}
        if inside & set(FIELDS):
            self.logs[path.name] = lambda: npz_log(path, trust_pickle=self._trust)
        if inside & set(PARTS) or inside >= ALONE:
            self.configurations[path.name] = lambda: self._values(path, inside & ALL)

    def _values(self, path: Path, names: set[str]) -> Values:
        """Arrays of an archive, unwrapped. Raises DataError if damaged, or if they are objects without trust."""
        with reading(path), open_archive(path, whole=True) as archive:
            for name in sorted(names):
                with archive.open(f"{name}.npy") as member:
                    if layout_of(member).dtype.hasobject and not self._trust:
                        raise DataError.at(path, f"{name} {NEEDS_TRUST}")
            with np.load(path, allow_pickle=self._trust) as arrays:
                return {name: unwrapped(arrays[name]) for name in names}

    def _look_at_objects(self, path: Path) -> None:
        if not self._trust:
            self.untrusted.append(path)
            raise DataError.at(path, NEEDS_TRUST)
        held = load_objects(path)
        values = _named(held)
        if values:
            self.configurations[path.name] = lambda: values
        log: object = None
        if isinstance(held, Mapping):
            log = held if set(FIELDS) & set(held) else unwrapped(held.get(LOG_VARIABLE))
        elif isinstance(held, Sequence | np.ndarray) and not isinstance(held, str | bytes):
            log = held
        if log is not None or not values:
            self.logs[path.name] = lambda: object_log(path, held if log is None else log)

    def the(self, what: str, candidates: Mapping[str, T], right: str) -> tuple[str, T]:
        """The only candidate and its name; else DataError, with `right` as remedy."""
        if len(candidates) == 1:
            return next(iter(candidates.items()))
        if candidates:
            raise DataError.at(self._folder, f"{', '.join(candidates)} each hold a {what}; one per folder is needed")
        if self._faults:  # a file that does not open is the most likely reason
            raise self._faults[0]
        names = ", ".join(self._names) or "no files"
        raise DataError.at(self._folder, f"no {what} found (there: {names}); {right} is needed")


def _named(value: object) -> Values:
    """The structs of a configuration and their fields in a dict or record, unwrapped."""
    return {n: unwrapped(v) for n, v in value.items() if n in ALL} if isinstance(value, Mapping) else {}


COMMANDS = ("v", "omega")
MM = np.float32(0.001)  # m; the unit of xyz
WHITE = 255.0


def write_lab(folder: Path, recording: VisualRecording, *, form: str = "mat") -> None:
    """Write config.mat, log.mat (or .npy, .npz) and landmark/NN.png into `folder`, which must be free or empty.

    Points in m become mm (float32), NaN becomes 0. `form` "mat": MATLAB 5, at most 2 GiB, all in memory; "npy": a
    structured array; "npz": an array per field, uncompressed, both with one frame in memory at a time.

    Raises DataError for a folder in use or not writable, inconsistent frames, a correlated prior, or a log that exceeds
    MATLAB 5; UsageError for an unknown form.
    """
    if form not in WRITERS:
        raise UsageError(f"form {form!r}; known: {', '.join(WRITERS)}")
    folder = Path(os.path.abspath(folder))
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise DataError.at(folder, "exists and is not an empty folder; name another one")
        with whole_folder(folder) as partial:
            (partial / REFERENCES).mkdir()
            save(partial / "config.mat", configuration(recording.setup))
            digits = max(2, len(str(len(recording.references))))
            for i, image in enumerate(recording.references, 1):
                Image.fromarray(image).save(partial / REFERENCES / f"{i:0{digits}}.png")
            WRITERS[form](partial / f"log.{form}", recording)
            if folder.exists():
                folder.rmdir()  # fails, as it should, if it was filled meanwhile
    except OSError as error:
        raise DataError.at(folder, f"cannot be written: {error.strerror}") from error


def _records(recording: VisualRecording) -> Iterator[dict[str, NDArray[Any]]]:
    """The frames in the file's units; their number and size are checked."""
    size, count = None, 0
    for frame in recording.frames():
        size = size or frame.rgb.shape
        if count == len(recording) or frame.rgb.shape != size or frame.xyz.shape != size:
            what = f"rgb {frame.rgb.shape} and xyz {frame.xyz.shape}; {len(recording)} frames of {size} are needed"
            raise DataError(f"frame {count} of the recording: {what}")
        xyz = np.asarray(frame.xyz, np.float32) / MM
        yield {
            "timestamp": np.array(frame.time, np.float64), "commands": np.array([frame.v, frame.omega], np.float64),
            "rgb": np.asarray(frame.rgb, np.uint8),
            "xyz": np.where(np.isfinite(xyz).all(axis=-1, keepdims=True), xyz, np.float32(0.0)),
        }  # fmt: skip
        count += 1
    if count < len(recording):
        raise DataError(f"the recording has {count} frames; the stated {len(recording)} are needed")


def _write_mat(path: Path, recording: VisualRecording) -> None:
    log = np.empty((1, len(recording)), [(name, object) for name in FIELDS])
    for i, record in enumerate(_records(recording)):
        size = sum(value.nbytes for value in record.values()) * len(recording)
        if size > LIMIT:
            what = f"{size / 2**30:.1f} GiB for {len(recording)} frames"
            raise DataError(f"{path.name}: {what}; a .mat holds 2 GiB, write npy or npz")
        for name in FIELDS:
            log[0, i][name] = record[name]
    save(path, {LOG_VARIABLE: log})


def _write_npy(path: Path, recording: VisualRecording) -> None:
    with path.open("wb") as file:
        for i, record in enumerate(_records(recording)):
            row = np.array(tuple(record.values()), [(name, v.dtype.str, v.shape) for name, v in record.items()])
            if not i:
                _write_header(file, row.dtype, (len(recording),))
            file.write(row.tobytes())


def _write_npz(path: Path, recording: VisualRecording) -> None:
    """Columns are written to files of their own first."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder, zipfile.ZipFile(path, "w") as archive:
        for i, record in enumerate(_records(recording)):
            for name, value in record.items():
                with open(f"{folder}/{name}.npy", "ab") as column:
                    if not i:
                        _write_header(column, value.dtype, (len(recording), *value.shape))
                    column.write(value.tobytes())
        for name in FIELDS if len(recording) else ():
            archive.write(f"{folder}/{name}.npy", f"{name}.npy")


def _write_header(file: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    descr = np.lib.format.dtype_to_descr(dtype)
    np.lib.format.write_array_header_1_0(file, {"descr": descr, "fortran_order": False, "shape": shape})


WRITERS: dict[str, Callable[[Path, VisualRecording], None]] = {"mat": _write_mat, "npy": _write_npy, "npz": _write_npz}


MOST_PIXELS = 5e7  # most pixels of a reference image
IMAGES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"})


@dataclass(eq=False)
class LabRecording:
    """A recording of the lab's format, its frames still on disk."""

    setup: VisualSetup
    references: list[NDArray[np.uint8]]
    path: Path  # the folder
    notes: tuple[str, ...]  # assumptions and ignored files
    _log: LogFile = field(repr=False)
    _files: tuple[Path, ...] = field(repr=False)

    def __len__(self) -> int:
        return self._log.count

    def frames(self) -> Iterator[VisualFrame]:
        """Every frame in order, one in memory at a time; DataError names a wrong frame and field."""
        return _frames(self._log)

    def digest(self) -> str:
        """SHA-256 of configuration, log and reference images, in their order."""
        total = hashlib.sha256()
        for path in self._files:
            with reading(path):
                total.update(bytes.fromhex(file_sha256(path)))
        return total.hexdigest()


def is_lab(folder: Path) -> bool:
    """Whether a folder seems to hold a recording of this format, perhaps a faulty one."""
    if not folder.is_dir():
        return False
    if (folder / REFERENCES).is_dir():
        return True
    found = Sources(folder)
    return bool(found.configurations or found.logs or any(p.suffix.lower() == ".npy" for p in found.untrusted))


def open_lab(
    folder: Path, *, translation_unit: str = "cm", reading: str = "to-camera", trust_pickle: bool = False
) -> LabRecording:
    """Open a recording; its configuration and reference images are read, its frames stay on disk.

    translation_unit: of camera_to_body.T, which the format does not state: "cm", "mm" or "m". reading: "to-camera": p_c
    = R p_b + T, the lab's formula; "to-body": p_b = R p_c + T, the name's meaning. trust_pickle: load files of Python
    objects, which can run code. DataError: a file, field or image is missing, ambiguous or wrong.
    """
    if not folder.is_dir():
        raise DataError.at(folder, "not a folder")
    found = Sources(folder, trust_pickle=trust_pickle)
    name, values = found.the("configuration", found.configurations, f"a .mat, .npy or .npz with {', '.join(PARTS)}")
    known = folder / name
    setup = read_configuration(known, values(), translation_unit=translation_unit, reading=reading)
    right = f"a .mat with the struct array {LOG_VARIABLE}, or a .npy or .npz, its fields"
    log = found.the("log", found.logs, right)[1]()
    for name in FIELDS:
        if name not in log.fields:
            raise DataError.at(log.path, f"the log has no {name}; {', '.join(FIELDS)} are needed")
    if not log.count:
        raise DataError.at(log.path, "the log has no frames; at least one is needed")
    images, others = _reference_files(folder / REFERENCES)
    if len(images) != len(setup.corners):
        names = ", ".join(p.name for p in images)
        what = f"{len(setup.corners)} rows, but {folder / REFERENCES} holds {len(images)} images ({names})"
        right = "a row per image is needed, in the order of their names"
        raise DataError.at(known, f"landmark.xpos: {what}; {right}")
    formula = "p_c = R p_b + T" if reading == "to-camera" else "p_b = R p_c + T"
    notes = [f"camera_to_body is read as {formula} with T in {translation_unit} (the format states neither)"]
    if others:
        notes.append(f"ignored in {REFERENCES}/, not images: {', '.join(others)}")
    files = (known, log.path, *images)
    return LabRecording(setup, [read_image(path) for path in images], folder, tuple(notes), log, files)


def _frames(log: LogFile) -> Iterator[VisualFrame]:
    """The frames in SI units: colours uint8, points [m], NaN without stereo. DataError names file, frame and field."""
    previous, seen, white = -np.inf, False, None
    first: NDArray[Any] | None = None
    for i, record in enumerate(log.records()):
        place = {n: Place(log.path, log.place.format(frame=i, number=i + 1, field=n)) for n in FIELDS}
        for name in FIELDS:
            if name not in record:
                raise place[name].error(f"missing; {', '.join(FIELDS)} are needed")
        time = float(place["timestamp"].finite(record["timestamp"], 1)[0])
        if time <= previous:
            raise place["timestamp"].error(f"{time!r} s follows {previous!r} s; it must increase")
        previous = time
        v, omega = _commands(place["commands"], record["commands"])
        rgb, xyz = (_image(place[name], record[name]) for name in ("rgb", "xyz"))
        first = rgb if first is None else first
        if rgb.shape != first.shape:
            said = f"size {size_of(rgb)}, but the first frame has {size_of(first)}; one size is needed"
            raise place["rgb"].error(said)
        if xyz.shape != rgb.shape:
            raise place["xyz"].error(f"size {size_of(xyz)}, but rgb has {size_of(rgb)}; a point per pixel is needed")
        # Points (H, W, 3) in m from mm, NaN where there is none.
        with np.errstate(over="ignore", invalid="ignore"):  # a NaN may be a signalling one
            points = np.ascontiguousarray(xyz, np.float32) * MM
        points[~np.isfinite(points).all(axis=-1) | ~points.any(axis=-1)] = np.nan
        seen = seen or not bool(np.isnan(points[..., 0]).all())
        if white is None and rgb.dtype.kind == "f" and rgb.max() > 0:  # the first frame that is not black tells
            white = 1.0 if rgb.max() <= 1 else WHITE
        yield VisualFrame(time, v, omega, _colours(place["rgb"], rgb, white), points)
    if not seen:
        right = "mm in the camera's frame, 0 or NaN where unknown"
        raise DataError.at(log.path, f"xyz: not one valid point in {log.count} frames; {right}")


def _commands(place: Place, value: Any) -> tuple[float, float]:
    """Commands v [m/s] and omega [rad/s], a pair or a struct."""
    value = unwrapped(value)
    if not isinstance(value, Mapping):
        v, omega = place.finite(value, 2)
        return float(v), float(omega)
    for name in COMMANDS:
        if name not in value:
            raise place.error(f"no field {name}; v [m/s] and omega [rad/s] are needed")
    v, omega = (Place(place.path, f"{place.name}.{name}").finite(value[name], 1)[0] for name in COMMANDS)
    return float(v), float(omega)


def _image(place: Place, value: Any) -> NDArray[Any]:
    array = place.array(value)
    if array.ndim != 3 or array.shape[-1] != 3 or not array.size:
        raise place.error(f"size {size_of(array)}; H x W x 3 is needed")
    return array


def _colours(place: Place, rgb: NDArray[Any], white: float | None) -> NDArray[np.uint8]:
    """Colours scaled to 0..255; fractions are of `white`, 1 or 255."""
    if rgb.dtype == np.uint8:
        return np.ascontiguousarray(rgb, np.uint8)
    low, high = float(rgb.min()), float(rgb.max())
    most = white or WHITE if rgb.dtype.kind == "f" else WHITE
    if not (low >= 0 and high <= most):
        wrong = low if not low >= 0 else high
        raise place.error(f"colour {wrong:g}; 0 to {most:g} is needed (as in the frames before)")
    return np.ascontiguousarray(np.rint(rgb * (WHITE / most)), np.uint8)


def _reference_files(folder: Path) -> tuple[list[Path], list[str]]:
    """Images of the folder in natural order (2 before 10), and the names of other files."""
    if not folder.is_dir():
        raise DataError.at(folder, "missing; a folder with one reference image per picture is needed")
    files = [p for p in folder.iterdir() if not p.name.startswith(".")]
    images = [p for p in files if p.is_file() and p.suffix.lower() in IMAGES]
    others = sorted(p.name for p in files if p not in images)

    def natural(name: str) -> list[tuple[int, str]]:
        parts = re.split(r"(\d+)", name.casefold())
        return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts if part]

    return sorted(images, key=lambda p: (natural(p.name), p.name)), others


def read_image(path: Path) -> NDArray[np.uint8]:
    """An image as RGB (H, W, 3); DataError for a file that is none, or states more than `MOST_PIXELS`."""
    import cv2

    content = bytes_of(path)
    try:
        with warnings.catch_warnings(action="error"), Image.open(io.BytesIO(content)) as image:
            width, height = image.size
    except (OSError, ValueError, SyntaxError, Warning, Image.DecompressionBombError):
        raise DataError.at(path, f"not an image that can be read, or one of more than {MOST_PIXELS:g} pixels") from None
    if width * height > MOST_PIXELS:
        raise DataError.at(path, f"{width} x {height} pixels; at most {MOST_PIXELS:g} are read")
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise DataError.at(path, "not an image that can be read")
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), np.uint8)

"""Logs of the lab's format as records, one per frame, in NumPy's files, Python's objects and MATLAB's structs.

Arrays are read one record at a time, by plain reads: a memory map would fill the memory. Objects and MATLAB's files are
read whole.
"""

import math
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data.columns.scans import BROKEN, open_archive
from data.errors import LARGEST, DataError
from data.formats import matlab
from data.se2 import Array

FIELDS = ("timestamp", "commands", "rgb", "xyz")
NEEDS_TRUST = (
    "holds Python objects (a pickle), which can run code when loaded; save plain arrays, "
    "or add --trust-pickle if you trust the file's author"
)
UNPICKLING = (pickle.UnpicklingError, ImportError, AttributeError, IndexError, *BROKEN)
"""Errors of a pickle that cannot be loaded."""
SMALL = 2  # most dimensions of arrays that are read whole (timestamps and commands)


FRAME_FIRST, FIELD_FIRST = "[{frame}][{field!r}]", "[{field!r}][{frame}]"


@dataclass(frozen=True, eq=False)
class LogFile:
    """A file with a record per frame.

    Attributes:
        fields: of a record.
        count: number of frames.
        place: form of a frame's field in the notation of the file's language, for messages.
        records: values by field, in the order of the frames.
    """

    path: Path
    fields: tuple[str, ...]
    count: int
    place: str
    records: Callable[[], Iterable[Mapping[str, Any]]]


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


# --- objects ----------------------------------------------------------------------------------------------------------


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
    """A list of dicts or records, one per frame; or a dict of arrays, a row per frame; or one frame.

    Either may lie in object arrays (N, 1) or (1, N), as `scipy.io.loadmat` returns MATLAB's struct arrays. Raises
    DataError for another shape.
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
    """The length that all columns have."""
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise DataError.at(path, f"rows: {counts}; as many rows as frames are needed in each")
    return next(iter(lengths.values()), 0)


# --- arrays -----------------------------------------------------------------------------------------------------------


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

"""The frames of a lab recording: records of any of its file formats, checked and converted to SI units one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from data.errors import LARGEST, DataError
from data.formats.lab.matlab import Struct, Unread, Variable, elements
from data.pictures import VisualFrame

FIELDS = ("timestamp", "commands", "rgb", "xyz")
COMMANDS = ("v", "omega")
MM = np.float32(0.001)
"""m; the unit of xyz."""
WHITE = 255


class LogFile(Protocol):
    """A file with a record per frame."""

    path: Path
    fields: tuple[str, ...]

    def __len__(self) -> int:
        """Number of frames."""

    def place(self, frame: int, field: str) -> str:
        """A frame's field in the notation of the file's language, for messages."""

    def records(self) -> Iterator[Mapping[str, Any]]:
        """Values by field, one frame in memory at a time."""


class MatLog:
    """A MATLAB struct array log(i)."""

    def __init__(self, variable: Variable) -> None:
        self.path, self.fields, self._variable = variable.path, variable.fields, variable
        if variable.kind != "struct":
            right = "a struct array, one element per frame, is needed"
            raise DataError.at(self.path, f"{variable.name} is of kind {variable.kind}; {right}")

    def __len__(self) -> int:
        return len(self._variable)

    def place(self, frame: int, field: str) -> str:
        """Counting from 1."""
        return f"{self._variable.name}({frame + 1}).{field}"

    def records(self) -> Iterator[Mapping[str, Any]]:
        """The elements' fields by name."""
        return elements(self._variable, FIELDS)


def check_fields(log: LogFile) -> None:
    """Raise DataError unless the log has frames with all their fields."""
    for field in FIELDS:
        if field not in log.fields:
            raise DataError.at(log.path, f"the log has no {field}; {', '.join(FIELDS)} are needed")
    if not len(log):
        raise DataError.at(log.path, "the log has no frames; at least one is needed")


def frames(log: LogFile) -> Iterator[VisualFrame]:
    """The frames of a log in SI units: colours uint8, points [m] with NaN where stereo found none.

    A pixel without a point has three zeros or a coordinate that is not finite. DataError names file, frame and field of
    a missing or invalid value, or a log without any point.
    """
    previous, size, seen = -np.inf, None, False
    colours = _Colours()
    for i, record in enumerate(log.records()):
        place = _Place(log, i)
        for field in FIELDS:
            if field not in record:
                raise place.error(field, f"missing; {', '.join(FIELDS)} are needed")
        time = float(place.numbers("timestamp", record["timestamp"], 1)[0])
        if time <= previous:
            raise place.error("timestamp", f"{time!r} s follows {previous!r} s; it must increase")
        previous = time
        v, omega = place.commands(record["commands"])
        rgb, xyz = place.image("rgb", record["rgb"]), place.image("xyz", record["xyz"])
        size = size or rgb.shape
        if rgb.shape != size:
            raise place.error("rgb", f"size {_size(rgb)}, but the first frame has {_size(size)}; one size is needed")
        if xyz.shape != size:
            raise place.error("xyz", f"size {_size(xyz)}, but rgb has {_size(size)}; a point per pixel is needed")
        points = _points(xyz)
        seen = seen or not bool(np.isnan(points[..., 0]).all())
        yield VisualFrame(time, v, omega, colours.bytes(place, rgb), points)
    if not seen:
        right = "mm in the camera's frame, 0 or NaN where unknown"
        raise DataError.at(log.path, f"xyz: not one valid point in {len(log)} frames; {right}")


class _Place:
    """A frame of a log: reads its values, and names the place of a wrong one."""

    def __init__(self, log: LogFile, frame: int) -> None:
        self._log, self._frame = log, frame

    def error(self, field: str, what: str) -> DataError:
        return DataError.at(self._log.path, f"{self._log.place(self._frame, field)}: {what}")

    def array(self, field: str, value: Any) -> NDArray[Any]:
        """A value of real numbers."""
        kind = "a struct" if isinstance(value, Struct | Mapping) else value.kind if isinstance(value, Unread) else None
        if kind is None and (array := np.asarray(value)).dtype.kind in "fiu":
            return array
        raise self.error(field, f"{kind or f'of type {array.dtype}'}; numbers are needed")

    def numbers(self, field: str, value: Any, count: int) -> NDArray[np.float64]:
        """`count` finite numbers (count,), as a row or a column."""
        array = self.array(field, value)
        if array.size != count:
            needed = "one number is" if count == 1 else f"{count} numbers are"
            raise self.error(field, f"size {_size(array)}; {needed} needed in each frame")
        result: NDArray[np.float64] = array.astype(float).ravel()
        for number in result:
            if not abs(number) <= LARGEST:
                raise self.error(field, f"{number:g} is not a number between -1e15 and 1e15")
        return result

    def commands(self, value: Any) -> tuple[float, float]:
        """Commands v [m/s] and omega [rad/s], a pair or a struct."""
        if isinstance(value, Struct) and len(value.elements) == 1:
            value = value.elements[0]
        if isinstance(value, np.ndarray | np.void) and value.dtype.names:
            value = {name: value[name] for name in value.dtype.names}
        if not isinstance(value, Mapping):
            v, omega = self.numbers("commands", value, 2)
            return float(v), float(omega)
        for name in COMMANDS:
            if name not in value:
                raise self.error("commands", f"no field {name}; v [m/s] and omega [rad/s] are needed")
        v, omega = (float(self.numbers(f"commands.{name}", value[name], 1)[0]) for name in COMMANDS)
        return v, omega

    def image(self, field: str, value: Any) -> NDArray[Any]:
        """An array (H, W, 3)."""
        array = self.array(field, value)
        if array.ndim != 3 or array.shape[-1] != 3 or not array.size:
            raise self.error(field, f"size {_size(array)}; H x W x 3 is needed")
        return array


class _Colours:
    """Scales colours to 0..255; the first frame that is not black shows whether fractions are of 1 or of 255."""

    def __init__(self) -> None:
        self._white: float | None = None

    def bytes(self, place: _Place, rgb: NDArray[Any]) -> NDArray[np.uint8]:
        if rgb.dtype == np.uint8:
            return np.ascontiguousarray(rgb, np.uint8)
        low, high = float(rgb.min()), float(rgb.max())
        fractions = rgb.dtype.kind == "f"
        if self._white is None and fractions and high > 0:
            self._white = 1.0 if high <= 1 else WHITE
        white = (self._white or WHITE) if fractions else WHITE
        if not (low >= 0 and high <= white):
            wrong = low if not low >= 0 else high
            raise place.error("rgb", f"colour {wrong:g}; 0 to {white:g} is needed (as in the frames before)")
        return np.ascontiguousarray(np.rint(rgb * (WHITE / white)), np.uint8)


def _points(xyz: NDArray[Any]) -> NDArray[np.float32]:
    """Points (H, W, 3) in m from mm, NaN where there is none."""
    with np.errstate(over="ignore", invalid="ignore"):  # a NaN may be a signalling one
        points = np.ascontiguousarray(xyz, np.float32) * MM
    points[~np.isfinite(points).all(axis=-1) | ~points.any(axis=-1)] = np.nan
    return points


def _size(value: NDArray[Any] | tuple[int, ...]) -> str:
    shape = value if isinstance(value, tuple) else value.shape
    return "x".join(map(str, shape)) or "1"

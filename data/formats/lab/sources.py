"""Which file of a lab folder is the configuration and which the log: told by content, not by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from data.columns.scans import open_archive
from data.errors import DataError
from data.formats.lab import matlab
from data.formats.lab.configuration import PARTS
from data.formats.lab.records import (
    FIELDS,
    NEEDS_TRUST,
    LogFile,
    layout_of,
    load_objects,
    mat_log,
    npy_log,
    npz_log,
    object_log,
    reading,
    unwrapped,
)

T = TypeVar("T")
LOG_VARIABLE = "log"
ALONE = frozenset({"xpos", "ypos"})
"""Fields by which an archive of a configuration's fields is known."""
ALL = {*PARTS, *(field for fields in PARTS.values() for field in fields)}
Values = Mapping[str, object]


class Sources:
    """Files of a folder that look like a configuration or a log, and errors of those that do not open.

    Attributes:
        configurations: how to read the structs of each, or their fields alone; by the file's name.
        logs: how to open each log.
        untrusted: files of Python objects.
    """

    def __init__(self, folder: Path, *, trust_pickle: bool = False) -> None:
        """`trust_pickle`: load Python objects, which can run code; else files that hold them are faults."""
        self._folder, self._trust = folder, trust_pickle
        self.configurations: dict[str, Callable[[], Values]] = {}
        self.logs: dict[str, Callable[[], LogFile]] = {}
        self.untrusted: list[Path] = []
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
            self.configurations[path.name] = lambda: _named(load_plain(path))

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
        # a file that does not open is the most likely reason
        if self._faults:
            raise self._faults[0]
        names = ", ".join(self._names) or "no files"
        raise DataError.at(self._folder, f"no {what} found (there: {names}); {right} is needed")


def load_plain(path: Path) -> object:
    """An array that holds no objects, unwrapped. Raises DataError if damaged."""
    with reading(path):
        return unwrapped(np.load(path, allow_pickle=False))


def _named(value: object) -> Values:
    """The structs of a configuration and their fields in a dict or record, unwrapped."""
    return {n: unwrapped(v) for n, v in value.items() if n in ALL} if isinstance(value, Mapping) else {}

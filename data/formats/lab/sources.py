"""Which file of a lab folder is the configuration and which the log: told by content, not by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple, TypeVar

from data.errors import DataError
from data.formats.lab.configuration import PARTS, Parts, parts_by_name, parts_of, struct_of
from data.formats.lab.frames import FIELDS, LogFile, MatLog
from data.formats.lab.hdf5 import Hdf5Log, read73, variables73
from data.formats.lab.matlab import is_hdf5, variables
from data.formats.lab.numpy_files import NpyLog, NpzLog, npy_fields, npy_value, npz_arrays, npz_values
from data.formats.lab.objects import NEEDS_TRUST, ObjectLog, load_objects, log_in, named_parts

T = TypeVar("T")
LOG_VARIABLE = "log"
PICKLES = frozenset({".pkl", ".pickle"})
ALONE = frozenset({"xpos", "ypos"})
"""Fields by which an archive of a configuration's fields is known."""


class Known(NamedTuple):
    """A file that holds a configuration, and how to read its structs."""

    path: Path
    parts: Callable[[], Parts]


class Sources:
    """Files of a folder that look like a configuration or a log, and errors of those that do not open."""

    def __init__(self, folder: Path, *, trust_pickle: bool = False) -> None:
        """`trust_pickle`: load Python objects, which can run code; else files that hold them are faults."""
        self._folder, self._trust = folder, trust_pickle
        self.configurations: dict[str, Known] = {}
        self.logs: dict[str, Callable[[], LogFile]] = {}
        self.untrusted: list[Path] = []
        self._faults: list[DataError] = []
        self._names: list[str] = []
        for path in sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")):
            self._names.append(path.name)
            try:
                self._look(path)
            except DataError as fault:
                self._faults.append(fault)

    def _look(self, path: Path) -> None:
        suffix = path.suffix.lower()
        if suffix == ".mat":
            self._look_at_hdf5(path) if is_hdf5(path) else self._look_at_mat(path)
        elif suffix == ".npy":
            self._look_at_npy(path)
        elif suffix == ".npz":
            self._look_at_npz(path)
        elif suffix in PICKLES:
            self._look_at_objects(path)

    def _look_at_mat(self, path: Path) -> None:
        inside = variables(path)
        if any(v.name in PARTS for v in inside):
            self.configurations[path.name] = Known(path, lambda: parts_of(inside))
        for variable in inside:
            if variable.name == LOG_VARIABLE or {"rgb", "xyz"} <= set(variable.fields):
                self.logs[f"{path.name}:{variable.name}"] = lambda variable=variable: MatLog(variable)  # type: ignore[misc]

    def _look_at_hdf5(self, path: Path) -> None:
        inside = variables73(path)
        parts = [v for v in inside if v.name in PARTS]
        if parts:
            self.configurations[path.name] = Known(
                path,
                lambda: {v.name: struct_of(path, v.name, read73(path, v.name), v.kind, str(v.elements)) for v in parts},
            )
        for variable in inside:
            if variable.name == LOG_VARIABLE or {"rgb", "xyz"} <= set(variable.fields):
                self.logs[f"{path.name}:{variable.name}"] = lambda variable=variable: Hdf5Log(variable)  # type: ignore[misc]

    def _look_at_npy(self, path: Path) -> None:
        fields = npy_fields(path)
        if fields is None:
            self._look_at_objects(path)
        elif set(fields) & set(FIELDS):
            self.logs[path.name] = lambda: NpyLog(path)
        elif set(fields) & set(PARTS):
            self.configurations[path.name] = Known(path, lambda: parts_by_name(named_parts(npy_value(path), fields)))

    def _look_at_npz(self, path: Path) -> None:
        inside = npz_arrays(path)
        if set(inside) & set(FIELDS):
            self.logs[path.name] = lambda: NpzLog(path, FIELDS, trust_pickle=self._trust)
        if set(inside) & set(PARTS) or set(inside) >= ALONE:
            wanted = [n for n in inside if n in PARTS or any(n in fields for fields in PARTS.values())]
            self.configurations[path.name] = Known(
                path, lambda: parts_by_name(npz_values(path, wanted, trust_pickle=self._trust))
            )

    def _look_at_objects(self, path: Path) -> None:
        if not self._trust:
            self.untrusted.append(path)
            raise DataError.at(path, NEEDS_TRUST)
        held = load_objects(path)
        parts = parts_by_name(named_parts(held, [*PARTS, *(f for fields in PARTS.values() for f in fields)]))
        if parts:
            self.configurations[path.name] = Known(path, lambda: parts)
        log = log_in(held, FIELDS)
        if log is not None or not parts:
            self.logs[path.name] = lambda: ObjectLog(path, held if log is None else log, FIELDS)

    def the(self, what: str, candidates: Mapping[str, T], right: str) -> T:
        """The only candidate; else DataError, with `right` as remedy."""
        if len(candidates) == 1:
            return next(iter(candidates.values()))
        if candidates:
            raise DataError.at(self._folder, f"{', '.join(candidates)} each hold a {what}; one per folder is needed")
        # a file that does not open is the most likely reason
        if self._faults:
            raise self._faults[0]
        names = ", ".join(self._names) or "no files"
        raise DataError.at(self._folder, f"no {what} found (there: {names}); {right} is needed")

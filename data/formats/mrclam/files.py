"""Where the files of a UTIAS MRCLAM dataset are: in a folder, or in the published zip (read in memory, never unpacked).

What they hold is in `data.mrclam.tables`.
"""

from __future__ import annotations

import hashlib
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from data.errors import DataError
from data.open_log.archive import open_archive

BARCODES, LANDMARKS = "Barcodes.dat", "Landmark_Groundtruth.dat"
ROBOT_FILE = re.compile(r"Robot([1-9][0-9]*)_(Groundtruth|Odometry|Measurement)\.dat")


@dataclass(frozen=True)
class Files:
    """The files of one dataset.

    Attributes:
        name: of the dataset.
        names: of its files.
        read: bytes of one of them.
        path: how errors name one of them.
        zipped: whether they are in a zip.
        sha256: digests by file name, of what was read so far; for a zip its own.
    """

    name: str
    names: frozenset[str]
    read: Callable[[str], bytes]
    path: Callable[[str], str]
    zipped: bool
    sha256: dict[str, str]

    def content(self, name: str) -> bytes:
        """Bytes of a file; DataError naming it if it is not there."""
        if name not in self.names:
            raise DataError.at(self.path(name), "no such file" + self._others(name))
        content = self.read(name)
        if not self.zipped:
            self.sha256[name] = hashlib.sha256(content).hexdigest()
        return content

    def _others(self, name: str) -> str:
        if ROBOT_FILE.fullmatch(name) is None:
            return ""
        there = ", ".join(map(str, self.robots())) or "none"
        return f"; robots with odometry and measurements here: {there}"

    def robots(self) -> list[int]:
        """Robots that have odometry and measurements, ascending."""
        found = (ROBOT_FILE.fullmatch(n) for n in self.names)
        numbers = {int(m[1]) for m in found if m is not None}
        return sorted(n for n in numbers if {robot_file(n, "Odometry"), robot_file(n, "Measurement")} <= self.names)


def robot_file(robot: int, what: str) -> str:
    """Name of a robot's file: `what` is Groundtruth, Odometry or Measurement."""
    return f"Robot{robot}_{what}.dat"


def _belongs(name: str) -> bool:
    return name in (BARCODES, LANDMARKS) or ROBOT_FILE.fullmatch(name) is not None


def _one_home(source: Path, names: list[PurePosixPath]) -> PurePosixPath:
    """The folder that holds the dataset's files: the top, or its one subfolder with such files."""
    homes = sorted({n.parent for n in names if _belongs(n.name) and len(n.parts) <= 2})
    if PurePosixPath(".") in homes:
        return PurePosixPath(".")
    if not homes:
        raise DataError.at(source / BARCODES, "no such file, nor any other MRCLAM file, here or one folder below")
    if len(homes) > 1:
        raise DataError.at(source, f"holds more than one dataset ({', '.join(map(str, homes))}); name one of them")
    return homes[0]


def _open_folder(source: Path) -> Files:
    try:
        names = [PurePosixPath(p.name) for p in source.iterdir() if p.is_file()]
        for below in sorted(p for p in source.iterdir() if p.is_dir()):
            names += [PurePosixPath(below.name, p.name) for p in below.iterdir() if p.is_file()]
    except OSError as error:
        raise DataError.at(source, f"cannot be read: {error.strerror}") from None
    home = _one_home(source, names)
    folder = source / home

    def read(name: str) -> bytes:
        try:
            return (folder / name).read_bytes()
        except OSError as error:
            raise DataError.at(folder / name, f"cannot be read: {error.strerror}") from None

    inside = frozenset(n.name for n in names if n.parent == home)
    return Files(folder.resolve().name, inside, read, lambda name: str(folder / name), False, {})


def _open_zip(source: Path) -> Files:
    try:
        content = source.read_bytes()
        archive = open_archive(source, whole=True)
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise DataError.at(source, f"not a readable zip file or folder: {error}") from None
    members = {PurePosixPath(n): n for n in archive.namelist() if not n.endswith("/")}
    home = _one_home(source, list(members))

    def read(name: str) -> bytes:
        try:
            return archive.read(members[home / name])
        # the library tells an encrypted member by a RuntimeError, an unknown method by a NotImplementedError
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
            raise DataError.at(source / home / name, f"cannot be read from the zip: {error}") from None

    inside = frozenset(n.name for n in members if n.parent == home)
    title = source.stem if home == PurePosixPath(".") else home.name
    digest = {source.name: hashlib.sha256(content).hexdigest()}
    return Files(title, inside, read, lambda name: str(source / home / name), True, digest)


def open_files(source: Path) -> Files:
    """Files of a dataset: `source` is a folder or a zip that holds them, or whose one subfolder does.

    Raises:
        DataError: neither folder nor zip, no dataset in it, or more than one.
    """
    if not source.exists():
        raise DataError.at(source, "no such folder or zip file")
    return _open_folder(source) if source.is_dir() else _open_zip(source)

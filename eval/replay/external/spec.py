"""Where a foreign estimator or association method is: `[NAME=]package.module:Class`, `[NAME=]./file.py:Class`.

The text is settled early, with a name and a place that other processes in other folders find. Nothing heavy is imported
here, so that `--help` and a mistyped name answer at once.

A name also determines colour and marker in figures, from its letters, so that they are equal in every process. If two
names of one run would look the same, the later one in the alphabet moves on; therefore the names of a run are
introduced.
"""

from __future__ import annotations

import os
import re
import sys
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from data.errors import UsageError, unknown
from eval.replay.flag import Read, texts
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUPS = {"estimator": "slamref.estimators", "association": "slamref.associations"}
"""Entry points by which an installed package adds names."""
OURS = {"estimator": ESTIMATORS, "association": (*ASSOCIATIONS, "none"), "world": (), "maintenance": ()}
NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9._-]{0,38}[A-Za-z0-9_])?")
"""Names are parts of file names: letters, digits, `.`, `_` and `-`, at most 40."""
FORM = "[NAME=]package.module:Attribute or [NAME=]./file.py:Attribute"


@dataclass(frozen=True)
class Place:
    """Where something foreign is."""

    name: str  # in tables and file names
    file: str  # an absolute path, or empty
    module: str  # its dotted name, or empty
    folder: str  # where the module is found if it is not installed; absolute, or empty
    attribute: str  # dotted if it is inside a class

    @property
    def text(self) -> str:
        """The settled text; `place_of` is the inverse."""
        where = self.file or (f"{self.module}@{self.folder}" if self.folder else self.module)
        return f"{self.name}={where}:{self.attribute}"

    @property
    def shown(self) -> str:
        """The text relative to the working directory."""
        here = Path.cwd()
        if self.file and Path(self.file).is_relative_to(here):
            return f"{self.name}=./{Path(self.file).relative_to(here).as_posix()}:{self.attribute}"
        return f"{self.name}={self.module}:{self.attribute}" if self.folder and Path(self.folder) == here else self.text


def is_foreign(text: str) -> bool:
    """Whether a text names something foreign."""
    return ":" in text


def name_of(text: str) -> str:
    """The name of an estimator or an association method in tables, files and figures."""
    return text.partition("=")[0] if is_foreign(text) else text


def names_of(given: Sequence[str]) -> tuple[str, ...]:
    """The names of several."""
    return tuple(name_of(text) for text in given)


def shown(text: str) -> str:
    """A settled text relative to the working directory; a name of ours as it is."""
    return place_of(text).shown if is_foreign(text) else text


def place_of(text: str) -> Place:
    """Parse a settled text."""
    name, _, rest = text.partition("=")
    where, _, attribute = rest.rpartition(":")
    if where.endswith(".py"):
        return Place(name, where, "", "", attribute)
    module, _, folder = where.partition("@")
    return Place(name, "", module, folder, attribute)


def settled(label: str, text: str, kind: str) -> str:
    """A foreign text of a kind for any process; relative places are those of the working directory. `label` of the flag
    is for messages. Raises UsageError: wrong form, missing file, or a name that cannot be used.
    """
    given, has_name, rest = text.partition("=")
    if not has_name:
        given, rest = "", text
    where, colon, attribute = rest.rpartition(":")
    if not (colon and where and all(part.isidentifier() for part in attribute.split("."))):
        raise UsageError(f"{label} {text}: {FORM} is needed")
    name = given or _short(where, attribute, kind)
    check_name(label, name, kind, bool(given), rest)
    if where.endswith(".py") or "/" in where.partition("@")[0] or os.sep in where.partition("@")[0]:
        path = Path(where).expanduser().absolute()
        if not path.is_file():
            raise UsageError(f"{label} {text}: there is no file {where}")
        if path.suffix != ".py":
            raise UsageError(f"{label} {text}: a file that ends in .py is needed")
        return Place(name, os.path.normpath(path), "", "", attribute).text
    module, _, folder = where.partition("@")
    if not all(part.isidentifier() for part in module.split(".")):
        raise UsageError(f"{label} {text}: {where!r} is no module; {FORM} is needed")
    return Place(name, "", module, folder or _folder_of(module), attribute).text


def _short(where: str, attribute: str, kind: str) -> str:
    """The attribute's name, with that of its file or module before it if the attribute alone is a name of ours."""
    name = attribute.rpartition(".")[2]
    if name.lower() not in (ours.lower() for ours in OURS[kind]):
        return name
    home = Path(where).stem if where.endswith(".py") else where.partition("@")[0].rpartition(".")[2]
    return f"{home}.{name}"


def check_name(label: str, name: str, kind: str, chosen: bool, rest: str) -> None:
    """Raises UsageError for a name that cannot be part of file names, or is one of ours."""
    instead = "" if chosen else f"; put a name before it, as in mine={rest}"
    if not NAME.fullmatch(name):
        can = "letters, digits, '.', '_', '-' can, at most 40"
        raise UsageError(f"{label}: {name!r} cannot be part of file names; {can}{instead}")
    ours = next((n for n in OURS[kind] if n.lower() == name.lower()), None)
    if ours is not None:
        raise UsageError(
            f"{label}: {name!r} would be taken for our {kind} {ours!r}{instead or '; choose another name'}"
        )


def _folder_of(module: str) -> str:
    """The working directory if a module is there and not installed, else empty."""
    here, top = Path.cwd(), module.partition(".")[0]
    there = any((here / top / "__init__.py").is_file() or p.exists() for p in (here / f"{top}.py", here / top))
    if not there:
        return ""
    from importlib.machinery import PathFinder

    elsewhere = [p for p in sys.path if p and Path(p).resolve() != here.resolve()]
    return "" if top in sys.builtin_module_names or PathFinder.find_spec(top, elsewhere) else str(here)


def own_or_foreign(kind: str, *, least: int = 0) -> Read:
    """A kind of value: different names, ours or foreign, separated by commas or as a list."""

    def read(label: str, value: object) -> tuple[str, ...]:
        given = tuple(name.strip() for part in texts(label, value) for name in part.split(",") if name.strip())
        found = tuple(one_settled(label, text, kind) for text in given)
        called = [name_of(text).lower() for text in found]
        for i, text in enumerate(found):
            if (first := called.index(called[i])) != i:
                if found[first] == text:
                    raise UsageError(f"{label} {','.join(given)}: named twice")
                what = f"{label} {given[i]}: the name {name_of(text)} is that of {shown(found[first])}, too"
                raise UsageError(f"{what}; put another one before it, as in NAME=...")
        if len(found) < least:
            raise UsageError(f"{label}: at least one is needed")
        return found

    return read


def one_settled(label: str, text: str, kind: str) -> str:
    """A name of ours as it is, a name of an installed package as its place, any other text settled."""
    added = entry_points(kind)
    if text in OURS[kind] and text != "none":
        return text
    if is_foreign(text):
        return settled(label, text, kind)
    if text not in added:
        known = (*(n for n in OURS[kind] if n != "none"), *added)
        raise UsageError(f"{label} {text}: {unknown(text, known)}; or your own as {FORM}")
    return settled(label, f"{text}={added[text]}", kind)


@cache
def installed(group: str) -> tuple[EntryPoint, ...]:
    """Entry points of all installed packages, read once: 30 ms each time."""
    from importlib import metadata

    return tuple(metadata.entry_points(group=group))


def entry_points(kind: str) -> dict[str, str]:
    """Names of installed packages, with `package.module:Attribute`. UsageError: a name of ours, or one twice."""
    found: dict[str, str] = {}
    packages: dict[str, str] = {}
    for point in sorted(installed(GROUPS[kind]), key=lambda p: (p.name, p.value)):
        package = point.dist.name if point.dist is not None else point.value
        who = f"the installed package {package} adds the {kind} {point.name!r} ({GROUPS[kind]})"
        if point.name.lower() in (n.lower() for n in OURS[kind]):
            raise UsageError(f"{who}, which is the name of one of ours; uninstall it, or have it renamed there")
        if found.get(point.name, point.value) != point.value:
            raise UsageError(f"{who}, and so does {packages[point.name]}; uninstall one of them")
        found[point.name], packages[point.name] = point.value, package
    return found


_NAMES: list[str] = []


def introduce(names: Iterable[str]) -> None:
    """Set the foreign names of this run."""
    _NAMES[:] = sorted(set(names))


def introduced() -> tuple[str, ...]:
    """The foreign names of this run, for other processes."""
    return tuple(_NAMES)


def place(name: str, places: int) -> int:
    """Index of a name among `places` looks; different for all introduced names as long as there are enough."""
    taken: set[int] = set()
    for known in _NAMES:
        found = _free(known, places, taken)
        if known == name:
            return found
        taken.add(found)
    return _free(name, places, set())


def _free(name: str, places: int, taken: set[int]) -> int:
    begin = zlib.crc32(name.encode()) % places
    return next((i for k in range(places) if (i := (begin + k) % places) not in taken), begin)

"""Loads what a settled text names, and calls it: whatever foreign code raises becomes one error with its traceback."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from association.expectation import SingularInnovationError
from data.errors import UsageError
from ekf.filter import FilterDivergedError
from eval.replay.external.spec import NAME, OURS, Place, is_foreign, place_of, settled
from graph.factors import UnderConstrained

Thing = Callable[..., Any]  # a class or a function


@dataclass(frozen=True)
class Loaded:
    """A loaded class or function."""

    text: str  # settled
    name: str  # in tables
    thing: Callable[..., Any]  # the class or function
    sources: tuple[Path, ...] = ()  # its file, and the files beside it that it imports

    @property
    def digest(self) -> str:
        """SHA-256 of its sources; empty if there are none, as in a notebook."""
        if not self.sources:
            return ""
        digest = hashlib.sha256()
        for path in self.sources:
            digest.update(path.name.encode() + path.read_bytes())
        return digest.hexdigest()


_LIVE: dict[str, Loaded] = {}  # objects of this process, without a file
_FILES: dict[tuple[str, str], ModuleType] = {}
"""Modules by path and content, so that a changed file is loaded again."""


def text_of(what: str | Thing, kind: str) -> str:
    """A name of ours, a settled text, any other text settled, or a text for an object of this process.

    Other processes cannot load such an object.
    """
    if isinstance(what, str):
        return what if what in _LIVE or not is_foreign(what) else settled(kind, what, kind)
    name = getattr(what, "__name__", type(what).__name__)
    if name.lower() in OURS[kind] or not NAME.fullmatch(name):
        name = f"my.{re.sub('[^A-Za-z0-9_]', '', name)[:36]}"
    text = f"{name}=<{id(what):x}>:{name}"
    _LIVE[text] = Loaded(text, name, what)
    return text


def objects(texts: Iterable[str]) -> dict[str, Loaded]:
    """Those of this process among them, for `adopt` in another one."""
    return {text: _LIVE[text] for text in texts if text in _LIVE}


def adopt(found: Mapping[str, Loaded]) -> None:
    """Take over objects of another process."""
    _LIVE.update(found)


def load(text: str) -> Loaded:
    """The class or function that a settled text names.

    Raises UsageError: it cannot be imported, there is no such attribute, or it cannot be called.
    """
    if text in _LIVE:
        return _LIVE[text]
    place = place_of(text)
    try:
        module = _of_file(Path(place.file)) if place.file else _of_module(place)
    except (Exception, SystemExit) as fault:
        raise UsageError(f"{place.shown}: {_import_failure(place, fault)}") from fault
    thing: Any = module
    for part in place.attribute.split("."):
        if not hasattr(thing, part):
            there = ", ".join(n for n, v in vars(thing).items() if _own(n, v, module)) or "nothing"
            raise UsageError(f"{place.shown}: no {place.attribute!r} in {_where(place)}; there is {there}")
        thing = getattr(thing, part)
    if not callable(thing):
        raise UsageError(f"{place.shown}: {place.attribute} is {kind_of(thing)}; a class or a function is needed")
    return Loaded(text, place.name, thing, _sources(module))


def digests(texts: tuple[str, ...]) -> tuple[str, ...]:
    """Digests of the foreign ones among names, on which stored runs depend."""
    return tuple(load(text).digest for text in texts if is_foreign(text))


def _of_file(path: Path) -> ModuleType:
    """The module of a file, which may import those beside it."""
    source = path.read_bytes()
    content = hashlib.sha256(source).hexdigest()
    known = _FILES.get((str(path), content))
    if known is not None:
        return known
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # last, so that nothing there shadows other imports
    name = f"slamref_foreign_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}_{content[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError("it is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look themselves up there
    try:
        # not by the loader, which may take stale bytecode of a file of the same length changed within a second
        exec(compile(source, str(path), "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    _FILES[str(path), content] = module
    return module


def _of_module(place: Place) -> ModuleType:
    if place.folder and place.folder not in sys.path:
        sys.path.append(place.folder)
    return importlib.import_module(place.module)


def _sources(module: ModuleType) -> tuple[Path, ...]:
    """The file of a module, and those of the modules it imported from its own folder and below."""
    if module.__file__ is None:
        return ()
    own = Path(module.__file__)
    found = {own}
    waiting, seen = [module], {id(module)}
    while waiting:
        for value in list(vars(waiting.pop()).values()):
            used = value if isinstance(value, ModuleType) else sys.modules.get(getattr(value, "__module__", None) or "")
            file = getattr(used, "__file__", None)
            if used is None or file is None or id(used) in seen or not Path(file).is_relative_to(own.parent):
                continue
            seen.add(id(used))
            found.add(Path(file))
            waiting.append(used)
    return tuple(sorted(p for p in found if p.suffix == ".py"))


def _import_failure(place: Place, fault: BaseException) -> str:
    parents = list(accumulate(place.module.split("."), "{}.{}".format))
    if isinstance(fault, ModuleNotFoundError) and place.module and (fault.name or "") in parents:
        return f"there is no module {fault.name!r}, neither installed nor in {Path.cwd()}"
    if isinstance(fault, SyntaxError):
        file = Path(fault.filename or place.file or place.module).name
        return f"{file}, line {fault.lineno}: {fault.msg}"
    return f"importing it raised {in_one_line(fault)}{at_line(fault)}"


def in_one_line(fault: BaseException) -> str:
    """An exception in one line."""
    text = " ".join(str(fault).split())
    return f"{type(fault).__name__}: {text}" if text else type(fault).__name__


def at_line(fault: BaseException) -> str:
    """` (file.py, line 7)`: the innermost line of an exception outside libraries; empty if there is none."""
    frames = traceback.extract_tb(fault.__traceback__)
    own = [f for f in frames if not f.filename.startswith(("<", *LIBRARIES))]
    return f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""


ROOT = Path(__file__).parents[3]
LIBRARIES = (
    *(str(ROOT / folder) for folder in ("association", "data", "ekf", "eval", "graph", "wings")),
    *(sysconfig.get_path(kind) for kind in ("stdlib", "purelib", "platlib")),
)


def _own(name: str, value: object, module: ModuleType) -> bool:
    """Whether an attribute of a module may have been meant."""
    return not name.startswith("_") and callable(value) and getattr(value, "__module__", None) == module.__name__


def _where(place: Place) -> str:
    return Path(place.file).name if place.file else place.module


def kind_of(value: object) -> str:
    """Type of a value with its article."""
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


PASSED = (FilterDivergedError, UnderConstrained, SingularInnovationError, MemoryError)
"""Errors of our own code, caught elsewhere."""


class ForeignError(Exception):
    """Foreign code crashed, or returned an unusable value."""

    def __init__(self, why: str, trace: str = "") -> None:
        super().__init__(why)
        self.trace = trace  # its traceback, empty where it did not crash


def call(who: str, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """The result of a foreign function; `who` names it in the error."""
    try:
        return function(*arguments, **named)
    except PASSED:
        raise
    except (Exception, SystemExit) as fault:
        below = fault.__traceback__.tb_next if fault.__traceback__ is not None else None
        trace = "".join(traceback.format_exception(type(fault), fault, below))
        raise ForeignError(f"{who} raised {in_one_line(fault)}{at_line(fault)}", trace) from fault


def array(who: str, value: Any, shape: tuple[int, ...], meant: str, *, finite: bool = True) -> Any:
    """A returned array as float64, copied. Raises ForeignError, which says what was returned and what is needed."""
    try:
        found = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ForeignError(f"{who}: {meant} is {_brief(value)}; an array {shape} is needed") from None
    if found.shape != shape:
        raise ForeignError(f"{who}: {meant} has shape {found.shape}; {shape} is needed")
    if finite and not np.isfinite(found).all():
        raise ForeignError(f"{who}: {meant} is not finite: {_brief(value)}")
    return found


def whole(who: str, value: Any, length: int, meant: str) -> Any:
    """A returned array (length,) of whole numbers as int64, copied."""
    found = np.asarray(value)
    if found.shape == (0,) == (length,):
        return np.empty(0, np.int64)
    if found.dtype.kind not in "iu":
        raise ForeignError(f"{who}: {meant} is {_brief(value)} of {found.dtype}; whole numbers are needed")
    if found.shape != (length,):
        raise ForeignError(f"{who}: {meant} has shape {found.shape}; {(length,)} is needed")
    return found.astype(np.int64)


def _brief(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."

"""Foreign estimators and association methods, loaded, made, and completed by an adapter; what they lack for a run.

Whatever foreign code raises becomes one error with its traceback. The adapter supplies optional methods, checks and
converts results. A pose may also be weighted samples, as of a particle filter (`Samples`).

Innovation statistics are formed from an estimator's own expectation; what it states is only compared
(`OwnInnovations`). An estimator that states a convenient NIS would otherwise pass for consistent. The expectation is
formed before the update, where it is valid; the update tells which pairings were used.
"""

import hashlib
import importlib
import importlib.util
import inspect
import math
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import accumulate
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from association.candidates import aligned_with_observations
from association.expectation import Expectation, SingularInnovationError, statistics
from data.blocks import diagonal_blocks, whitened
from data.errors import UsageError
from data.inputs import FrameObservations, Increment, IntArray, LandmarkMap
from data.notice import Code, Notice, notice
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated, not_used
from data.result import DISCARD, NEW, Finished, MapState, PoseEstimate, Trajectory, Updated
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor
from ekf.filter import DEFAULT, FilterDivergedError, FilterOptions
from eval.replay.external.spec import NAME, OURS, Place, is_foreign, place_of, settled
from eval.replay.settings import HINDSIGHT, TASKS, Given, Setup
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
_FILES: dict[tuple[str, str], ModuleType] = {}  # modules by path and content, so that a changed file is loaded again


def text_of(what: str | Thing, kind: str) -> str:
    """A name of ours, a settled text, any other settled, or a text for an object, which this process alone can load."""
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
    """The class or function that a settled text names. UsageError: not importable, no such attribute, not callable."""
    if text in _LIVE:
        return _LIVE[text]
    place = place_of(text)
    try:
        if place.folder and place.folder not in sys.path:
            sys.path.append(place.folder)
        module = _of_file(Path(place.file)) if place.file else importlib.import_module(place.module)
    except (Exception, SystemExit) as fault:
        raise UsageError(f"{place.shown}: {_import_failure(place, fault)}") from fault
    thing: Any = module
    for part in place.attribute.split("."):
        if not hasattr(thing, part):
            callables = {n: v for n, v in vars(thing).items() if callable(v) and not n.startswith("_")}
            own = (n for n, v in callables.items() if getattr(v, "__module__", None) == module.__name__)
            where, there = Path(place.file).name if place.file else place.module, ", ".join(own) or "nothing"
            raise UsageError(f"{place.shown}: no {place.attribute!r} in {where}; there is {there}")
        thing = getattr(thing, part)
    if not callable(thing):
        raise UsageError(f"{place.shown}: {place.attribute} is {kind_of(thing)}; a class or a function is needed")
    return Loaded(text, place.name, thing, _sources(module))


def digests(texts: tuple[str, ...]) -> tuple[str, ...]:
    """Digests of the foreign ones among names, on which stored runs depend."""
    return tuple(load(text_of(text, "maintenance")).digest for text in texts if is_foreign(text))


def _of_file(path: Path) -> ModuleType:
    """The module of a file, which may import those beside it."""
    source = path.read_bytes()
    content = hashlib.sha256(source).hexdigest()
    if (known := _FILES.get((str(path), content))) is not None:
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
    own = [f for f in traceback.extract_tb(fault.__traceback__) if not f.filename.startswith(("<", *LIBRARIES))]
    return f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""


ROOT = Path(__file__).parents[3]
LIBRARIES = (
    *(str(ROOT / folder) for folder in ("association", "data", "ekf", "eval", "graph", "wings")),
    *(sysconfig.get_path(kind) for kind in ("stdlib", "purelib", "platlib")),
)


def kind_of(value: object) -> str:
    """Type of a value with its article."""
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


PASSED = (FilterDivergedError, UnderConstrained, SingularInnovationError, MemoryError)  # Our own, caught elsewhere


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


class Samples(NamedTuple):
    """Pose samples of your own estimator, such as a particle filter, as the return value of its `estimate`.

    Example:
        >>> samples = slamref.Samples(np.array([[0.0, 0.0, 0.1], [0.2, 0.0, -0.1]]))
        >>> samples.estimate().mean  # array([0.1, 0. , 0. ])
    """

    poses: Array  # (n, 3) x, y [m], theta [rad] in the world frame, n > 1
    weights: Array | None = None  # (n,), not normalized; None: equal

    @property
    def normalized(self) -> Array:
        """Weights (n,) whose sum is 1."""
        w = np.ones(len(self.poses)) if self.weights is None else np.asarray(self.weights, float)
        return np.asarray(w / w.sum())

    @property
    def effective(self) -> float:
        """Effective number of different samples, 1 / sum w^2 over different poses."""
        _, which = np.unique(np.asarray(self.poses, float), axis=0, return_inverse=True)
        each = np.bincount(which.ravel(), self.normalized)
        return float(1.0 / (each @ each))

    def estimate(self) -> PoseEstimate:
        """Weighted mean (circular for the heading) and unbiased weighted covariance, sum w d d' / (1 - sum w^2). Raises
        ValueError for wrong shapes, negative or infinite weights, or if a single sample has all the weight.
        """
        poses = np.asarray(self.poses, float)
        if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) < 2:
            raise ValueError(f"samples have shape {poses.shape}; (n, 3) with n > 1 is needed")
        w = np.ones(len(poses)) if self.weights is None else np.asarray(self.weights, float)
        if w.shape != (len(poses),) or not np.isfinite(w).all() or (w < 0.0).any() or not w.sum() > 0.0:
            raise ValueError(f"{len(poses)} samples need as many weights, none negative, not all zero")
        w = w / w.sum()
        spread = 1.0 - float(w @ w)
        if spread <= 1e-12:
            raise ValueError("one sample has all the weight; of one sample there is no covariance")
        mean = w @ poses
        mean[2] = np.arctan2(w @ np.sin(poses[:, 2]), w @ np.cos(poses[:, 2]))
        off = poses - mean
        off[:, 2] = wrap_angle(off[:, 2])
        return PoseEstimate(mean, (w[:, None] * off).T @ off / spread)


BLANK = np.full((3, 3), np.nan)
BLANK.setflags(write=False)
TOLERANCE = 1e-9  # largest asymmetry of a covariance and size of a negative eigenvalue, over the trace: rounding


def pose_of(who: str, given: Any) -> PoseEstimate:
    """A pose: (mean, covariance), (mean, None), a mean (3,) alone, or `Samples`; the heading is wrapped."""
    if isinstance(given, Samples):
        given = call(who, given.estimate)
    if isinstance(given, tuple):
        if len(given) != 2:
            raise ForeignError(f"{who} returned a tuple of {len(given)}; (mean, covariance) is needed, or Samples")
        mean, covariance = given
    else:
        mean, covariance = given, None
    if mean is None:
        raise ForeignError(f"{who} returned None; (mean, covariance) is needed, or Samples")
    pose = array(who, mean, (3,), "the mean")
    if not -math.pi <= pose[2] <= math.pi:
        pose[2] = wrap_angle(float(pose[2]))
    if covariance is None:
        return PoseEstimate(pose, BLANK)
    P = array(who, covariance, (3, 3), "the covariance")
    size, off = float(np.abs(np.diag(P)).sum()), float(np.abs(P - P.T).max())
    if off > TOLERANCE * size:
        what = f"two elements differ by {off:.3g} (0.5 * (P + P.T) is, if that is rounding)"
        what += "; L @ L.T is, if it is a root L" * bool(np.triu(P, 1).any() != np.tril(P, -1).any())
        raise ForeignError(f"{who}: the covariance is not symmetric: {what}")
    least = float(np.linalg.eigvalsh(0.5 * (P + P.T))[0])
    if least < -TOLERANCE * size:
        raise ForeignError(f"{who}: the covariance is not positive semidefinite: an eigenvalue is {least:.3g}")
    return PoseEstimate(pose, P)


def expectation_of(who: str, given: Any, observations: FrameObservations) -> Expectation:
    """An expectation of the present observations, with guarded functions."""
    if not isinstance(given, Expectation):
        raise ForeignError(f"{who} returned {kind_of(given)}; an association.expectation.Expectation is needed")
    n, m = len(given.number), len(observations.z)
    number = whole(who, given.number, n, "number")
    if len(np.unique(number)) != n or (number < 0).any():
        raise ForeignError(f"{who}: number {number.tolist()}: a candidate is named twice, or by a negative number")
    joint, elsewhere = given.joint, given.elsewhere

    def guarded(indices: IntArray) -> Any:
        k = len(indices)
        return array(f"{who}: joint", call(f"{who}: joint", joint, indices), (2 * k, 2 * k), "what it returned")

    def moved(pose: Any) -> Expectation:
        assert elsewhere is not None
        return expectation_of(who, call(f"{who}: elsewhere", elsewhere, pose), observations)

    return replace(
        given, number=number, z_hat=array(who, given.z_hat, (n, 2), "z_hat"),
        HPHt=array(who, given.HPHt, (n, 2, 2), "HPHt"), frame=whole(who, given.frame, n, "frame"),
        z=array(who, given.z, (m, 2), "z"), R=array(who, given.R, (m, 2, 2), "R"),
        observed_frame=whole(who, given.observed_frame, m, "observed_frame"), joint=guarded,
        elsewhere=None if elsewhere is None else moved,
    )  # fmt: skip


def _stated(who: str, given: Any, kind: type[Updated] | type[PoseUpdated]) -> dict[str, Any]:
    """The fields of a result that are stated: those of a `kind`, of a mapping, or none."""
    stated = given._asdict() if isinstance(given, kind) else {} if given is None else given
    if not isinstance(stated, Mapping) or set(stated) - set(kind._fields):
        some = f"a dict with some of its fields ({', '.join(kind._fields)}) is needed"
        raise ForeignError(f"{who} returned {kind_of(given)}; None, a {kind.__module__}.{kind.__name__}, or {some}")
    return {name: value for name, value in stated.items() if value is not None}


def _used(who: str, stated: dict[str, Any], count: int) -> BoolArray:
    """Which of so many (f,) were used; all where it is not stated."""
    found = np.asarray(stated.get("used", np.ones(count, np.bool_)))
    if found.shape != (count,) or found.dtype != np.bool_:
        raise ForeignError(f"{who}: used is {found.dtype} {found.shape}; bool {(count,)} is needed")
    return found


def updated_of(who: str, given: Any, decisions: IntArray, new: BoolArray, created: int) -> Updated:
    """The result for decisions (m,), `new` (m,) after `created` landmarks; what is not stated was done as decided."""
    stated, m = _stated(who, given, Updated), len(decisions)
    numbers, used = np.where(new, created + np.cumsum(new) - 1, -1), _used(who, stated, m) & (decisions >= 0)
    if "created" in stated:
        made = whole(who, stated["created"], m, "created")
        wanted = np.where(made >= 0, created + np.cumsum(made >= 0) - 1, -1)
        if (made != wanted).any() or (made >= 0)[~new].any():
            right = f"landmarks are numbered in the order of their creation, which would be {numbers.tolist()}"
            raise ForeignError(f"{who}: created is {made.tolist()}; {right}")
        numbers = made
    nis, dof = float(stated.get("nis", math.nan)), int(stated.get("dof", 2 * int(used.sum())))
    white = array(who, stated["white"], (m, 2), "white", finite=False) if "white" in stated else None
    return Updated(used, numbers.astype(np.int64), nis, dof, float(stated.get("log_likelihood", math.nan)), white)


def pose_updated_of(who: str, given: Any, dof: IntArray) -> PoseUpdated:
    """The result with fixes or closures of `dof` (f,); unless stated, all were used and innovations are not known."""
    stated, done = _stated(who, given, PoseUpdated), not_used(dof)
    done.used[:] = _used(who, stated, len(done.used))
    for name, field in (("nis", done.nis), ("white", done.white), ("S", done.S)):
        if name in stated:
            field[:] = array(who, stated[name], field.shape, name, finite=False)
    return done


def map_of(who: str, given: Any) -> MapState:
    """A map: number (L,), xy (L, 2) and covariance (L, 2, 2), which may be None."""
    if not isinstance(given, tuple) or len(given) != 3:
        needed = "(number, xy, covariance) is needed, covariance may be None"
        raise ForeignError(f"{who} returned {kind_of(given)}; {needed}")
    n = len(given[0])
    covariance = np.full((n, 2, 2), np.nan) if given[2] is None else array(who, given[2], (n, 2, 2), "the covariance")
    return MapState(whole(who, given[0], n, "number"), array(who, given[1], (n, 2), "xy"), covariance)


NONE = np.empty(0, np.int64)
NONE.setflags(write=False)
KEYWORDS = ("threshold", "at", "innovations")  # optional keywords of `update`


OPTIONAL = ("stamp", "remove", "merge", "park", "restore", "inflate", "reset", "amend", "keep")


class Adapter:
    """A foreign estimator with the methods of `eval.replay.estimators.Estimator`; capabilities follow from `inner`."""

    def __init__(self, name: str, inner: Any, known: LandmarkMap | None) -> None:
        """Wrap `inner`; `known` is the map of localization."""
        self.name, self.inner, self._known = name, inner, known
        self.smooths = bool(getattr(inner, "smooths", False))  # whether it revises its past
        self.lacks_covariance = False  # whether it ever gave a pose without one
        self.samples = math.inf  # least effective number of samples that a pose was given as; infinite: none was
        self._created, self._takes = 0, _taken(inner)

    def has(self, verb: str) -> bool:
        """Whether `inner` has a method."""
        return callable(getattr(self.inner, verb, None))

    @property
    def size(self) -> int:
        """Length of its state."""
        return int(self.inner.size)

    @property
    def errors(self) -> None:
        """None: it estimates no systematic errors."""
        return None

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of the parked landmarks."""
        return np.asarray(self.inner.parked, np.int64)

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self._call("predict", increment)

    def expect(self, observations: FrameObservations) -> Expectation:
        """Its expectation."""
        return expectation_of(f"{self.name}.expect", self._call("expect", observations), observations)

    def update(self, observations: FrameObservations, decisions: IntArray, **options: Any) -> Updated:
        """Use the pairings; it gets the keywords that it takes."""
        given = {"threshold": math.inf, "at": None, "innovations": False} | options
        done = self._call("update", observations, decisions.copy(), **{k: given[k] for k in self._takes})
        new = (decisions == NEW) if self._known is None else np.zeros(len(decisions), np.bool_)
        found = updated_of(f"{self.name}.update", done, decisions, new, self._created)
        self._created += int((found.created >= 0).sum())
        return found

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """Use absolute measurements of the pose."""
        return pose_updated_of(f"{self.name}.fix", self._call("fix", fixes, sources, gate), fixes.dof)

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """Use relative poses."""
        done = self._call("close_loops", closures, gate)
        return pose_updated_of(f"{self.name}.close_loops", done, np.full(len(closures), 3))

    def parked_xy(self) -> Array:
        """Positions (b, 2) of the parked landmarks."""
        if not len(self.parked):
            return np.empty((0, 2))
        given, who = self._call("parked_xy"), f"{self.name}.parked_xy"
        return np.asarray(array(who, given, (len(self.parked), 2), "what it returned"))

    def __getattr__(self, verb: str) -> Callable[..., None]:
        """An optional method of `inner`, called with copies of arrays."""
        if verb not in OPTIONAL:
            raise AttributeError(verb)

        def handed_on(*arguments: Any) -> None:
            self._call(verb, *(a.copy() if isinstance(a, np.ndarray) else a for a in arguments))

        return handed_on

    def estimate(self) -> PoseEstimate:
        """The newest pose; NaN for a covariance that it does not give."""
        given = self._call("estimate")
        found = pose_of(f"{self.name}.estimate", given)
        if isinstance(given, Samples):
            self.samples = min(self.samples, given.effective)
        self.lacks_covariance |= not np.isfinite(found.covariance).all()
        return found

    def landmarks(self) -> MapState:
        """The current map: the given one in localization, empty if it has no `landmarks`."""
        if self.has("landmarks"):
            return map_of(f"{self.name}.landmarks", self._call("landmarks"))
        if self._known is not None:
            return MapState(self._known.id, self._known.xy, np.zeros((len(self._known.id), 2, 2)))
        return MapState(NONE, np.empty((0, 2)), np.empty((0, 2, 2)))

    def finish(self) -> Finished:
        """Its own `finish`, or the last map."""
        if not self.has("finish"):
            return Finished(None, self.landmarks() if self._known is None else None)
        who, given = f"{self.name}.finish", self._call("finish")
        if not isinstance(given, Finished):
            what = f"{who} returned {kind_of(given)}"
            raise ForeignError(f"{what}; a data.result.Finished is needed, or no `finish` at all")
        if given.final is not None and not isinstance(given.final, Trajectory):
            raise ForeignError(f"{who}: final is {kind_of(given.final)}; a data.result.Trajectory is needed, or None")
        return given._replace(map=None if given.map is None else map_of(who, given.map))

    def notes(self) -> list[Notice]:
        """Messages about missing results."""
        found = []
        if self.lacks_covariance:
            found.append(notice(Code.NO_COVARIANCE, name=self.name))
        if self._known is None and not self.has("landmarks"):
            found.append(notice(Code.NO_LANDMARKS, name=self.name))
        return found

    def _call(self, verb: str, *arguments: Any, **named: Any) -> Any:
        function = getattr(self.inner, verb, None)
        if function is None:
            raise ForeignError(f"{self.name} has no `{verb}`, which is needed here")
        return call(f"{self.name}.{verb}", function, *arguments, **named)


def _taken(inner: Any) -> tuple[str, ...]:
    """The keywords that its `update` takes."""
    try:
        parameters = inspect.signature(inner.update).parameters.values()
    except (AttributeError, TypeError, ValueError):
        return ()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return KEYWORDS
    return tuple(k for k in KEYWORDS if any(p.name == k for p in parameters))


DIFFERENT = 0.01  # of the NIS that its expectation gives; a sound filter linearizes its update as its expectation
ROUNDING = 1e-9  # relative; what it states so closely is kept, to the bit


class OwnInnovations:
    """NIS, likelihood and whitened innovations of a foreign estimator, frame by frame."""

    def __init__(self, expect: Callable[[FrameObservations], Expectation] | None, sensor: Sensor) -> None:
        self._expect, self._sensor = expect, sensor
        self._rows, self._nu, self._S = np.empty(0, np.int64), np.empty(0), np.empty((0, 0))
        self._why = "it has no `expect`" if expect is None else ""  # why nothing can be formed
        self._frames = self._differing = self._dof = 0
        self._stated = self._formed = 0.0
        self._unchecked = False  # whether it stated what could not be formed

    def before(
        self, observations: FrameObservations, decisions: IntArray, expected: Expectation | None,
        at: Array | None = None,
    ) -> None:  # fmt: skip
        """Form the innovations of the pairings by `expected` (None: by its expectation now, linearized at `at`).
        Observations, noise and residual are those of the log, whatever the expectation has.
        """
        self._rows = np.flatnonzero(decisions >= 0)
        if self._why or self._expect is None or not len(self._rows):
            return
        try:
            if (e := expected) is None:
                e = self._expect(observations)
                e = aligned_with_observations(e if at is None or e.elsewhere is None else e.elsewhere(at), self._sensor)
            absent = np.setdiff1d(decisions[self._rows], e.number)
            if len(absent):
                self._why = f"its `expect` leaves out landmark {absent[0]}, which was paired"
                return
            self._nu, self._S = replace(
                e, z=observations.z, R=observations.R, residual=self._sensor.residual
            ).joint_innovation(*e.paired(decisions))
        except ForeignError as stop:
            if expected is not None:  # the decisions needed it
                raise
            self._why = str(stop)

    def after(self, done: Updated) -> Updated:
        """The result of the update with the statistics of the pairings that it used."""
        stated = done.nis
        keep = done.used[self._rows]
        blank = done._replace(nis=math.nan, dof=0, log_likelihood=math.nan, white=None)
        if not len(self._rows):
            return blank if self._why else done._replace(nis=0.0, dof=0, log_likelihood=0.0)
        if not self._why:
            both = np.repeat(keep, 2)
            nu, S = self._nu[both], self._S[np.ix_(both, both)]
            try:
                nis, dof, likelihood = statistics(nu, S)
            except SingularInnovationError:
                self._why = "the joint covariance of its expectation and R is not positive definite"
        if self._why:
            self._unchecked |= math.isfinite(stated)
            return blank
        if math.isfinite(stated):
            self._frames += 1
            self._stated, self._formed, self._dof = self._stated + stated, self._formed + nis, self._dof + dof
            self._differing += abs(stated - nis) > DIFFERENT * max(nis, 1.0)
        white = np.full((len(done.used), 2), np.nan)
        white[self._rows[keep]] = whitened(nu.reshape(-1, 2), diagonal_blocks(S))
        if done.dof == dof and _close(done, nis, likelihood, white):
            return done
        return done._replace(nis=nis, dof=dof, log_likelihood=likelihood, white=white)

    def notes(self) -> list[Notice]:
        """Messages about what it states otherwise, or what cannot be compared."""
        found = []
        if self._differing:
            stated, formed = (each / max(self._dof, 1) for each in (self._stated, self._formed))
            found.append(notice(Code.NIS_STATED, frames=self._differing, of=self._frames, stated=stated, formed=formed))
        if self._unchecked or (self._why and self._expect is not None):
            found.append(notice(Code.NIS_UNCHECKED, why=self._why, stated=self._unchecked))
        return found


def _close(done: Updated, nis: float, likelihood: float, white: Array) -> bool:
    """Whether all that it states is right but for rounding."""
    stated, formed = np.array([done.nis, done.log_likelihood]), np.array([nis, likelihood])
    if done.white is None or not np.allclose(stated, formed, rtol=ROUNDING, atol=ROUNDING):
        return False
    return bool(np.allclose(done.white, white, rtol=ROUNDING, atol=ROUNDING, equal_nan=True))


SIGNATURES = "one of (prior, sensor, options) does SLAM, of (prior, sensor, map, options) localization"
VERBS = ("predict", "update", "estimate")  # required methods
OF_VERBS = f"with {', '.join(VERBS)} (docs/extending.md); of other states or sensors: slamref score, of many runs"


class CannotError(Exception):
    """An estimator lacks what this run needs; the others go on."""


def estimator(text: str, given: Given, options: FilterOptions | None = None) -> Adapter:
    """A fresh foreign estimator. Raises ForeignError if its constructor crashes."""
    loaded, options = load(text), options or DEFAULT
    beginning = (given.prior, given.sensor) if given.map is None else (given.prior, given.sensor, given.map)
    return Adapter(loaded.name, call(f"{loaded.name}()", loaded.thing, *beginning, options), given.map)


def tasks_of(loaded: Loaded) -> tuple[str, ...]:
    """Tasks by its attribute `tasks`, else by its constructor. UsageError: neither, or a required method is absent."""
    missing = [v for v in VERBS if isinstance(loaded.thing, type) and not callable(getattr(loaded.thing, v, None))]
    if missing:
        raise UsageError(f"{loaded.name}: no method {missing[0]!r}; an estimator is a class {OF_VERBS}")
    stated: Any = getattr(loaded.thing, "tasks", None)
    if stated is not None:
        tasks = (stated,) if isinstance(stated, str) else tuple(stated)
        if not tasks or set(tasks) - set(TASKS):
            raise UsageError(f"{loaded.name}.tasks is {stated!r}; some of {', '.join(TASKS)} are needed")
        return tasks
    try:
        parameters = inspect.signature(loaded.thing).parameters.values()
    except (TypeError, ValueError):
        return TASKS
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        return TASKS
    count = sum(p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters)
    if count not in (3, 4) or any(p.kind is p.KEYWORD_ONLY and p.default is p.empty for p in parameters):
        takes = f"({', '.join(p.name for p in parameters)})"
        raise UsageError(f"{loaded.name}: its constructor takes {takes}; {SIGNATURES}; see docs/extending.md")
    return ("slam",) if count == 3 else ("localization",)


def lack(text: str, task: str, association: str, setup: Setup) -> str | None:
    """Why a foreign estimator cannot do a run, a sentence, or None; `association`: a name of ours, or another text."""
    loaded = load(text)
    tasks = tasks_of(loaded)
    if task not in tasks:
        how = "by its attribute tasks" if hasattr(loaded.thing, "tasks") else f"by its constructor: {SIGNATURES}"
        return f"{loaded.name} does {tasks[0]} only, {how}"
    if not isinstance(loaded.thing, type):
        return None
    needed: dict[str, str] = {}
    slam = task == "slam"
    if association == HINDSIGHT:
        needed = dict.fromkeys(("remove", "merge") if slam else ("expect", "reset"), f"--association {HINDSIGHT}")
    elif association != "known":
        needed["expect"] = "any --association but known"
    smooths = bool(getattr(loaded.thing, "smooths", False))
    if slam and (setup.retracts or (setup.forget_after is not None and not smooths)):
        needed.setdefault("remove", "--maintain" if setup.retracts else "--forget-after")
    if slam and setup.deactivate_after is not None and not smooths:
        needed |= dict.fromkeys(("park", "restore", "parked_xy"), "--deactivate-after")
    for verb, why in needed.items():
        if not callable(getattr(loaded.thing, verb, None)):
            return f"{loaded.name} has no `{verb}`, which {why} needs"
    return None


def able(names: Sequence[str], task: str, association: str, setup: Setup) -> list[str]:
    """Names of estimators, ours or foreign, that lack nothing."""
    return [n for n in names if not is_foreign(n) or lack(n, task, association, setup) is None]


def require(text: str, task: str, association: str, setup: Setup) -> None:
    """Raises CannotError if anything is lacking."""
    if (why := lack(text, task, association, setup)) is not None:
        raise CannotError(why)


class Method:
    """A foreign association method; `NEW` founds a landmark only outside the gate of new ones, as plain methods do."""

    def __init__(self, loaded: Loaded) -> None:
        """Use `loaded.thing`; a class is instantiated once, without arguments, and then called."""
        self.name = loaded.name  # in tables
        self._function = call(f"{self.name}()", loaded.thing) if isinstance(loaded.thing, type) else loaded.thing
        try:
            inspect.signature(self._function).bind(None, None)
        except TypeError:
            takes = inspect.signature(self._function) if callable(self._function) else "no call"
            other = f"takes {takes}; an association method takes (expectation, gate)"
            raise ForeignError(f"{self.name} {other}, an estimator is a class {OF_VERBS}") from None
        except ValueError:  # compiled, without a signature
            return

    def __call__(self, expectation: Expectation, gate: float | None) -> IntArray:
        """Decisions (m,): landmark number, `NEW`, `DISCARD`. ForeignError: it crashed, or returned no decisions."""
        m = len(expectation.z)
        found: IntArray = whole(self.name, call(self.name, self._function, expectation, gate), m, "what it returned")
        known = np.isin(found, expectation.number) | (found == NEW) | (found == DISCARD)
        if not known.all():
            i = int(np.argmin(known))
            what = f"{self.name}: decision {found[i]} about observation {i} names no candidate"
            raise ForeignError(f"{what}; the number of one, NEW ({NEW}) or DISCARD ({DISCARD}) is needed")
        return found


def locked(e: Expectation) -> Expectation:
    """The same expectation with read-only arrays."""
    views: dict[str, Any] = {f.name: v.view() for f in fields(e) if isinstance(v := getattr(e, f.name), np.ndarray)}
    for view in views.values():
        view.setflags(write=False)
    return replace(e, **views)

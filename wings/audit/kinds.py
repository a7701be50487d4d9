"""Kinds of factors: what they measure, whether of neighbours, and their noise; which rows are which component."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from data.inputs import IntArray
from data.origin import Origin
from data.se2 import BoolArray
from wings.audit.linear import value_of

ODOMETRY, LOOP, PRIOR = "odometry", "loop", "prior"
MOST_NOISES, FEWEST = 4, 20  # noise models that divide a kind: at most, and each of at least so many factors
XYZ = ("x", "y", "z")
AXES: dict[str, tuple[str, ...]] = {
    "Pose2": ("x", "y", "theta"), "Pose3": (*(f"rotation {x}" for x in XYZ), *XYZ),
    "BearingRangeFactor2D": ("bearing", "range"), "BearingRangeFactorPose2": ("bearing", "range"),
    "Point2": ("x", "y"), "Point3": XYZ, "TranslationPrior2D": ("x", "y"), "TranslationPrior3D": XYZ, "GPS": XYZ,
    "ConstantBias": tuple(f"{sensor} {x}" for sensor in ("accelerometer", "gyroscope") for x in XYZ),
    "Projection": ("u", "v"),
}  # fmt: skip
"""Names of the residuals, by a part of the name of the factor's class; gtsam puts a Pose3's rotation first."""
MIXED, UNSTATED = ("Pose2", "Pose3", "Bearing", "Range", "DeltaFactor"), ", no noise stated"
POINTS = {"Pose2": (0, 1), "Pose3": (3, 4, 5)}  # components of a pose's tangent that are a position in m

Grouping = Callable[[int, gtsam.NonlinearFactor], str] | Sequence[str] | None


@dataclass(frozen=True)
class Kinds:
    """Kinds of the factors of a graph."""

    of: IntArray  # (F,) kind of each factor, -1 of an empty slot
    names: tuple[str, ...]
    axes: tuple[tuple[str, ...], ...]  # names of components; none: noise that is not diagonal, or one residual
    loops: BoolArray  # (F,) relations of variables that are no neighbours
    assumed: tuple[str, ...] = ()  # kinds whose noise nobody stated


def kinds(graph: gtsam.NonlinearFactorGraph, by: Grouping = None) -> Kinds:
    """The kinds of a graph's factors; `by`: own names, or a function of number and factor; empty: ours."""
    factors = {i: graph.at(i) for i in range(graph.size()) if graph.exists(i)}
    own = {} if by is None else {i: str(by(i, f)) if callable(by) else str(by[i]) for i, f in factors.items()}
    every = _roles(factors)
    roles = {i: name for i, name in every.items() if not own.get(i)}
    names = _divided(factors, roles | {i: name for i, name in own.items() if name}) if roles else own
    place = {name: k for k, name in enumerate(dict.fromkeys(names.values()))}
    of = np.array([place[names[i]] if i in names else -1 for i in range(graph.size())], np.int64)
    axes: dict[str, set[tuple[str, ...]]] = {name: set() for name in place}
    for i, factor in factors.items():
        axes[names[i]].add(_axes(factor))
    loops = np.array([every.get(i, "").startswith(LOOP) for i in range(graph.size())], bool)
    stated = {names[i] for i, factor in factors.items() if origin_of(factor) is Origin.STATED}
    assumed = tuple(name for name in place if name not in stated)
    return Kinds(of, tuple(place), tuple(a.pop() if len(a) == 1 else () for a in axes.values()), loops, assumed)


def _roles(factors: dict[int, gtsam.NonlinearFactor]) -> dict[int, str]:
    """What each factor measures; a relation of neighbours in the order of keys of one letter is odometry."""
    relations = ("BetweenFactor", "FrobeniusBetween")
    pairs = {i: sorted(f.keys()) for i, f in factors.items() if type(f).__name__.startswith(relations)}
    rank = {key: k for k, key in enumerate(sorted({key for pair in pairs.values() for key in pair}))}
    names = {}
    for i, factor in factors.items():
        name = type(factor).__name__
        if i in pairs:
            a, b = pairs[i]
            names[i] = ODOMETRY if rank[b] == rank[a] + 1 and a >> 56 == b >> 56 else LOOP
        elif name.startswith(("PriorFactor", "ExtendedPrior", "NonlinearEquality")):
            names[i] = PRIOR
        else:
            names[i] = "GPS" if name.startswith("GPSFactor") else name
    several = defaultdict(set)
    for i, factor in factors.items():
        several[names[i]].add(type(factor).__name__)
    for i, factor in factors.items():  # say the type where one role has several
        if len(several[names[i]]) > 1:
            names[i] = f"{names[i]} {type(factor).__name__.replace('BetweenFactor', '').replace('PriorFactor', '')}"
    stated = {names[i] for i, factor in factors.items() if origin_of(factor) is Origin.STATED}
    return {i: n + UNSTATED * (n in stated and origin_of(factors[i]) is Origin.ASSUMED) for i, n in names.items()}


def origin_of(factor: gtsam.NonlinearFactor) -> Origin:
    """Of a factor's noise: assumed if sigma 1 serves angles and lengths, a file's points, or unknown residuals."""
    unit = isinstance(plain_noise(factor)[0], gtsam.noiseModel.Unit)
    mixed = isinstance(factor, gtsam.CustomFactor) or any(n in type(factor).__name__ for n in MIXED)
    return Origin.ASSUMED if unit and mixed else Origin.STATED


def _divided(factors: dict[int, gtsam.NonlinearFactor], names: dict[int, str]) -> dict[int, str]:
    """The names, with the stated sigmas where a kind has a few noise models."""
    members: dict[str, dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for i, factor in factors.items():
        model, robust = plain_noise(factor)
        noise = "" if model is None else f"sigma {' '.join(f'{s:.3g}' for s in model.sigmas())}"
        members[names[i]][noise + ", robust" * (robust and model is not None)].append(i)
    out = dict(names)
    for name, by_noise in members.items():
        if 1 < len(by_noise) <= MOST_NOISES and min(map(len, by_noise.values())) >= FEWEST:
            for noise, some in by_noise.items():
                for i in some:
                    out[i] = f"{name}, {noise}"
    return out


def plain_noise(factor: gtsam.NonlinearFactor) -> tuple[Any, bool]:
    """The noise model of a factor, of a robust one that beneath, None where there is none; and whether it is robust."""
    model = factor.noiseModel() if isinstance(factor, gtsam.NoiseModelFactor) else None
    return (model.noise(), True) if isinstance(model, gtsam.noiseModel.Robust) else (model, False)


def _axes(factor: gtsam.NonlinearFactor) -> tuple[str, ...]:
    """Names of a factor's residuals if their noise is diagonal."""
    if not isinstance(plain_noise(factor)[0], gtsam.noiseModel.Diagonal) or factor.dim() < 2:
        return ()
    name = type(factor).__name__
    for part, axes in AXES.items():
        if part in name and len(axes) == factor.dim():
            return axes
    return tuple(str(k + 1) for k in range(factor.dim()))


def positions_of(values: gtsam.Values, keys: Sequence[int]) -> list[IntArray]:
    """Per variable, the components of its tangent that are a position in m: of poses, or of points without a pose."""
    none = np.zeros(0, np.int64)
    poses = dict.fromkeys(gtsam.utilities.allPose2s(values).keys(), np.array(POINTS["Pose2"]))
    poses |= dict.fromkeys(gtsam.utilities.allPose3s(values).keys(), np.array(POINTS["Pose3"]))
    if any(key in poses for key in keys):
        return [poses.get(key, none) for key in keys]
    points = (value_of(values, key) for key in keys)
    return [np.arange(len(point)) if isinstance(point, np.ndarray) else none for point in points]

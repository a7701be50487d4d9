"""`python -m tests.research mistakes`: from which stated noise on each mistake in a log becomes silent, world by world.

The cases are our own worlds, `visual:` and the files of `slamref example`; the mistakes are changes of what witnesses
compare, so that every format has them.
"""

import contextlib
import io
import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import slamref
from data.convert.__main__ import main as convert
from data.formats.open_log import load_folder
from data.log import Log
from data.questions import examination as ex
from data.questions.witnesses import Case, case_of
from data.se2 import wrap_angle
from eval.example import main as example
from tests.mistakes import log_of, world

FACTORS = (1.0, 3.0, 10.0, 30.0)
DEG = math.pi / 180.0
Change = Callable[[Case], Case]


def _mirrored(name: str) -> Change:
    return next(r.change for r in ex.READINGS if r.kind == ex.SIDE and r.of == name)


def _in_the_world(c: Case) -> Case:
    path = c.seen_from or c.along
    assert path is not None
    return replace(c, z=np.column_stack([c.z[:, 0], wrap_angle(c.z[:, 1] + path[0][:, 2])]))


def _ids(of: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda c: c if c.id is None else replace(c, id=of(c.id))


MISTAKES: dict[tuple[str, str], tuple[Change, tuple[str, str, str]]] = {
    (text, part): (change, named)
    for text, part, change, named in (
        ("v in km/h", "odometry", ex._faster(3.6), ("unit", "v", "km/h")),
        ("v in mm/s", "odometry", ex._faster(1e3), ("unit", "v", "mm/s")),
        ("turns in degrees", "odometry", ex._turning(1 / DEG), ("unit", "omega", "deg/s")),
        ("turns the other way", "odometry", ex._turning(-1.0), ("side", "omega", "")),
        ("v backward", "odometry", ex._faster(-1.0), ("side", "v", "")),
        ("v and omega exchanged", "odometry", lambda c: replace(c, u=ex.se2.along_arcs(*ex._arcs(c)[::-1])),
         ("exchanged", "v and omega", "")),
        ("ranges in cm", "seen", ex._seen(100.0, 1.0), ("unit", "range", "cm")),
        ("ranges in ft", "seen", ex._seen(1 / 0.3048, 1.0), ("unit", "range", "ft")),
        ("bearings in degrees", "seen", ex._seen(1.0, 1 / DEG), ("unit", "bearing", "deg")),
        ("bearings clockwise", "seen", ex._seen(1.0, -1.0), ("side", "bearing", "")),
        ("range and bearing exchanged", "seen", ex._swapped, ("exchanged", "range and bearing", "")),
        ("bearings in the world", "seen", _in_the_world, ("world", "bearing", "")),
        ("sensor turned by 90 deg", "seen", ex._turned_by(-90.0), ("turned", "sensor", "")),
        ("observations 0.3 s late", "seen", ex._late("observations", -0.3), ("clock", "observations", "")),
        ("observations 1 s late", "seen", ex._late("observations", -1.0), ("clock", "observations", "")),
        ("observations 20 s late", "seen", ex._late("observations", -20.0), ("clock", "observations", "")),
        ("random ids", "ids", _ids(lambda i: np.random.default_rng(0).permutation(i)), ("strange", "ids", "")),
        ("ids one more", "ids of the map", _ids(lambda i: np.where(i >= 0, i + 1, i)), ("shifted", "ids", "")),
        ("map in cm", "map", ex._on_map(100.0 * np.eye(2)), ("unit", "map", "cm")),
        ("y of the map the other way", "map", ex._on_map(np.diag([1.0, -1.0])), ("side", "map.y", "")),
        ("x and y of the map exchanged", "map", ex._on_map(np.eye(2)[::-1]), ("exchanged", "x and y of the map", "")),
        ("truth in cm", "truth", ex._truly(lambda p: p * [1e2, 1e2, 1.0]), ("unit", "truth", "cm")),
        ("truth in degrees", "truth", ex._truly(lambda p: p * [1, 1, 1 / DEG]), ("", "truth.theta", "")),
        ("y of the truth the other way", "truth", _mirrored("truth.y"), ("side", "truth.y", "")),
        ("x and y of the truth exchanged", "truth", ex._truly(lambda p: p[:, [1, 0, 2]]),
         ("exchanged", "x and y of the truth", "")),
        ("truth 0.5 s late", "truth", ex._late("truth", -0.5), ("clock", "truth", "")),
    )
}  # fmt: skip


def _example(folder: Path) -> Log:
    with contextlib.redirect_stdout(io.StringIO()):
        example([str(folder / "files")])
        text = (folder / "files" / "commands.sh").read_text().split("slamref convert ")[2].split("slamref run")[0]
        words = text.replace("\\\n", " ").split()
        assert convert([str(folder / "files" / w) if w.endswith(".csv") or w == "surveyed" else w for w in words]) == 0
    return load_folder(folder / "files" / "surveyed")


def study(out: Path, names: list[str]) -> None:
    """Print and write a row for each world, parts and mistake: what is named at each multiple of the noise."""
    for name in names:
        with tempfile.TemporaryDirectory() as at:
            folder = Path(at)
            log = (
                _example(folder) if name == "example" else log_of(folder, world(4)) if name == "robot"
                else slamref.open_log(name)
            )  # fmt: skip
        whole = case_of(log)
        bare = {"truth": None, "names": None, "places": None}
        for parts, c in (("all", whole), ("without truth", replace(whole, truth=None)),
                         ("odometry, observations", replace(whole, id=None, **bare))):  # fmt: skip
            have = {"odometry", "seen", *["truth"] * (c.truth is not None), *["map"] * (c.names is not None),
                    *["ids", "ids of the map"] * (c.id is not None)}  # fmt: skip
            have -= set() if c.names is not None else {"ids of the map"}
            none: tuple[Change, tuple[str, str, str]] = (lambda c: c, ("", "", ""))
            for (text, part), (change, named) in {("none", "odometry"): none, **MISTAKES}.items():
                if part not in have:
                    continue
                found = [_said(change(_noisier(c, k)), named) for k in FACTORS]
                print(f"{name:10} {parts:24} {text:32} {' '.join(f'{f:26.26}' for f in found)}", flush=True)


def _noisier(c: Case, k: float) -> Case:
    return replace(c, R=k**2 * c.R, spread=k**2 * c.spread)


def _said(c: Case, named: tuple[str, str, str]) -> str:
    """`+` if the mistake is named first, `or` if among equals, what else is named, or `-`."""
    found = ex.explanations(c)
    if not found:
        return "-"
    each = [e.readings for e in found]
    fits = [any(all(a in ("", b) for a, b in zip(named, (r.kind, r.of, r.unit))) for r in rs) for rs in each]
    if any(fits):
        return ("+" if fits[0] and len(fits) == 1 else "or") + "&" * (len(each[fits.index(True)]) - 1)
    return "; ".join(" & ".join(f"{r.kind} {r.of} {r.unit}{r.number:.3g}" for r in rs) for rs in each)

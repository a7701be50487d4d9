"""`python -m tests.research mistakes`: from which stated noise on each mistake in a log becomes silent, by world."""

import contextlib
import io
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import slamref
from data.convert.__main__ import main as convert
from data.formats.open_log import load_folder
from data.log import Log
from data.questions import readings as ex
from data.questions.examination import explanations
from data.questions.witnesses import Case, case_of
from data.se2 import wrap_angle
from eval.example import main as example
from tests.mistakes import DEG, log_of, world

FACTORS = (1.0, 3.0, 10.0, 30.0)
Change = Callable[[Case], Case]


def _in_the_world(c: Case) -> Case:
    path = c.seen_from or c.along
    assert path is not None
    return replace(c, z=np.column_stack([c.z[:, 0], wrap_angle(c.z[:, 1] + path[0][:, 2])]))


def _ids(of: Callable[[np.ndarray], np.ndarray]) -> Change:
    return lambda c: c if c.id is None else replace(c, id=of(c.id))


MISTAKES: tuple[tuple[str, str, Change, tuple[str, str, str]], ...] = (
    ("none", "seen", lambda c: c, ("", "", "")),
    ("v in km/h", "seen", ex.faster(3.6), ("unit", "v", "km/h")),
    ("v in mm/s", "seen", ex.faster(1e3), ("unit", "v", "mm/s")),
    ("turns in degrees", "seen", ex.turning(1 / DEG), ("unit", "omega", "deg/s")),
    ("turns the other way", "seen", ex.turning(-1.0), ("side", "omega", "")),
    ("v backward", "seen", ex.faster(-1.0), ("side", "v", "")),
    ("v and omega exchanged", "seen", lambda c: replace(c, u=ex.se2.along_arcs(*ex._arcs(c)[::-1])),
     ("exchanged", "v and omega", "")),
    ("ranges in cm", "seen", ex.seen_as(100.0, 1.0), ("unit", "range", "cm")),
    ("ranges in ft", "seen", ex.seen_as(1 / 0.3048, 1.0), ("unit", "range", "ft")),
    ("bearings in degrees", "seen", ex.seen_as(1.0, 1 / DEG), ("unit", "bearing", "deg")),
    ("bearings clockwise", "seen", ex.seen_as(1.0, -1.0), ("side", "bearing", "")),
    ("range and bearing exchanged", "seen", ex._swapped, ("exchanged", "range and bearing", "")),
    ("bearings in the world", "seen", _in_the_world, ("world", "bearing", "")),
    ("sensor turned by 90 deg", "seen", ex.turned_by(-90.0), ("turned", "sensor", "")),
    *((f"observations {s} s late", "seen", ex.late_by("observations", -s), ("clock", "observations", ""))
      for s in (0.3, 1.0, 20.0)),
    ("random ids", "ids", _ids(lambda i: np.random.default_rng(0).permutation(i)), ("strange", "ids", "")),
    ("ids one more", "ids of the map", _ids(lambda i: np.where(i >= 0, i + 1, i)), ("shifted", "ids", "")),
    ("map in cm", "map", ex.on_map(100.0 * np.eye(2)), ("unit", "map", "cm")),
    ("y of the map the other way", "map", ex.on_map(np.diag([1.0, -1.0])), ("side", "map.y", "")),
    ("x and y of the map exchanged", "map", ex.on_map(np.eye(2)[::-1]), ("exchanged", "x and y of the map", "")),
    ("truth in cm", "truth", ex.truly(lambda p: p * [1e2, 1e2, 1.0]), ("unit", "truth", "cm")),
    ("truth in degrees", "truth", ex.truly(lambda p: p * [1, 1, 1 / DEG]), ("", "truth.theta", "")),
    ("y of the truth the other way", "truth", ex.truly(lambda p: p * [1, -1, 1]), ("side", "truth.y", "")),
    ("x and y of the truth exchanged", "truth", ex.truly(lambda p: p[:, [1, 0, 2]]),
     ("exchanged", "x and y of the truth", "")),
    ("truth 0.5 s late", "truth", ex.late_by("truth", -0.5), ("clock", "truth", "")),
)  # fmt: skip
"""What is wrong, the part that a log needs for it, the change; kind, quantity and unit of what mends it."""


def _opened(name: str, folder: Path) -> Log:
    if name == "robot":
        return log_of(folder, world(4))
    if name != "example":
        return slamref.open_log(name)
    at = folder / "files"
    with contextlib.redirect_stdout(io.StringIO()):
        example([str(at)])
        text = (at / "commands.sh").read_text().split("slamref convert ")[2].split("slamref run")[0]
        words = text.replace("\\\n", " ").split()
        assert convert([str(at / w) if w.endswith(".csv") or w == "surveyed" else w for w in words]) == 0
    return load_folder(at / "surveyed")


def study(names: list[str]) -> None:
    """Print a row for each world, its parts and a mistake: what is named at each multiple of the noise."""
    for name in names:
        with tempfile.TemporaryDirectory() as at:
            whole = case_of(_opened(name, Path(at)))
        few = replace(whole, truth=None)
        for parts, c in (("all", whole), ("no truth", few), ("two", replace(few, id=None, names=None, places=None))):
            have = {"seen": True, "truth": c.truth is not None, "map": c.names is not None, "ids": c.id is not None}
            have["ids of the map"] = have["ids"] and have["map"]
            for text, part, change, named in MISTAKES:
                if have[part]:
                    noisy = (replace(c, R=k**2 * c.R, spread=k**2 * c.spread) for k in FACTORS)
                    said = " ".join(f"{_said(change(n), named):26.26}" for n in noisy)
                    print(f"{name:10} {parts:9} {text:32} {said}", flush=True)


def _said(c: Case, named: tuple[str, str, str]) -> str:
    each = [e.readings for e in explanations(c)]
    fits = [any(all(a in ("", b) for a, b in zip(named, (r.kind, r.of, r.unit))) for r in rs) for rs in each]
    others = "; ".join(" & ".join(f"{r.kind} {r.of} {r.unit}{r.number:.3g}" for r in rs) for rs in each)
    return ("+" if len(each) == 1 else "or") if any(fits) else others or "-"

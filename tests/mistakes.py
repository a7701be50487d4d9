"""A sound log of a simulated robot as tables of another program, and the same with one named mistake."""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np

from data.convert.__main__ import main as convert
from data.formats.open_log import load_folder
from data.log import Log
from data.se2 import Array, dead_reckoned, wrap_angle

RATE, SECONDS = 10.0, 120.0
DEG = np.pi / 180.0


@dataclass(frozen=True)
class Tables:
    """Odometry (K, 3) t, v, omega; observations (M, 4) t, range, bearing, id; map (L, 3) id, x, y; truth (K, 4) t, x,
    y, theta; the stated sigmas of v, omega per sqrt(s) and of range, bearing; `turned`: quaternions (K, 4) of the truth
    instead of theta.
    """

    odometry: Array
    seen: Array
    known: Array
    truth: Array
    sigmas: tuple[float, float, float, float]
    turned: Array | None = None


def world(seed: int, noise: float = 1.0, speed: float = 0.8) -> Tables:
    """A robot that drives, turns both ways, and stands now and then among 25 landmarks."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(RATE * SECONDS)) / RATE

    def waves(periods: tuple[float, float, float]) -> Array:
        phase, share = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.4, 1.0, 3)
        return np.sum([a * np.sin(2.0 * np.pi * t / p + b) for a, b, p in zip(share, phase, periods)], axis=0)

    v = np.clip(speed * (0.6 + 0.5 * waves((17.0, 7.0, 31.0))), 0.0, 2.0 * speed)
    w = 0.35 * waves((11.0, 23.0, 5.0)) + 0.05
    half = 0.5 * w / RATE
    steps = np.stack([v / RATE * np.sinc(half / np.pi) * np.cos(half),
                      v / RATE * np.sinc(half / np.pi) * np.sin(half), w / RATE], 1)  # fmt: skip
    path = dead_reckoned(np.array([1.0, -2.0, 0.7]), np.concatenate([np.zeros((1, 3)), steps[:-1]]))
    truth = np.column_stack([t, path[:, :2], wrap_angle(path[:, 2])])
    low, high = path[:, :2].min(axis=0) - 4.0, path[:, :2].max(axis=0) + 4.0
    places = rng.uniform(low, high, (25, 2))
    sigmas = tuple(noise * np.array([0.03, 0.02, 0.05, 1.0 * DEG]))
    a, b, c, d = sigmas
    odometry = np.column_stack([
        t, v + rng.normal(0.0, a * np.sqrt(RATE), len(t)), w + rng.normal(0.0, b * np.sqrt(RATE), len(t))
    ])  # fmt: skip
    seen = []
    for at in np.arange(0.25, SECONDS - 1.0, 0.5):
        x, y, h = (np.interp(at, t, path[:, k]) for k in range(3))
        away = places - [x, y]
        distance, bearing = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - h
        for i in np.flatnonzero((distance < 8.0) & (distance > 0.4) & (rng.random(25) < 0.8)):
            r, z = distance[i] + rng.normal(0.0, c), wrap_angle(bearing[i] + rng.normal(0.0, d))
            seen.append((at, abs(r), z, i + 3))
    return Tables(odometry, np.array(seen), np.column_stack([np.arange(25.0) + 3, places]), truth, sigmas)


Change = Callable[[Tables], Tables]


def _times(part: str, *factors: float) -> Change:
    """A table whose columns are multiplied."""
    return lambda t: replace(t, **{part: getattr(t, part) * np.array(factors)})


def _both(*changes: Change) -> Change:
    def change(t: Tables) -> Tables:
        for one in changes:
            t = one(t)
        return t

    return change


def _late(part: str, seconds: float) -> Change:
    """Stamps later than what they are of."""
    return lambda t: replace(t, **{part: getattr(t, part) + np.eye(getattr(t, part).shape[1])[0] * seconds})


def _swapped(part: str, i: int, j: int) -> Change:
    def change(t: Tables) -> Tables:
        table = getattr(t, part).copy()
        table[:, [i, j]] = table[:, [j, i]]
        return replace(t, **{part: table})

    return change


def _ids(part: str, column: int, of: Callable[[Array], Array]) -> Change:
    def change(t: Tables) -> Tables:
        table = getattr(t, part).copy()
        table[:, column] = of(table[:, column])
        return replace(t, **{part: table})

    return change


def _random(ids: Array) -> Array:
    return np.random.default_rng(0).permutation(ids)


def _exchanged(ids: Array) -> Array:
    return np.where(ids == 5, 9, np.where(ids == 9, 5, ids))


def _ahead(part: str, metres: float) -> Change:
    """The origin of polar coordinates, or poses, moved ahead."""

    def change(t: Tables) -> Tables:
        table = getattr(t, part).copy()
        if part == "truth":
            table[:, 1:3] += metres * np.stack([np.cos(table[:, 3]), np.sin(table[:, 3])], axis=1)
            return replace(t, truth=table)
        at = table[:, 1] * np.exp(1j * table[:, 2]) + metres
        table[:, 1], table[:, 2] = np.abs(at), np.angle(at)
        return replace(t, seen=table)

    return change


def _turned_sensor(angle: float) -> Change:
    def change(t: Tables) -> Tables:
        seen = t.seen.copy()
        seen[:, 2] = wrap_angle(seen[:, 2] - angle)
        return replace(t, seen=seen)

    return change


def _in_the_world(t: Tables) -> Tables:
    seen = t.seen.copy()
    seen[:, 2] = wrap_angle(seen[:, 2] + np.interp(seen[:, 0], t.truth[:, 0], np.unwrap(t.truth[:, 3])))
    return replace(t, seen=seen)


def _quaternions(order: str) -> Change:
    """Of the truth, written in an order into columns qx, qy, qz, qw; `inverse`: of the body from the world."""

    def change(t: Tables) -> Tables:
        half = 0.5 * t.truth[:, 3] * (-1.0 if order == "inverse" else 1.0)
        q = np.column_stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)])
        return replace(t, turned=q[:, [3, 0, 1, 2]] if order == "wxyz" else q)

    return change


def _compass(t: Tables) -> Tables:
    truth = t.truth.copy()
    truth[:, 3] = wrap_angle(0.5 * np.pi - truth[:, 3])
    return replace(t, truth=truth)


def _excursion(*lengths: float) -> Change:
    """Consecutive true poses that far off, in turning directions."""

    def change(t: Tables) -> Tables:
        truth = t.truth.copy()
        for k, far in enumerate(lengths):
            truth[600 + k, 1:3] += far * np.array([np.cos(2.0 * k), np.sin(2.0 * k)])
        return replace(t, truth=truth)

    return change


def _away(*offset: float) -> Change:
    def change(t: Tables) -> Tables:
        truth = t.truth.copy()
        c, s = np.cos(offset[2]), np.sin(offset[2])
        truth[:, 1:3] = truth[:, 1:3] @ np.array([[c, s], [-s, c]]) + offset[:2]
        truth[:, 3] = wrap_angle(truth[:, 3] + offset[2])
        return replace(t, truth=truth)

    return change


def _from(start: float, change: Change) -> Change:
    """A change of what is stamped later alone."""

    def later(t: Tables) -> Tables:
        rows = {p: getattr(t, p)[:, 0] >= start for p in ("odometry", "seen", "truth")}
        other = change(replace(t, **{p: getattr(t, p)[k] for p, k in rows.items()}))
        both = {p: np.vstack([getattr(t, p)[~k], getattr(other, p)]) for p, k in rows.items()}
        return replace(t, **both)

    return later


def _distances(t: Tables) -> Tables:
    return replace(
        t, odometry=np.column_stack([*t.odometry.T[:1], np.cumsum(t.odometry[:, 1]) / RATE, t.odometry[:, 2]])
    )


MM = _both(_times("odometry", 1, 1000, 1), _times("seen", 1, 1000, 1, 1), _times("known", 1, 1000, 1000),
           _times("truth", 1, 1000, 1000, 1))  # fmt: skip
CM = _both(_times("odometry", 1, 100, 1), _times("seen", 1, 100, 1, 1), _times("known", 1, 100, 100),
           _times("truth", 1, 100, 100, 1))  # fmt: skip
MISTAKES: dict[str, Change] = {
    "everything in mm": MM, "everything in cm": CM, "ranges in mm": _times("seen", 1, 1000, 1, 1),
    "ranges in cm": _times("seen", 1, 100, 1, 1), "ranges in feet": _times("seen", 1, 1 / 0.3048, 1, 1),
    "ranges 1.7 times as large": _times("seen", 1, 1.7, 1, 1), "v in mm/s": _times("odometry", 1, 1000, 1),
    "v in knots": _times("odometry", 1, 3600 / 1852, 1), "omega in rpm": _times("odometry", 1, 1, 30 / np.pi),
    "ranges in yards": _times("seen", 1, 1 / 0.9144, 1, 1),
    "stamps in min": _both(*(_times(p, 1 / 60, *(1,) * n) for p, n in (("odometry", 2), ("seen", 3), ("truth", 3)))),
    "observations 100 s late": _late("seen", 100.0), "sensor 1.2 m ahead": _ahead("seen", -1.2),
    "truth of an antenna": _ahead("truth", 0.8), "map x to the other side": _times("known", 1, -1, 1),
    "bearing and turn clockwise": _both(_times("odometry", 1, 1, -1), _times("seen", 1, 1, -1, 1)),
    "v and omega of a row": _times("odometry", 1, 1 / RATE, 1 / RATE), "v a distance": _distances,
    "from 60 s on 20 s late": _from(60.0, _late("seen", 20.0)),
    "from 60 s on to the other side": _from(60.0, _times("odometry", 1, 1, -1)),
    "v backward": _times("odometry", 1, -1, 1), "v in km/h": _times("odometry", 1, 3.6, 1),
    "omega in deg/s": _times("odometry", 1, 1, 1 / DEG), "map in mm": _times("known", 1, 1000, 1000),
    "truth in mm": _times("truth", 1, 1000, 1000, 1), "map y to the other side": _times("known", 1, 1, -1),
    "truth in degrees": _times("truth", 1, 1, 1, 1 / DEG), "bearings in degrees": _times("seen", 1, 1, 1 / DEG, 1),
    "stamps in ms": _both(*(_times(p, 1000, *(1,) * n) for p, n in (("odometry", 2), ("seen", 3), ("truth", 3)))),
    "ids of observations one more": _ids("seen", 3, lambda i: i + 1),
    "ids of the map one less": _ids("known", 0, lambda i: i - 1), "random ids": _ids("seen", 3, _random),
    "random ids of the map": _ids("known", 0, _random), "two ids exchanged": _ids("known", 0, _exchanged),
    "every observation twice": lambda t: replace(t, seen=np.repeat(t.seen, 2, axis=0)),
    "v and omega swapped": _swapped("odometry", 1, 2),
    "range and bearing swapped": _both(_ids("seen", 2, lambda b: b % (2.0 * np.pi)), _swapped("seen", 1, 2)),
    "omega to the other side": _times("odometry", 1, 1, -1), "bearings to the other side": _times("seen", 1, 1, -1, 1),
    "observations 0.3 s late": _late("seen", 0.3), "observations 1 s late": _late("seen", 1.0),
    "observations 0.6 s early": _late("seen", -0.6), "truth 0.5 s late": _late("truth", 0.5),
    "truth x and y swapped": _swapped("truth", 1, 2), "truth y to the other side": _times("truth", 1, 1, -1, 1),
    "truth with compass headings": _compass, "truth in another frame": _away(4.0, -3.0, 68.0 * DEG),
    "map x and y swapped": _swapped("known", 1, 2), "sensor turned by 90 deg": _turned_sensor(90.0 * DEG),
    "sensor turned by -90 deg": _turned_sensor(-90.0 * DEG), "sensor turned by 180 deg": _turned_sensor(180.0 * DEG),
    "sensor turned by 40 deg": _turned_sensor(40.0 * DEG), "bearings in the world": _in_the_world,
    "quaternions of the truth wxyz": _quaternions("wxyz"), "quaternions of the truth inverted": _quaternions("inverse"),
    "three bad true poses": _excursion(3.6, 1.0, 19.0),
    "eight bad true poses": _excursion(3.6, 1.0, 19.0, 7.0, 2.0, 5.0, 9.0, 4.0),
}  # fmt: skip


def write(folder: Path, t: Tables) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    truth, names = t.truth, "t,x,y,theta"
    if t.turned is not None:
        truth, names = np.column_stack([t.truth[:, :3], t.turned]), "t,x,y,qx,qy,qz,qw"
    for name, header, table in (
        ("odometry", "t,v,omega", t.odometry), ("seen", "t,range,bearing,id", t.seen),
        ("map", "id,x,y", t.known), ("truth", names, truth),
    ):  # fmt: skip
        number = [i for i, h in enumerate(header.split(",")) if h == "id"]
        form = ["%d" if i in number else "%.9g" for i in range(table.shape[1])]
        form[0] = "%.15g" if not number or number[0] else form[0]
        np.savetxt(folder / f"{name}.csv", table, fmt=form, delimiter=",", header=header, comments="")


def words(folder: Path, t: Tables, *, truth: bool = True, ids: bool = True, known: bool = True) -> list[str]:
    a, b, c, d = t.sigmas
    given = ["table", f"{folder}/odometry.csv", f"{folder}/log", "--observations", f"{folder}/seen.csv"]
    given += ["--columns", "label=id"] if ids else []
    given += ["--odometry-sigma", f"{a:.6g},{b:.6g}", "--observation-sigma", f"{c:.6g},{d:.6g}"]
    given += ["--map", f"{folder}/map.csv"] if known else []
    given += ["--truth", f"{folder}/truth.csv", "--prior", "truth"] if truth else []
    given += ["--prior", "1,-2,.7"] if known and not truth else []
    given += ["--prior-sigma", ".05,.05,1deg"] if known or truth else []
    return given


def log_of(folder: Path, t: Tables, *flags: str, **parts: bool) -> Log:
    write(folder, t)
    with contextlib.redirect_stdout(io.StringIO()), mock.patch("data.questions.asked.ask"):  # its test asks
        assert convert([*words(folder, t, **parts), *flags]) == 0
    return load_folder(folder / "log")

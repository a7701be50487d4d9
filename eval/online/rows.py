"""Frames of a drive and what estimators made of them as a chunk of the player's page (`eval.player.pack`).

A `Part` holds the plain numbers of some frames in a row; parts one behind the other make a chunk. Landmarks are walls:
x and y stand for rho [m] and alpha [rad].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data.result import DISCARD, MapState
from data.robot.frames import SENSOR
from data.se2 import Array, wrap_angle
from eval.online.session import Taken
from eval.player.of_run import ANGLE, COARSE, RHO, ROUGH, own_steps
from eval.player.pack import FURTHEST, Pack, text_of
from eval.player.watch import MapChanges, spread

QUANTUM = 1.0e-3
"""m, rad: smaller changes of a wall are left out."""
POSE = 1.0e-4
"""m."""


@dataclass(frozen=True, eq=False)
class Part:
    """Some frames in a row.

    Attributes:
        first, frames: number of the first, and how many.
        arrays: by name, rows in the order of time; `change` holds rows of `MapChanges`.
    """

    first: int
    frames: int
    arrays: Mapping[str, Array]


def key_of(number: int) -> str:
    """Names of an estimator's arrays begin with it."""
    return f"r{number}."


def part_of(taken: Sequence[Taken], changes: Sequence[Array]) -> Part:
    """Frames, at least one, with the changes (C, 8) of each estimator's map meanwhile."""
    frames = [t.frame for t in taken]
    z, R = (np.concatenate([getattr(f.sightings, name) for f in frames]) for name in ("z", "R"))
    points, covariance = SENSOR.body_points(z, R)
    arrays: dict[str, Array] = {
        "time": np.array([f.time for f in frames]),
        "count": np.array([float(len(f.sightings.z)) for f in frames]),
        "point": points,
        "point_spread": spread(covariance),
    }
    for i, changed in enumerate(changes):
        steps, key = [t.steps[i] for t in taken], key_of(i)
        poses = np.full((len(frames), 6), np.nan)  # x, y, theta, and their sigmas
        rho, nis = np.full(len(frames), np.nan), np.full(len(frames), np.nan)
        for k, step in enumerate(steps):
            if step is not None:
                poses[k, :3], poses[k, 3:] = step.mean, np.sqrt(np.maximum(np.diag(step.covariance), 0.0))
                rho[k], nis[k] = spread(step.covariance[None])[0, 2], step.nis
        blank = [np.full(len(f.sightings.z), DISCARD) for f in frames]
        decisions = [b if s is None else s.decisions for b, s in zip(blank, steps, strict=True)]
        created = [b if s is None else s.created for b, s in zip(blank, steps, strict=True)]
        arrays |= {
            f"{key}pose": poses, f"{key}rho": rho, f"{key}nis": nis, f"{key}change": changed,
            f"{key}decision": np.concatenate(decisions).astype(float),
            f"{key}created": np.concatenate(created).astype(float),
        }  # fmt: skip
    return Part(frames[0].number, len(frames), arrays)


def joined(parts: Sequence[Part]) -> Part:
    """Parts that go on from each other, as one."""
    names = parts[0].arrays
    arrays = {name: np.concatenate([part.arrays[name] for part in parts]) for name in names}
    return Part(parts[0].first, sum(part.frames for part in parts), arrays)


def chunk_of(part: Part, header: Mapping[str, object]) -> bytes:
    """A part as a chunk, in JSON; `header` is what the page is told beside."""
    pack, a = Pack(part.first, part.frames), part.arrays
    pack.add("time", a["time"], 1.0e-4)
    pack.add("count", a["count"])
    pack.add("point", a["point"], POSE)
    pack.add_log("point_sigma", a["point_spread"][:, :2])
    pack.add("point_rho", a["point_spread"][:, 2], RHO)
    for key in sorted({name.partition(".")[0] + "." for name in a if "." in name}):
        poses = a[f"{key}pose"]
        pack.add(f"{key}online_xy", poses[:, :2], POSE)
        pack.add(f"{key}online_theta", wrap_angle(poses[:, 2]), ANGLE)
        pack.add_log(f"{key}online_sigma", poses[:, 3:])
        pack.add(f"{key}online_rho", a[f"{key}rho"], RHO)
        pack.add_log(f"{key}nis", a[f"{key}nis"])
        pack.add(f"{key}decision", a[f"{key}decision"])
        pack.add(f"{key}created", a[f"{key}created"])
        _add_changes(pack, key, a[f"{key}change"])
    return text_of(pack.done(header)).encode()


def _add_changes(pack: Pack, key: str, changes: Array) -> None:
    """As in `eval.player.of_run`; differences of each landmark begin anew in each chunk."""
    for name, column in (("frame", 0), ("number", 1), ("there", 2)):
        pack.add(f"{key}change_{name}", changes[:, column])
    sigma = np.round(np.log(np.maximum(changes[:, 5:7], 1.0e-9)) / COARSE)
    place = np.clip(np.round(changes[:, 3:5] / QUANTUM), -FURTHEST, FURTHEST)
    values = np.column_stack([place, sigma, np.round(changes[:, 7] / ROUGH)])
    pack.add_steps(f"{key}change", own_steps(changes[:, 1].astype(np.int64), values))


class Maps:
    """The maps of the estimators, as far as the page knows them."""

    def __init__(self, estimators: int) -> None:
        """Nothing known yet."""
        self._known = [MapChanges(QUANTUM) for _ in range(estimators)]

    def changes(self, frame: int, maps: Sequence[MapState | None], *, whole: bool) -> list[Array]:
        """Changes (C, 8) of each map up to a frame; of an unknown one none. `whole`: all of it, as if it were new."""
        return [
            np.empty((0, 8)) if state is None else known.since(frame, state, whole=whole)
            for known, state in zip(self._known, maps, strict=True)
        ]

"""Transforms between the frames of a bag over time (tf), and a trajectory taken from one frame to another.

`T_pc` is the pose of the child in its parent. A static transform holds always. Others are interpolated between their
stamps, and held before the first and after the last.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from data import se3
from data.formats.recordings.ros import rotation_of, stamp_of
from data.formats.results.path import WORLD, GivenPath, Spatial
from data.formats.results.space import flattened, in_world, moved
from data.se2 import Array


def bare(frame: str) -> str:
    """Name of a frame without the leading slash of ROS 1."""
    return frame.lstrip("/")


@dataclass
class Moving:
    """Stamps [s], translations and quaternions (x, y, z, w) of a frame in its parent."""

    parent: str
    static: bool
    stamp: list[float] = field(default_factory=list)
    translation: list[tuple[float, ...]] = field(default_factory=list)
    quaternion: list[tuple[float, ...]] = field(default_factory=list)

    def at(self, time: Array) -> tuple[Array, Array]:
        """Rotations (n, 3, 3) and translations (n, 3) at times (n,)."""
        order = np.argsort(self.stamp, kind="stable")
        stamps = np.array(self.stamp)[order]
        R, t = rotation_of(np.array(self.quaternion)[order]), np.array(self.translation)[order]
        if self.static or len(stamps) == 1:
            return np.tile(R[-1], (len(time), 1, 1)), np.tile(t[-1], (len(time), 1))
        after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
        width = stamps[after] - stamps[after - 1]
        share = np.clip((time - stamps[after - 1]) / np.where(width > 0.0, width, 1.0), 0.0, 1.0)
        rotation = se3.between_rotations(R[after - 1], R[after], share)
        return rotation, t[after - 1] + share[:, None] * (t[after] - t[after - 1])


@dataclass
class Tree:
    """The last-stated parent of each frame, with its transforms."""

    moving: dict[str, Moving] = field(default_factory=dict)

    def add(self, parent: str, child: str, stamp: float, numbers: tuple[float, ...], *, static: bool) -> None:
        """Keep a transform: translation and quaternion, 7 numbers; one with NaN is left out."""
        if not np.isfinite(numbers).all() or not any(numbers[3:]):
            return
        parent, child = bare(parent), bare(child)
        known = self.moving.get(child)
        if known is None or known.parent != parent:
            known = self.moving[child] = Moving(parent, static)
        known.stamp.append(stamp)
        known.translation.append(numbers[:3])
        known.quaternion.append(numbers[3:])

    def add_message(self, message: Any, recorded: float, *, static: bool) -> None:
        """Keep the transforms of a message of tf, recorded at a time [s]."""
        for t in message.transforms:
            p, q = t.transform.translation, t.transform.rotation
            numbers = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
            self.add(t.header.frame_id, t.child_frame_id, stamp_of(t, recorded), numbers, static=static)

    def between(self, target: str, source: str, time: Array) -> tuple[Array, Array] | None:
        """Rotations (n, 3, 3) and translations (n, 3) of the source's frame in the target's at times; None: unknown."""
        up, down = self._ancestors(target), self._ancestors(source)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        (Rt, tt), (Rs, ts) = self._in(common, target, time), self._in(common, source, time)
        back = Rt.transpose(0, 2, 1)
        return back @ Rs, np.einsum("nij,nj->ni", back, ts - tt)

    def carries(self, body: str, frame: str) -> bool:
        """Whether a frame is mounted on a body, or is the body itself."""
        return bare(body) in self._ancestors(frame)

    def _ancestors(self, name: str) -> list[str]:
        chain = [bare(name)]
        while chain[-1] in self.moving and self.moving[chain[-1]].parent not in chain:
            chain.append(self.moving[chain[-1]].parent)
        return chain

    def _in(self, ancestor: str, name: str, time: Array) -> tuple[Array, Array]:
        R, t = np.tile(np.eye(3), (len(time), 1, 1)), np.zeros((len(time), 3))
        name = bare(name)
        while name != ancestor:
            Rp, tp = self.moving[name].at(time)
            R, t = Rp @ R, np.einsum("nij,nj->ni", Rp, t) + tp
            name = self.moving[name].parent
        return R, t


def in_frame(path: GivenPath, world: str, body: str, trees: tuple[Tree, ...]) -> GivenPath | None:
    """A trajectory in space in the stated frames of another; itself where they are the same or not stated.

    None where a transform is unknown.
    """
    s = path.space
    if s is None:
        return path
    made = s
    if world and bare(s.stated.world) and bare(world) != bare(s.stated.world):
        found = next((T for tree in trees if (T := tree.between(world, s.stated.world, s.time)) is not None), None)
        if found is None:
            return None
        made = moved(made, *found)
        made = replace(made, stated=replace(made.stated, world=world))
    if body and bare(s.stated.body) and bare(body) != bare(s.stated.body):
        found = next((T for tree in trees if (T := tree.between(s.stated.body, body, s.time)) is not None), None)
        if found is None:
            return None
        made = _seen_from(made, *found)
        made = replace(made, stated=replace(made.stated, body=body))
    if made is s:
        return path
    old, new = (" and ".join(filter(None, pair)) for pair in ((s.stated.world, s.stated.body), (world, body)))
    note = f"taken from the frames {old} to {new} by tf"
    made = replace(made, notes=(*made.notes, note))
    return replace(flattened(made), transforms=path.transforms)


def _seen_from(s: Spatial, R: Array, t: Array) -> Spatial:
    """The trajectory of another frame of the body: its rotations (n, 3, 3) and positions (n, 3) in the present one."""
    arm = np.einsum("nij,nj->ni", s.rotation, t)
    C = s.covariance
    if C is not None:
        J = np.zeros((len(s), 6, 6))
        J[:] = np.eye(6)
        J[:, :3, 3:] = -se3.skew(arm)
        C = J @ in_world(s) @ J.transpose(0, 2, 1)
    frame = s.frame if C is None else WORLD
    return replace(s, position=s.position + arm, rotation=s.rotation @ R, covariance=C, frame=frame)

"""A trajectory of a bag taken from one frame to another, by the transforms that tf states."""

from dataclasses import replace

import numpy as np

from data import se3
from data.formats.recordings.ros import Tree, bare
from data.formats.results.path import WORLD, GivenPath, Spatial
from data.formats.results.space import flattened, in_world, moved
from data.se2 import Array


def in_frame(path: GivenPath, world: str, body: str, trees: tuple[Tree, ...]) -> GivenPath | None:
    """A trajectory in space in the stated frames of another, or itself; None where a transform is unknown."""
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
    made = replace(made, notes=(*made.notes, f"taken from the frames {old} to {new} by tf"))
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

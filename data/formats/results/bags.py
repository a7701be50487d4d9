"""Poses of a ROS bag, with frames and transforms.

`PoseWithCovarianceStamped` and `Odometry` have a 6x6 covariance, row by row, about fixed axes of the header's frame:
`world` here. All zeros, NaN, or -1 first, mean unknown. Other poses and places, the last `Path` and tf have none.
"""

from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError
from data.formats.recordings import ros
from data.formats.recordings.ros import ODOMETRY, OLD_TRANSFORMS, TRANSFORMS, Tree, opened, stamp_of
from data.formats.results.path import ROWS, STATED, WORLD, Clock, GivenPath, Manner, Spatial, Stated, without_headings
from data.formats.results.space import full, known_only, on_plane, rotations

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
WITH_COVARIANCE = (POSE, ODOMETRY)
USUAL = (*WITH_COVARIANCE, PATH, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
KINDS = (*USUAL, *ros.PLACES, "geometry_msgs/msg/PoseArray")


def is_table(path: Path, topic: str) -> bool:
    """Whether a topic of a bag is there, and neither of poses nor of tf."""
    with opened(path) as reader:
        kinds = {c.msgtype for c in reader.connections if c.topic.strip("/") == topic.strip("/")}
    return bool(kinds) and not kinds & {*KINDS, TRANSFORMS, OLD_TRANSFORMS}


def read_bag(path: Path, topic: str | None, manner: Manner) -> GivenPath:
    """Poses of a topic, or of the only one, by stamp. UsageError: which topic, or no `rosbags`; DataError: bad data."""
    tree, rows, frames, unstamped = Tree(), list[list[float]](), set[tuple[str, str]](), 0
    with opened(path, frozenset(KINDS)) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections if c.msgtype in KINDS}
        tf, (name, _, pair) = (TRANSFORMS, OLD_TRANSFORMS), (topic or "").partition(":")
        moved = any(c.msgtype in tf for c in reader.connections)
        of_tf = name.strip("/") == "tf" or (topic is None and moved and not {*kinds.values()} & {*USUAL})
        topic = (topic or "/tf") if of_tf else _topic(path, kinds, topic)
        wanted = [c for c in reader.connections if c.topic == topic or c.msgtype in tf]
        for c, recorded, raw in reader.messages(wanted) if wanted else ():
            message = reader.deserialize(raw, c.msgtype)
            if c.msgtype in tf:
                tree.add_message(message, 1e-9 * recorded, static=c.topic.endswith("static"))
            elif c.msgtype == PATH:
                rows = [_row(each, 1e-9 * recorded, path) for each in message.poses]
                frames = {(message.header.frame_id, "")}
            else:
                unstamped += stamp_of(message, 0.0) == 0.0
                rows.append(_row(message, 1e-9 * recorded, path))
                frames.add(ros.frames_of(message))
    file = f"{path}:{topic}"
    if of_tf:
        return on_plane(_of_tf(path, tree, pair), manner)  # its own transforms compare it with nothing
    if not rows:
        raise DataError.at(file, "no message; at least one is needed")
    if len(frames) > 1:
        named = ", ".join(sorted("/".join(filter(None, pair)) for pair in frames))
        raise DataError.at(file, f"messages state the frames {named}; one is needed")
    told = f"{unstamped} of {len(rows)} messages have no stamp: the time of recording is taken"
    ((world, body),) = frames
    table = np.array(rows)
    if absent := not table[:, 4:8].any():
        table[:, 7] = 1.0
    found = _spatial(file, kinds[topic], table, Stated(world, body, order=True), (told,) * bool(unstamped))
    read = without_headings(on_plane(found, manner)) if absent else on_plane(found, manner)
    return replace(read, transforms=tree if tree.moving else None)


def _of_tf(path: Path, tree: Tree, pair: str) -> Spatial:
    """Poses of a frame in another one, `PARENT.CHILD`, or of the only moving one, at the stamps of what moves it."""
    moving = [f"{of.parent}.{child}" for child, of in tree.moving.items() if of.moves]
    parent, _, child = (moving[0] if len(moving) == 1 and not pair else pair).partition(".")
    chain = tree.ancestors(child)
    by = next((tree.moving[name] for name in chain if name in tree.moving and tree.moving[name].moves), None)
    stamp = np.unique(by.stamp if by else [])
    if (found := tree.between(parent, child, stamp)) is None or by is None:
        there = ", ".join(sorted(moving)) or "none"
        raise UsageError(f"{path}: which transform? {path}:/tf:PARENT.CHILD is needed; moving ones: {there}")
    stated, name, (R, p) = Stated(parent, child, order=True), f"{path}:/tf:{parent}.{child}", found
    inside = np.ones(len(stamp), bool)  # of the stamps of all that move it, and one step of each
    for frame in takewhile(lambda frame: frame != ros.bare(parent), chain):
        if (own := tree.moving.get(frame)) is None or not own.moves:
            continue
        step = float(np.median(np.diff(np.sort(own.stamp)))) if len(own.stamp) > 1 else 0.0
        inside &= (stamp >= min(own.stamp) - step) & (stamp <= max(own.stamp) + step)
    told = f"{int((~inside).sum())} of {len(stamp)} poses are outside the stamps of the transforms they need: left out"
    stamp, R, p = stamp[inside], R[inside], p[inside]

    def place(k: int) -> str:
        return f"{name}: {stamp[k]:.6f} s"

    notes = (told,) * (not inside.all())
    return Spatial(name, TRANSFORMS, stamp, p, R, None, WORLD, place, stated, notes, Clock("s", STATED))


def _topic(path: Path, kinds: dict[str, str], topic: str | None) -> str:
    """The requested topic, or the only one of poses; of several the only one of a usual type, or with covariance."""
    there = ", ".join(sorted(kinds)) or f"none (slamref convert bag {path} --list names all topics)"
    if topic is None:
        some = ([t for t, kind in kinds.items() if kind in of] for of in ({*USUAL, *ros.POSED}, USUAL, WITH_COVARIANCE))
        only = next((topics for topics in some if len(topics) == 1), [])
        if not only:
            raise UsageError(f"{path}: which topic? {path}:/TOPIC is needed; with poses: {there}")
        return only[0]
    same = [t for t in kinds if t.strip("/") == topic.strip("/")]  # old bags hold names without a slash
    if not same:
        raise UsageError(f"{path}: no poses on {topic}; such topics: {there}, or a transform: {path}:/tf")
    return same[0]


def _spatial(file: str, kind: str, table: Any, stated: Stated, notes: tuple[str, ...]) -> Spatial:
    """Rows of 44 numbers, sorted by stamp."""
    order = np.argsort(table[:, 0], kind="stable")

    def place(k: int) -> str:
        return f"{file}: message {int(order[k])}"

    table = table[order]
    table[~np.isfinite(table)] = np.nan
    C, more = full(table[:, 8:], place)
    covariance, unknown = known_only(C) if kind in WITH_COVARIANCE else (None, ())
    kind, clock = f"{kind}, frame {stated.world or 'not stated'}", Clock("s", STATED)
    if len(table) > 1 and not np.ptp(table[:, 0]):
        table[:, 0], clock = np.arange(len(table)), Clock("s", ROWS)
        notes = (*notes, "all stamps are equal: its poses belong to the rows of the other file")
    R = rotations(table[:, 4:8], place)
    p = table[:, 1:4]
    return Spatial(file, kind, table[:, 0], p, R, covariance, WORLD, place, stated, (*notes, *more, *unknown), clock)


def _row(message: Any, recorded: float, path: Path) -> list[float]:
    """Stamp, position, quaternion, covariance: 44 numbers."""
    C: Any = getattr(getattr(message, "pose", None), "covariance", np.zeros(36))
    return [stamp_of(message, recorded), *ros.placed(message, str(path)), *np.asarray(C, float).tolist()]

"""Small ROS bags, written with rosbags' own writers, and the sentence with which tests without it are skipped."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data.se2 import Array

rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'slamref[ros]'")
from rosbags.interfaces import Nodetype  # noqa: E402
from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

FORMS = ("ros1", "sqlite3", "mcap")
SCAN, ODOMETRY, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
START = 1_700_000_000


class Maker:
    def __init__(self, form: str) -> None:
        self.form, self.old = form, form == "ros1"
        self.store: Any = get_typestore(Stores.ROS1_NOETIC if self.old else Stores.ROS2_HUMBLE)
        if self.old:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        self.messages: list[tuple[float, str, str, Any]] = []
        self.empty: list[tuple[str, str]] = []  # topics without a message, and their types

    def _of(self, kind: str, *values: Any, **named: Any) -> Any:
        return self.store.types[kind](*values, **named)

    def _zero(self, kind: str, **given: Any) -> Any:
        """A message of zeros, but for what is given."""

        def blank(node: Any, inside: Any) -> Any:
            if node == Nodetype.NAME:
                return self._zero(inside)
            if node == Nodetype.BASE:
                return "" if inside[0] == "string" else 0
            of, count = inside[0], inside[1] if node == Nodetype.ARRAY else 0
            return np.zeros(count, of[1][0]) if of[0] == Nodetype.BASE and of[1][0] != "string" else []

        fields = self.store.fielddefs[kind][1]
        return self._of(kind, **{n: given[n] if n in given else blank(*inside) for n, inside in fields})

    def _header(self, frame: str, stamp: float | None) -> Any:
        """`stamp`: s after `START`; None: never set."""
        whole = 0 if stamp is None else START + math.floor(stamp)
        part = 0 if stamp is None else round((stamp - math.floor(stamp)) * 1e9)
        time = self._of("builtin_interfaces/msg/Time", whole, part)
        return self._zero("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def _point(self, x: float, y: float, z: float = 0.0, kind: str = "Point") -> Any:
        return self._of(f"geometry_msgs/msg/{kind}", float(x), float(y), float(z))

    def _turn(self, yaw: float, *, upside_down: bool = False) -> Any:
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
        return self._of("geometry_msgs/msg/Quaternion", *((c, s, 0.0, 0.0) if upside_down else (0.0, 0.0, s, c)))

    def scan(
        self, at: float, ranges: Sequence[float], topic: str = "/scan", *, stamped: bool = True, **changed: float
    ) -> None:
        geometry = {"angle_min": -0.5, "angle_max": 0.5, "angle_increment": 0.5, "range_min": 0.25, "range_max": 8.0}
        header, ranges = self._header("laser", at if stamped else None), np.array(ranges, np.float32)
        self.messages.append((at, topic, SCAN, self._zero(SCAN, header=header, ranges=ranges, **geometry | changed)))

    def odometry(
        self, at: float, pose: Iterable[float], topic: str = "/odom", twist: float = 0.0, body: str = "base_link"
    ) -> None:
        """`twist`: variance of the velocity along; half of it across, a tenth of the turn."""
        x, y, yaw = pose
        place = self._zero("geometry_msgs/msg/Pose", position=self._point(x, y), orientation=self._turn(yaw))
        covariance = np.diag(twist * np.array([1.0, 0.5, 9.0, 9.0, 9.0, 0.1])).ravel()
        pose, moved = (f"geometry_msgs/msg/{name}WithCovariance" for name in ("Pose", "Twist"))
        message = self._zero(
            ODOMETRY, header=self._header("odom", at), child_frame_id=body, pose=self._zero(pose, pose=place),
            twist=self._zero(moved, covariance=covariance),
        )  # fmt: skip
        self.messages.append((at, topic, ODOMETRY, message))

    def mounting(self, parent: str, child: str, x: float, y: float, yaw: float, *, upside_down: bool = False) -> None:
        self._moved(-1.0, "/tf_static", 0.0, parent, child, (x, y, 0.5), self._turn(yaw, upside_down=upside_down))

    def transform(self, at: float, parent: str, child: str, pose: Iterable[float]) -> None:
        """One that changes: the pose of a frame in its parent at a time."""
        x, y, yaw = pose
        self._moved(at, "/tf", at, parent, child, (x, y, 0.0), self._turn(yaw))

    def _moved(
        self, at: float, topic: str, stamp: float, parent: str, child: str, place: Sequence[float], turn: Any
    ) -> None:
        moved = self._of("geometry_msgs/msg/Transform", self._point(*place, kind="Vector3"), turn)
        stamped = self._of("geometry_msgs/msg/TransformStamped", self._header(parent, stamp), child, moved)
        self.messages.append((at, topic, TF, self._of(TF, [stamped])))

    def drive(self, times: Array) -> None:
        for t in times.tolist():
            self.odometry(t, (t, 0.0, 0.1 * t))

    def save(self, folder: Path, *compression: Any) -> Path:
        """The bag; messages of a topic share a connection. `compression`: what a writer calls so."""
        path = folder / ("small.bag" if self.old else "small")
        plugin = StoragePlugin.MCAP if self.form == "mcap" else StoragePlugin.SQLITE3
        writer: Any = Writer1(path) if self.old else Writer2(path, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(*compression)
        with writer:
            connections: dict[str, Any] = {t: writer.add_connection(t, k, typestore=self.store) for t, k in self.empty}
            for at, topic, kind, message in sorted(self.messages, key=lambda m: m[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                raw = (self.store.serialize_ros1 if self.old else self.store.serialize_cdr)(message, kind)
                writer.write(connections[topic], START * 10**9 + round(at * 1e9), raw)
        return path

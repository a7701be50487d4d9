"""Small ROS bags, written with rosbags' own writers, and the sentence with which tests without it are skipped."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data.se2 import Array

rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'slamref[ros]'")
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

    def _of(self, kind: str, *values: Any, **named: Any) -> Any:
        return self.store.types[kind](*values, **named)

    def _header(self, frame: str, stamp: float | None) -> Any:
        """`stamp`: s after `START`; None: never set."""
        whole = 0 if stamp is None else START + math.floor(stamp)
        part = 0 if stamp is None else round((stamp - math.floor(stamp)) * 1e9)
        time = self._of("builtin_interfaces/msg/Time", whole, part)
        seq = {"seq": 0} if self.old else {}
        return self._of("std_msgs/msg/Header", stamp=time, frame_id=frame, **seq)

    def _turn(self, yaw: float, *, upside_down: bool = False) -> Any:
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
        return self._of("geometry_msgs/msg/Quaternion", *((c, s, 0.0, 0.0) if upside_down else (0.0, 0.0, s, c)))

    def scan(
        self, at: float, ranges: Sequence[float], topic: str = "/scan", *, stamped: bool = True, **changed: float
    ) -> None:
        geometry = {"angle_min": -0.5, "angle_max": 0.5, "angle_increment": 0.5, "range_min": 0.25, "range_max": 8.0}
        geometry |= {"time_increment": 0.0, "scan_time": 0.1} | changed
        header = self._header("laser", at if stamped else None)
        values = {"ranges": np.array(ranges, np.float32), "intensities": np.zeros(0, np.float32)}
        self.messages.append((at, topic, SCAN, self._of(SCAN, header=header, **geometry, **values)))

    def odometry(
        self, at: float, pose: Iterable[float], topic: str = "/odom", twist: float = 0.0, body: str = "base_link"
    ) -> None:
        """`twist`: variance of the velocity along; half of it across, a tenth of the turn."""
        x, y, yaw = pose
        vector = self._of("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        point = self._of("geometry_msgs/msg/Point", float(x), float(y), 0.0)
        place = self._of("geometry_msgs/msg/Pose", point, self._turn(yaw))
        covariance = np.zeros(36)
        message = self._of(
            ODOMETRY,
            header=self._header("odom", at),
            child_frame_id=body,
            pose=self._of("geometry_msgs/msg/PoseWithCovariance", place, covariance),
            twist=self._of(
                "geometry_msgs/msg/TwistWithCovariance",
                self._of("geometry_msgs/msg/Twist", vector, vector),
                np.diag(twist * np.array([1.0, 0.5, 9.0, 9.0, 9.0, 0.1])).ravel(),
            ),
        )
        self.messages.append((at, topic, ODOMETRY, message))

    def mounting(self, parent: str, child: str, x: float, y: float, yaw: float, *, upside_down: bool = False) -> None:
        moved = self._of("geometry_msgs/msg/Vector3", float(x), float(y), 0.5)
        transform = self._of("geometry_msgs/msg/Transform", moved, self._turn(yaw, upside_down=upside_down))
        stamped = self._of("geometry_msgs/msg/TransformStamped", self._header(parent, 0.0), child, transform)
        self.messages.append((-1.0, "/tf_static", TF, self._of(TF, [stamped])))

    def transform(self, at: float, parent: str, child: str, pose: Iterable[float]) -> None:
        """One that changes: the pose of a frame in its parent at a time."""
        x, y, yaw = pose
        moved = self._of("geometry_msgs/msg/Vector3", float(x), float(y), 0.0)
        transform = self._of("geometry_msgs/msg/Transform", moved, self._turn(yaw))
        stamped = self._of("geometry_msgs/msg/TransformStamped", self._header(parent, at), child, transform)
        self.messages.append((at, "/tf", TF, self._of(TF, [stamped])))

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
            connections: dict[str, Any] = {}
            for at, topic, kind, message in sorted(self.messages, key=lambda m: m[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                raw = (self.store.serialize_ros1 if self.old else self.store.serialize_cdr)(message, kind)
                writer.write(connections[topic], START * 10**9 + round(at * 1e9), raw)
        return path

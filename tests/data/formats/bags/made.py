"""Bags with detections, fixes and truth, written with rosbags' own writers."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tests.data.formats.recordings.ros.bags import START, Maker, get_types_from_msg

VISION = {
    "uwb_msgs/msg/Ranging": "int16 anchorId\nint16 tagId\nint32 range\nfloat64 rss",
    "uwb_msgs/msg/Radar": "int16 id\nfloat32 distance\nfloat32 azimuth",
    "uwb_msgs/msg/One": "float64 range\nint32 id",
    "uwb_msgs/msg/Many": "std_msgs/Header header\ngeometry_msgs/Pose sensor_pose_on_robot\nuwb_msgs/One[] seen",
    "uwb_msgs/msg/Radars": "uwb_msgs/Radar[] seen",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\n"
        "string id"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y",
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\napriltag_msgs/Point centre",
    "apriltag_msgs/msg/AprilTagDetectionArray": "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections",
}


class Full(Maker):
    """A maker of all messages that a log may be made of."""

    def __init__(self, form: str = "mcap") -> None:
        super().__init__(form)
        types: dict[str, Any] = {}
        for name, text in VISION.items():
            types |= get_types_from_msg(text, name)
        self.store.register(types)

    def _pose(self, x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> Any:
        return self._of("geometry_msgs/msg/Pose", self._point(x, y, z), self._turn(yaw))

    def _send(self, at: float, topic: str, kind: str, **values: Any) -> None:
        self.messages.append((at, topic, kind, self._zero(kind, **values)))

    def satellites(self, at: float, place: Iterable[float], variance: float = 0.0, *, fix: bool = True) -> None:
        latitude, longitude = place
        self._send(
            at, "/gps", "sensor_msgs/msg/NavSatFix", header=self._header("antenna", at),
            status=self._of("sensor_msgs/msg/NavSatStatus", 0 if fix else -1, 1),
            latitude=latitude, longitude=longitude, altitude=10.0,
            position_covariance=np.array([variance, 0, 0, 0, 4 * variance, 0, 0, 0, 9.0]),
            position_covariance_type=2 if variance else 0,
        )  # fmt: skip

    def inertial(self, at: float, yaw: float, variance: float = 0.0) -> None:
        covariance = np.diag([1e-4, 1e-4, variance]).ravel()
        kind, turn = "sensor_msgs/msg/Imu", self._turn(yaw)
        self._send(
            at, "/imu", kind, header=self._header("imu", at), orientation=turn, orientation_covariance=covariance
        )

    def pose(self, at: float, pose: Iterable[float], topic: str = "/amcl_pose", variance: ArrayLike = 0.0) -> None:
        """`variance`: of x, or the whole covariance (6, 6)."""
        C = np.asarray(variance, float) if np.ndim(variance) else variance * np.diag([1.0, 2.0, 9.0, 9.0, 9.0, 0.5])
        stated = self._of("geometry_msgs/msg/PoseWithCovariance", self._pose(*pose), C.ravel())
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        self._send(at, topic, kind, header=self._header("map", at), pose=stated)

    def bare_pose(
        self, at: float, pose: Iterable[float], topic: str = "/mocap", frame: str = "map", *, stamped: bool = True
    ) -> None:
        header = self._header(frame, at if stamped else None)
        self._send(at, topic, "geometry_msgs/msg/PoseStamped", header=header, pose=self._pose(*pose))

    def place(self, at: float, xy: Iterable[float], topic: str = "/prism") -> None:
        kind = "geometry_msgs/msg/PointStamped"
        self._send(at, topic, kind, header=self._header("map", at), point=self._point(*xy))

    def poses(self, at: float, points: Iterable[Iterable[float]], frame: str = "camera", topic: str = "/cones") -> None:
        kind = "geometry_msgs/msg/PoseArray"
        self._send(at, topic, kind, header=self._header(frame, at), poses=[self._pose(x, y) for x, y in points])

    def markers(self, at: float, seen: Iterable[tuple[int, float, float]], frame: str = "camera") -> None:
        one, head = "visualization_msgs/msg/Marker", self._header(frame, at)
        markers = [self._zero(one, header=head, id=number, type=1, pose=self._pose(x, y)) for number, x, y in seen]
        self._send(at, "/markers", "visualization_msgs/msg/MarkerArray", markers=markers)

    def boxes(self, at: float, seen: Iterable[tuple[str, float, float]], frame: str = "camera") -> None:
        one, box = "vision_msgs/msg/Detection3D", "vision_msgs/msg/BoundingBox3D"
        head = self._header(frame, at)
        found = [self._zero(one, header=head, bbox=self._zero(box, center=self._pose(*xy)), id=n) for n, *xy in seen]
        self._send(at, "/boxes", f"{one}Array", header=head, detections=found)

    def tags(self, at: float, seen: Iterable[tuple[int, float]], frame: str = "optical") -> None:
        one, at_pixel = "apriltag_msgs/msg/AprilTagDetection", "apriltag_msgs/msg/Point"
        found = [self._zero(one, id=number, centre=self._of(at_pixel, u, 240.0)) for number, u in seen]
        self._send(at, "/tags", f"{one}Array", header=self._header(frame, at), detections=found)

    def camera(self, at: float = 0.0, frame: str = "optical") -> None:
        k = np.array([400.0, 0, 320, 0, 400, 240, 0, 0, 1])
        header = self._header(frame, at)
        self._send(at, "/camera_info", "sensor_msgs/msg/CameraInfo", header=header, height=480, width=640, k=k)

    def optical(self, x: float, y: float, yaw: float) -> None:
        """Mount an optical frame (z ahead, x to the right) on base_link."""
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
        ahead = np.array([-0.5, 0.5, -0.5, 0.5])  # x, y, z, w: of the usual optical frame
        X, Y, Z, W = ahead
        q = (c * X - s * Y, c * Y + s * X, c * Z + s * W, c * W - s * Z)
        turn = self._of("geometry_msgs/msg/Quaternion", *q)
        self._moved(-1.0, "/tf_static", 0.0, "base_link", "optical", (x, y, 0.5), turn)


__all__ = ["START", "Full"]

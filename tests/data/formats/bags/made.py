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
        point = self._of("geometry_msgs/msg/Point", float(x), float(y), float(z))
        return self._of("geometry_msgs/msg/Pose", point, self._turn(yaw))

    def _send(self, at: float, topic: str, kind: str, **values: Any) -> None:
        self.messages.append((at, topic, kind, self._of(kind, **values)))

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
        vector, zeros = self._of("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), np.zeros(9)
        covariance = np.diag([1e-4, 1e-4, variance]).ravel()
        self._send(
            at, "/imu", "sensor_msgs/msg/Imu", header=self._header("imu", at), orientation=self._turn(yaw),
            orientation_covariance=covariance, angular_velocity=vector, angular_velocity_covariance=zeros,
            linear_acceleration=vector, linear_acceleration_covariance=zeros,
        )  # fmt: skip

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
        point = self._of("geometry_msgs/msg/Point", *map(float, xy), 0.0)
        self._send(at, topic, "geometry_msgs/msg/PointStamped", header=self._header("map", at), point=point)

    def poses(self, at: float, points: Iterable[Iterable[float]], frame: str = "camera", topic: str = "/cones") -> None:
        kind = "geometry_msgs/msg/PoseArray"
        self._send(at, topic, kind, header=self._header(frame, at), poses=[self._pose(x, y) for x, y in points])

    def markers(self, at: float, seen: Iterable[tuple[int, float, float]], frame: str = "camera") -> None:
        markers = []
        for number, x, y in seen:
            fields = dict.fromkeys(self.store.types["visualization_msgs/msg/Marker"].__dataclass_fields__, 0)
            fields.pop("__msgtype__", None)
            color = self._of("std_msgs/msg/ColorRGBA", 0.0, 0.0, 0.0, 0.0)
            empty = np.zeros(0, np.uint8)
            fields |= {
                "header": self._header(frame, at), "ns": "tags", "id": number, "type": 1, "action": 0,
                "pose": self._pose(x, y), "scale": self._of("geometry_msgs/msg/Vector3", 0.1, 0.1, 0.1),
                "color": color, "lifetime": self._of("builtin_interfaces/msg/Duration", 0, 0), "frame_locked": False,
                "points": [], "colors": [], "text": "", "mesh_resource": "", "mesh_use_embedded_materials": False,
                "texture_resource": "", "uv_coordinates": [],
            }  # fmt: skip
            if "texture" in fields:
                fields["texture"] = self._of("sensor_msgs/msg/CompressedImage", self._header("", 0.0), "", empty)
            if "mesh_file" in fields:
                fields["mesh_file"] = self._of("visualization_msgs/msg/MeshFile", "", empty)
            known = self.store.types["visualization_msgs/msg/Marker"].__dataclass_fields__  # ROS 1 has fewer
            fields = {name: value for name, value in fields.items() if name in known}
            markers.append(self._of("visualization_msgs/msg/Marker", **fields))
        self._send(at, "/markers", "visualization_msgs/msg/MarkerArray", markers=markers)

    def boxes(self, at: float, seen: Iterable[tuple[str, float, float]], frame: str = "camera") -> None:
        size = self._of("geometry_msgs/msg/Vector3", 1.0, 1.0, 1.0)
        found = [
            self._of(
                "vision_msgs/msg/Detection3D", header=self._header(frame, at), results=[],
                bbox=self._of("vision_msgs/msg/BoundingBox3D", self._pose(x, y), size), id=name,
            )
            for name, x, y in seen
        ]  # fmt: skip
        kind = "vision_msgs/msg/Detection3DArray"
        self._send(at, "/boxes", kind, header=self._header(frame, at), detections=found)

    def tags(self, at: float, seen: Iterable[tuple[int, float]], frame: str = "optical") -> None:
        found = [
            self._of(
                "apriltag_msgs/msg/AprilTagDetection", family="36h11", id=number,
                centre=self._of("apriltag_msgs/msg/Point", u, 240.0),
            )
            for number, u in seen
        ]  # fmt: skip
        kind = "apriltag_msgs/msg/AprilTagDetectionArray"
        self._send(at, "/tags", kind, header=self._header(frame, at), detections=found)

    def camera(self, at: float = 0.0, frame: str = "optical") -> None:
        region = self._of("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        self._send(
            at, "/camera_info", "sensor_msgs/msg/CameraInfo", header=self._header(frame, at), height=480, width=640,
            distortion_model="", d=np.zeros(0), k=np.array([400.0, 0, 320, 0, 400, 240, 0, 0, 1]), r=np.zeros(9),
            p=np.zeros(12), binning_x=0, binning_y=0, roi=region,
        )  # fmt: skip

    def optical(self, x: float, y: float, yaw: float) -> None:
        """Mount an optical frame (z ahead, x to the right) on base_link."""
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
        ahead = np.array([-0.5, 0.5, -0.5, 0.5])  # x, y, z, w: of the usual optical frame
        X, Y, Z, W = ahead
        q = (c * X - s * Y, c * Y + s * X, c * Z + s * W, c * W - s * Z)
        moved = self._of("geometry_msgs/msg/Vector3", float(x), float(y), 0.5)
        transform = self._of("geometry_msgs/msg/Transform", moved, self._of("geometry_msgs/msg/Quaternion", *q))
        kind = "geometry_msgs/msg/TransformStamped"
        stamped = self._of(kind, self._header("base_link", 0.0), "optical", transform)
        tf = "tf2_msgs/msg/TFMessage"
        self.messages.append((-1.0, "/tf_static", tf, self._of(tf, [stamped])))


__all__ = ["START", "Full"]

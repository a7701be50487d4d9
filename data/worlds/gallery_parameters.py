"""Parameters of the simulated gallery and what follows from them: the loop, the camera, the pictures of each wall."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data import se2
from data.errors import UsageError
from data.sensors import RelativePoint
from data.worlds.parameters import check_parameters

MAY_BE_ZERO = (
    *("sigma_v", "sigma_omega", "prior_sigma", "prior_sigma_heading", "brightness", "contrast", "exposure"),
    *("image_noise", "disparity_noise", "disparity_step", "smear", "patches", "edge_hole", "least_texture"),
)


@dataclass(frozen=True)
class Gallery:
    """Parameters of world, robot, camera and rendering; every one is a plain number.

    Attributes:
        duration: s; rate: Hz of the frames, and of the commands.
        pictures: their number, shared out over the four walls by length.
        room_length, room_width, room_height: m.
        picture_width, picture_height: m; spacing: m, between the middles of neighbours on a wall; each hangs
            up to a tenth of the gap off.
        hang: m, height of the pictures' middles, give or take 5 cm.
        wall_distance: m, from the loop to the long walls, which fixes the radius of its turns; end_distance: m, to the
            short ones.
        speed: m/s on the straights; turn_rate: rad/s in the turns, which go to the left (both to a whole frame).
        sigma_v: m/s, sigma_omega: rad/s, noise of each recorded command.
        prior_sigma: m, prior_sigma_heading: rad; the prior mean is drawn with them.
        camera_x, camera_y: m, camera in the body; camera_height: m; camera_yaw: rad, its view from straight ahead.
        image_width, image_height: px; field_of_view: rad, horizontal.
        max_distance: m, max_obliquity: rad; farther or flatter pictures do not count as in view.
        sigma_x, sigma_z: m, noise of a corner's coordinates in logs without images.
        reference_width: px, of a picture's own image.
        brightness: grey levels, contrast: 1, standard deviations of a frame's offset and gain.
        exposure: s, length of the motion blur. image_noise: grey levels, of each colour of a pixel.
        baseline: m, of the stereo pair; disparity_noise: px (sigma_z = z^2 sigma_d / (f b)); disparity_step: px, to
            which disparities are rounded; smear: px, over which their noise is correlated.
        patches: holes per frame, at random places. edge_hole: px to either side of a picture's outline without depth.
        least_texture: grey levels per px, mean gradient below which stereo finds nothing. 0 turns any of these off.

    Raises:
        UsageError: a value of the wrong type or out of range, or pictures or path that do not fit into the room.
    """

    duration: float = 60.0
    rate: float = 6.0
    pictures: int = 8
    room_length: float = 7.0
    room_width: float = 5.2
    room_height: float = 2.6
    picture_width: float = 0.7
    picture_height: float = 0.525
    spacing: float = 1.5
    hang: float = 1.15
    wall_distance: float = 2.3
    end_distance: float = 2.2
    speed: float = 0.3
    turn_rate: float = 0.6
    sigma_v: float = 0.01
    sigma_omega: float = math.radians(4.0)
    prior_sigma: float = 0.03
    prior_sigma_heading: float = math.radians(2.0)
    camera_x: float = 0.12
    camera_y: float = -0.08
    camera_height: float = 1.1
    camera_yaw: float = math.radians(-80.0)
    image_width: int = 640
    image_height: int = 480
    field_of_view: float = math.radians(60.0)
    max_distance: float = 3.0
    max_obliquity: float = math.radians(50.0)
    sigma_x: float = 0.02
    sigma_z: float = 0.05
    reference_width: int = 600
    brightness: float = 8.0
    contrast: float = 0.08
    exposure: float = 0.01
    image_noise: float = 2.0
    baseline: float = 0.12
    disparity_noise: float = 0.25
    disparity_step: float = 0.0625
    smear: float = 1.5
    patches: int = 6
    edge_hole: int = 1
    least_texture: float = 0.3

    def __post_init__(self) -> None:
        signed = ("camera_x", "camera_y", "camera_yaw")
        positive = [name for name in self.__dataclass_fields__ if name not in (*MAY_BE_ZERO, *signed)]
        check_parameters("gallery", self, positive=positive, not_negative=MAY_BE_ZERO)
        if not (self.turn_radius > 0 and self.straight > 0):
            raise UsageError(
                f"gallery: wall_distance = {self.wall_distance}, end_distance = {self.end_distance} leave no loop"
            )
        for length, n in zip(self.wall_lengths, self.shares, strict=True):
            if n * self.spacing > length:
                raise UsageError(f"gallery: {n} pictures, spacing = {self.spacing}, do not fit on a wall of {length} m")
        if 1.2 * self.picture_width > self.spacing:
            raise UsageError(
                f"gallery: spacing = {self.spacing}; at least 1.2 picture widths are needed, {1.2 * self.picture_width}"
            )
        low, high = self.hang - 0.5 * self.picture_height - 0.05, self.hang + 0.5 * self.picture_height + 0.05
        if not (low > 0.0 and high < self.room_height and self.camera_height < self.room_height):
            raise UsageError("gallery: pictures and camera must be above the floor and below room_height")
        if not self.field_of_view < math.pi:
            raise UsageError(f"gallery: field_of_view = {self.field_of_view}; less than pi is needed")
        if math.hypot(self.camera_x, self.camera_y) >= min(self.wall_distance, self.end_distance):
            raise UsageError("gallery: camera_x, camera_y put the camera into the wall")

    @property
    def turn_radius(self) -> float:
        """Radius of the turns [m]."""
        return 0.5 * self.room_width - self.wall_distance

    @property
    def straight(self) -> float:
        """Length of the straights [m]."""
        return self.room_length - 2.0 * (self.end_distance + self.turn_radius)

    @property
    def wall_lengths(self) -> tuple[float, ...]:
        """Of the walls, in the order of `NORMALS` [m]."""
        return (self.room_length, self.room_width, self.room_length, self.room_width)

    @property
    def shares(self) -> tuple[int, ...]:
        """Number of pictures on each wall."""
        ends = np.cumsum(self.wall_lengths) / sum(self.wall_lengths)
        return tuple(int(n) for n in np.diff(np.rint(self.pictures * ends), prepend=0))

    @property
    def focal(self) -> float:
        """Focal length [px]; the optical axis meets the image in its middle."""
        return 0.5 * self.image_width / math.tan(0.5 * self.field_of_view)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return max(round(self.duration * self.rate), 1)

    @property
    def rotation(self) -> float:
        """Rotation [rad] of p_c = R p_b + T in plan."""
        return float(se2.wrap_angle(0.5 * math.pi - self.camera_yaw))

    @property
    def translation(self) -> tuple[float, float]:
        """T [m] of p_c = R p_b + T in plan."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        return -(c * self.camera_x - s * self.camera_y), -(s * self.camera_x + c * self.camera_y)

    def sensor(self) -> RelativePoint:
        """Model of a corner's observation (x, z) in the camera's plan, where straight ahead is at 90 degrees."""
        half, ahead = 0.5 * self.field_of_view, 0.5 * math.pi
        farthest = math.hypot(self.max_distance, self.picture_width)
        return RelativePoint(farthest, ahead - half, ahead + half, self.rotation, self.translation)

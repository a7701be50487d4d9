"""The gallery: a robot drives loops among pictures on walls; parameters, world, drive, logs without images.

World: z up, origin on the floor in the middle of the room, long walls along x. The camera is level, so in plan it sees
(x, z) of `data.pictures`. Commands hold for one frame (exact arcs); straights and turns take whole numbers of frames,
so the loop closes. Layout, command noise, prior and sensor noise come from independent streams of the seed. The noise
is that of a university lab: 2 cm and 5 cm, 1 cm/s and 4 deg/s.
"""

import math
from dataclasses import asdict, dataclass

import numpy as np

from data import se2
from data.errors import UsageError
from data.inputs import Increments, Inputs, LandmarkMap, Observations
from data.locked import Locked
from data.log import Log
from data.motion.velocity import VelocityModel, VelocityNoise, floor_covariances, preintegrate
from data.pictures import COMMAND_SIGMA, CORNERS, VisualSetup
from data.se2 import Array
from data.sensors import RelativePoint
from data.truth import Truth
from data.worlds.parameters import check_parameters, drawn_prior, streams, told

MAY_BE_ZERO = (
    *("motifs", "sigma_v", "sigma_omega", "prior_sigma", "prior_sigma_heading", "brightness", "contrast", "exposure"),
    *("image_noise", "disparity_noise", "disparity_step", "smear", "patches", "edge_hole", "least_texture"),
)


@dataclass(frozen=True)
class Gallery:
    """Parameters of world, robot, camera and rendering. UsageError for an invalid value, or what does not fit."""

    duration: float = told(60.0, "s")
    rate: float = told(6.0, "Hz of the frames, and of the commands")
    pictures: int = told(8, "their number, shared out over the four walls by length")
    motifs: int = told(0, "number of different ones, which then repeat (0: all)")
    room_length: float = told(7.0, "m")
    room_width: float = told(5.2, "m")
    room_height: float = told(2.6, "m")
    picture_width: float = told(0.7, "m")
    picture_height: float = told(0.525, "m")
    spacing: float = told(
        1.5, "m, between the middles of neighbours on a wall; each is shifted by up to a tenth of the gap"
    )
    hang: float = told(1.15, "m, height of the pictures' middles, give or take 5 cm")
    wall_distance: float = told(2.3, "m, from the loop to the long walls, which fixes the radius of its turns")
    end_distance: float = told(2.2, "m, to the short ones")
    speed: float = told(0.3, "m/s on the straights")
    turn_rate: float = told(0.6, "rad/s in the turns, which go to the left (both to a whole frame)")
    sigma_v: float = told(0.01, "m/s")
    sigma_omega: float = told(math.radians(4.0), "rad/s, noise of each recorded command")
    prior_sigma: float = told(0.03, "m")
    prior_sigma_heading: float = told(math.radians(2.0), "rad; the prior mean is drawn with them")
    camera_x: float = told(0.12, "m, camera in the body")
    camera_y: float = told(-0.08, "m, camera in the body")
    camera_height: float = told(1.1, "m")
    camera_yaw: float = told(math.radians(-80.0), "rad, its view from straight ahead")
    image_width: int = told(640, "px")
    image_height: int = told(480, "px")
    field_of_view: float = told(math.radians(60.0), "rad, horizontal")
    max_distance: float = told(3.0, "m")
    max_obliquity: float = told(math.radians(50.0), "rad; farther or more oblique pictures do not count as in view")
    sigma_x: float = told(0.02, "m, noise of a corner's coordinates in logs without images")
    sigma_z: float = told(0.05, "m, noise of a corner's coordinates in logs without images")
    reference_width: int = told(600, "px, of a picture's own image")
    brightness: float = told(8.0, "grey levels")
    contrast: float = told(0.08, "1, standard deviations of a frame's offset and gain")
    exposure: float = told(0.01, "s, length of the motion blur")
    image_noise: float = told(2.0, "grey levels, of each colour of a pixel")
    baseline: float = told(0.12, "m, of the stereo pair")
    disparity_noise: float = told(0.25, "px (sigma_z = z^2 sigma_d / (f b))")
    disparity_step: float = told(0.0625, "px, rounding of disparities")
    smear: float = told(1.5, "px, over which their noise is correlated")
    patches: int = told(6, "holes per frame, at random places")
    edge_hole: int = told(1, "px to either side of a picture's outline without depth")
    least_texture: float = told(
        0.3, "grey levels per px, mean gradient below which stereo finds nothing. 0 turns any of these off"
    )

    def __post_init__(self) -> None:
        signed = ("camera_x", "camera_y", "camera_yaw")
        positive = [name for name in self.__dataclass_fields__ if name not in (*MAY_BE_ZERO, *signed)]
        check_parameters("gallery", self, positive=positive, signed=signed)
        if not (self.turn_radius > 0 and self.straight > 0):
            distances = f"wall_distance = {self.wall_distance}, end_distance = {self.end_distance}"
            raise UsageError(f"gallery: {distances} leave no loop")
        for length, n in zip(self.wall_lengths, self.shares, strict=True):
            if n * self.spacing > length:
                raise UsageError(f"gallery: {n} pictures, spacing = {self.spacing}, do not fit on a wall of {length} m")
        if (least := 1.2 * self.picture_width) > self.spacing:
            raise UsageError(f"gallery: spacing = {self.spacing}; at least 1.2 picture widths are needed, {least}")
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
        """Lengths of the walls, in the order of `NORMALS` [m]."""
        return (self.room_length, self.room_width, self.room_length, self.room_width)

    @property
    def shares(self) -> tuple[int, ...]:
        """Number of pictures on each wall."""
        ends = np.cumsum(self.wall_lengths) / sum(self.wall_lengths)
        return tuple(int(n) for n in np.diff(np.rint(self.pictures * ends), prepend=0))

    @property
    def focal(self) -> float:
        """Focal length [px]; the optical axis meets the image's centre."""
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
        """Observation model of a corner (x, z) in the camera's plan, where straight ahead is at 90 degrees."""
        half, ahead = 0.5 * self.field_of_view, 0.5 * math.pi
        farthest = math.hypot(self.max_distance, self.picture_width)
        return RelativePoint(farthest, ahead - half, ahead + half, self.rotation, self.translation)


@dataclass(frozen=True, eq=False)
class Projection:
    """A picture in the camera."""

    picture: int  # its number
    distance: float  # m, of its middle
    obliquity: float  # rad, between its normal and the line of sight to its middle; above pi/2: from behind
    pixels: Array  # (4, 2), NaN for corners behind the camera
    points: Array  # (4, 3) m


def in_camera(g: Gallery, pose: Array, points: Array) -> Array:
    """World points (..., 3) m in the camera's frame (x right, y down, z ahead), for a robot pose (3,)."""
    plan = g.sensor().predict(pose, points[..., :2].reshape(-1, 2)).reshape(*points.shape[:-1], 2)
    return np.stack([plan[..., 0], g.camera_height - points[..., 2], plan[..., 1]], axis=-1)


def to_pixels(g: Gallery, points: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) m in the camera's frame; NaN behind the camera."""
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    centre = 0.5 * np.array([g.image_width - 1, g.image_height - 1])
    return np.asarray(g.focal * points[..., :2] / z[..., None] + centre)


def projections(g: Gallery, corners: Array, pose: Array) -> list[Projection]:
    """Every picture as seen from a pose, in view or not."""
    points = in_camera(g, pose, corners)
    pixels = to_pixels(g, points)
    middle = points.mean(axis=1)
    distance = np.linalg.norm(middle, axis=1)
    # downwards x rightwards points out of the wall
    normal = np.cross(points[:, 3] - points[:, 0], points[:, 1] - points[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    obliquity = np.arccos(np.clip(-np.einsum("li,li->l", normal, middle) / distance, -1.0, 1.0))
    return [Projection(i, float(distance[i]), float(obliquity[i]), pixels[i], points[i]) for i in range(len(corners))]


def in_view(g: Gallery, corners: Array, pose: Array) -> list[Projection]:
    """The pictures wholly inside the image, near enough and not too oblique."""
    size = np.array([g.image_width - 1, g.image_height - 1])
    near = [s for s in projections(g, corners, pose) if s.distance <= g.max_distance and s.obliquity <= g.max_obliquity]
    return [s for s in near if bool(((s.pixels >= 0) & (s.pixels <= size)).all())]


NORMALS = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]])
"""Normals of the walls, into the room, in the order in which the robot passes them."""


@dataclass(frozen=True, eq=False)
class Scene(Locked):
    """One gallery with its drive."""

    corners: Array  # (L, 4, 3) m, corners of the pictures in the world, in the order of `data.pictures`
    time: Array  # (N,) s
    pose: Array  # (N, 3) true poses
    command: Array  # command, recorded: (N, 2) v [m/s] and omega [rad/s], true and recorded, held until the next frame
    recorded: Array
    setup: VisualSetup  # known to the estimators; its prior mean is drawn from N(truth, P0)


def gallery(g: Gallery, seed: int) -> Scene:
    """World and drive of a seed, reproducible to the byte."""
    layout, command, prior, _ = streams(seed, 4)
    corners = _hang(g, layout)
    time = np.arange(g.frames) / g.rate
    # True v and omega (N, 2), loop after loop: straight, half circle, straight, half circle.
    straight, turn = max(round(g.straight / g.speed * g.rate), 1), max(round(math.pi / g.turn_rate * g.rate), 1)
    rate = math.pi / turn * g.rate
    lap = np.repeat([[g.straight / straight * g.rate, 0.0], [rate * g.turn_radius, rate]], [straight, turn], axis=0)
    true = np.asarray(lap[np.arange(g.frames) % len(lap)])
    recorded = true + np.array([g.sigma_v, g.sigma_omega]) * command.standard_normal(true.shape)
    exact, _ = preintegrate(VelocityModel(VelocityNoise("density")), time, true[:, 0], true[:, 1], time)
    pose = np.zeros((g.frames, 3))
    pose[0] = -0.5 * g.straight, -g.turn_radius, 0.0
    for k in range(1, g.frames):
        pose[k] = se2.compose(pose[k - 1], exact.mean[k])
    first = drawn_prior(pose[0], g.prior_sigma, g.prior_sigma_heading, prior)
    setup = VisualSetup(g.rotation, g.translation, corners[:, :, :2].copy(), first)
    return Scene(corners, time, pose, true, recorded, setup)


def simulate(g: Gallery, seed: int, name: str | None = None) -> Log:
    """A log without images: each picture in view gives four corners with the stated noise; reproducible to the byte.
    Landmark ids are 4 * picture + corner, ascending in a frame; upper and lower corners coincide in plan.
    """
    scene, rng = gallery(g, seed), streams(seed, 4)[3]
    noise = np.array([g.sigma_x, g.sigma_z]) * rng.standard_normal((g.frames, g.pictures, CORNERS, 2))
    frame, ids, z = [], [], []
    for k, pose in enumerate(scene.pose):
        for seen in in_view(g, scene.corners, pose):
            frame += [k] * CORNERS
            ids += [CORNERS * seen.picture + c for c in range(CORNERS)]
            z.append(seen.points[:, [0, 2]] + noise[k, seen.picture])
    R = np.tile(np.diag([g.sigma_x**2, g.sigma_z**2]), (len(frame), 1, 1))
    observations = Observations(np.array(frame, np.int64), np.concatenate([np.empty((0, 2)), *z]), R)
    inputs = inputs_of(scene.setup, scene.time, scene.recorded, observations, g.sensor(), (g.sigma_v, g.sigma_omega))
    source = {"kind": "visual", "seed": seed, "gallery": asdict(g)}
    return Log(name or f"visual:{seed}", inputs, Truth(scene.pose, inputs.map, np.array(ids, np.int64)), source=source)


def inputs_of(
    setup: VisualSetup, time: Array, commands: Array, observations: Observations, sensor: RelativePoint,
    sigma: tuple[float, float] = COMMAND_SIGMA,
) -> Inputs:  # fmt: skip
    """Inputs of a log: a map of corners (id 4 * picture + corner); commands (N, 2) with `sigma` hold for a frame."""
    model = VelocityModel(VelocityNoise("velocity", sigma))
    increments, _ = preintegrate(model, time, commands[:, 0], commands[:, 1], time)
    covariance, floored = floor_covariances(increments.covariance, Inputs.covariance_floor)
    motion = Increments(increments.mean, covariance)
    known = LandmarkMap(np.arange(CORNERS * len(setup.corners)), setup.corners.reshape(-1, 2))
    return Inputs(setup.prior, time, motion, observations, sensor, known, floored=floored)


def _hang(g: Gallery, rng: np.random.Generator) -> Array:
    """Corners (L, 4, 3) of the pictures, wall by wall, on each from left to right."""
    half = 0.5 * np.array([g.picture_width, g.picture_height])
    offset = half * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    corners = []
    for normal, n in zip(NORMALS, g.shares, strict=True):
        right = np.array([-normal[1], normal[0]])
        middle = -0.5 * normal * np.array([g.room_length, g.room_width])
        for i in range(n):
            shift = 0.1 * (g.spacing - g.picture_width) * rng.uniform(-1.0, 1.0)
            along = (i - 0.5 * (n - 1)) * g.spacing + shift + offset[:, 0]
            height = g.hang + rng.uniform(-0.05, 0.05) + offset[:, 1]
            corners.append(np.column_stack([middle + along[:, None] * right, height]))
    return np.array(corners)

"""The gallery: a robot drives loops in a room with pictures on its walls; the world, the drive, logs without images.

World: z up, origin on the floor in the middle of the room, the long walls along x. The camera is level, so in plan it
sees (x, z) of `data.pictures`. The commands hold from one frame to the next (exact arcs); every straight and every turn
takes a whole number of frames, so that the loop closes. Layout, command noise, prior and sensor noise come from
independent streams of the seed. The noise is that of a university lab: 2 cm and 5 cm, 1 cm/s and 4 deg/s.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from data import se2
from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior, read_only
from data.log import Log
from data.motion.floor import floor_covariances
from data.motion.velocity import VelocityModel, VelocityNoise, preintegrate
from data.pictures import CORNERS, VisualSetup
from data.se2 import Array
from data.truth import Truth
from data.worlds.gallery_camera import in_view
from data.worlds.gallery_parameters import Gallery

__all__ = ["Gallery", "Scene", "gallery", "simulate"]

COVARIANCE_FLOOR = 1e-10
NORMALS = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]])
"""Of the walls, into the room, in the order in which the robot passes them."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One gallery with its drive.

    Attributes:
        corners: (L, 4, 3) m, corners of the pictures in the world, in the order of `data.pictures`.
        time: (N,) s.
        pose: (N, 3) true poses.
        command, recorded: (N, 2) true and recorded v [m/s] and omega [rad/s]; each holds until the next frame.
        setup: what the estimators know; its prior mean is drawn from N(truth, P0).
    """

    corners: Array
    time: Array
    pose: Array
    command: Array
    recorded: Array
    setup: VisualSetup

    def __post_init__(self) -> None:
        read_only(self)


def gallery(g: Gallery, seed: int) -> Scene:
    """World and drive of a seed. Same arguments: same bytes."""
    layout, command, prior, _ = _streams(seed)
    corners = _hang(g, layout)
    time = np.arange(g.frames) / g.rate
    true = _commands(g)
    recorded = true + np.array([g.sigma_v, g.sigma_omega]) * command.standard_normal(true.shape)
    exact, _ = preintegrate(VelocityModel(VelocityNoise("density")), time, true[:, 0], true[:, 1], time)
    pose = np.zeros((g.frames, 3))
    pose[0] = -0.5 * g.straight, -g.turn_radius, 0.0
    for k in range(1, g.frames):
        pose[k] = se2.compose(pose[k - 1], exact.mean[k])
    sigma = np.array([g.prior_sigma, g.prior_sigma, g.prior_sigma_heading])
    mean = pose[0] + sigma * prior.standard_normal(3)
    mean[2] = se2.wrap_angle(mean[2])
    setup = VisualSetup(g.rotation, g.translation, corners[:, :, :2].copy(), Prior(mean, np.diag(sigma**2)))
    return Scene(corners, time, pose, true, recorded, setup)


def simulate(g: Gallery, seed: int, name: str | None = None) -> Log:
    """A log without images: each picture in view gives four corners with the stated noise. Same arguments: same bytes.

    Landmark ids are 4 * picture + corner; upper and lower corners share their place. Those of a frame come by id.
    """
    scene, rng = gallery(g, seed), _streams(seed)[3]
    noise = np.array([g.sigma_x, g.sigma_z]) * rng.standard_normal((g.frames, g.pictures, CORNERS, 2))
    frame, ids, z = [], [], []
    for k, pose in enumerate(scene.pose):
        for seen in in_view(g, scene.corners, pose):
            frame += [k] * CORNERS
            ids += [CORNERS * seen.picture + c for c in range(CORNERS)]
            z.append(seen.points[:, [0, 2]] + noise[k, seen.picture])
    R = np.tile(np.diag([g.sigma_x**2, g.sigma_z**2]), (len(frame), 1, 1))
    model = VelocityModel(VelocityNoise("velocity", (g.sigma_v, g.sigma_omega)))
    increments, _ = preintegrate(model, scene.time, scene.recorded[:, 0], scene.recorded[:, 1], scene.time)
    covariance, floored = floor_covariances(increments.covariance, COVARIANCE_FLOOR)
    known = LandmarkMap(np.arange(CORNERS * g.pictures), scene.setup.corners.reshape(-1, 2))
    inputs = Inputs(
        scene.setup.prior,
        scene.time,
        Increments(increments.mean, covariance),
        Observations(np.array(frame, np.int64), np.concatenate([np.empty((0, 2)), *z]), R),
        g.sensor(),
        known,
        covariance_floor=COVARIANCE_FLOOR,
        floored=floored,
    )
    source = {"kind": "visual", "seed": seed, "gallery": asdict(g)}
    return Log(name or f"visual:{seed}", inputs, Truth(scene.pose, known, np.array(ids, np.int64)), source=source)


def _streams(seed: int) -> list[np.random.Generator]:
    """Of layout, commands, prior and corner noise."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]


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


def _commands(g: Gallery) -> Array:
    """True v and omega (N, 2), loop after loop: straight, half circle, straight, half circle."""
    straight = max(round(g.straight / g.speed * g.rate), 1)
    turn = max(round(math.pi / g.turn_rate * g.rate), 1)
    rate = math.pi / turn * g.rate
    lap = np.repeat([[g.straight / straight * g.rate, 0.0], [rate * g.turn_radius, rate]], [straight, turn], axis=0)
    commands: Array = lap[np.arange(g.frames) % len(lap)]
    return commands

"""Assignment `visual`: the camera's model in the visual lab, on poses and pictures of its gallery."""

from functools import lru_cache
from types import SimpleNamespace
from typing import cast

import numpy as np

from data.pictures import Found
from data.se2 import Array
from data.sensors import RelativePoint
from eval.checks.exactness import Bug, rules_of
from wings.camera.gallery import Gallery, gallery, in_view
from wings.camera.observations import noise_of
from wings.grade.parts import Mistakes, Question, Seeds, asked

NAMES = ("to_camera", "jacobian", "to_pixels", "to_points", "noise")
EVERY = 7  # frames from question to question


def noise(points: Array, focal: float, sigma: float, k: float) -> Array:
    """R (n, 2, 2) of corners (n, 3) m in plan: sigma [px] of a pixel, and sigma_z = k z^2."""
    found = SimpleNamespace(points=points[None], frame=[0], focal=focal, pixel_noise=sigma, depth_noise=k)
    return np.asarray(noise_of(cast(Found, found), "depth")[0])


@lru_cache(maxsize=2)
def seen(seeds: Seeds) -> dict[str, list[Question]]:
    """Questions by part: each seed has a camera of its own, on a drive through its gallery."""
    out: dict[str, list[Question]] = {name: [] for name in NAMES}
    for seed in seeds.seeds:
        rng = np.random.default_rng([seed, 0xCA3E7A])
        x, y, yaw, view = rng.uniform((0.05, -0.15, -1.6, 0.9), (0.2, 0.15, -1.2, 1.2))
        g = Gallery(camera_x=x, camera_y=y, camera_yaw=yaw, field_of_view=view)
        scene, sensor, mount = gallery(g, seed), g.sensor(), (g.rotation, np.array(g.translation))
        camera = np.array([g.focal, 0.5 * (g.image_width - 1), 0.5 * (g.image_height - 1)])
        sigma, k = (float(c) for c in rng.uniform((0.2, 0.005), (0.8, 0.02)))
        for frame in range(0, len(scene.pose), EVERY):
            pose = scene.pose[frame] + rng.normal(0.0, 0.1, 3)
            for found in in_view(g, scene.corners, pose):
                corners, points = scene.corners[found.picture, :, :2], found.points
                asked_and_answered = (
                    ((pose, corners, *mount), sensor.predict(pose, corners)),
                    ((pose, corners, *mount), sensor.jacobians(pose, corners)[0]), ((points, camera), found.pixels),
                    ((found.pixels, points[:, 2], camera), points),
                    ((points, g.focal, sigma, k), noise(points, g.focal, sigma, k)),
                )  # fmt: skip
                for name, (given, expected) in zip(NAMES, asked_and_answered, strict=True):
                    out[name].append(Question(f"visual:{seed}", frame, given, (expected,)))
    return out


def _mistakes(name: str) -> Mistakes:
    for bug, rules in ((b, rules) for b in Bug for rules in rules_of(b)):
        if name == "jacobian":
            yield (
                bug,
                lambda pose, xy, turn, shift, rules=rules: (
                    rules.Hx(RelativePoint(rotation=turn, translation=tuple(shift)).jacobians(pose, xy)[0]),
                ),
            )
        if name == "noise":
            yield bug, lambda *given, rules=rules: (rules.R(noise(*given)),)


PARTS = tuple(asked(name, lambda seeds, name: seen(seeds)[name], _mistakes) for name in NAMES)

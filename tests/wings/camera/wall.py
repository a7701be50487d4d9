"""Scenes of pictures on a wall, made without the code under test: the pinhole projection of placed corners."""

from dataclasses import dataclass

import cv2
import numpy as np

from wings.camera.detector import Detected

HEIGHT, WIDTH, FOCAL = 480, 640, 525.0
CENTRE = np.array([319.5, 239.5])
PICTURE = 0.6  # m, width; height is 3/4 of it
PICTURES = 4


def texture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = np.full((360, 480, 3), rng.uniform(60, 200, 3), np.float32)
    for cell in (4, 12, 40):
        noise = rng.normal(0, 18, (360 // cell + 2, 480 // cell + 2, 3)).astype(np.float32)
        image += cv2.resize(noise, (480, 360), interpolation=cv2.INTER_CUBIC)
    for _ in range(50):
        x, y = rng.integers(0, (480, 360))
        a, b = rng.integers(5, 50, 2)
        colour = [float(c) for c in rng.uniform(0, 255, 3)]
        if rng.random() < 0.5:
            cv2.ellipse(image, (int(x), int(y)), (int(a), int(b)), float(rng.uniform(0, 180)), 0, 360, colour, -1)
        else:
            cv2.rectangle(image, (int(x), int(y)), (int(x + a), int(y + b)), colour, -1)
    return np.clip(image, 0, 255).astype(np.uint8)


def hung(distance: float, yaw_deg: float = 0.0, x: float = 0.0, width: float = PICTURE) -> np.ndarray:
    """Corners (4, 3) m of a picture of which the middle is `distance` ahead and `x` to the right."""
    w, h, c, s = width / 2, 0.375 * width, np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    flat = np.array([[-w, -h, 0], [w, -h, 0], [w, h, 0], [-w, h, 0]])
    return flat @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + np.array([x, 0.0, distance])


def projected(points: np.ndarray) -> np.ndarray:
    return FOCAL * points[:, :2] / points[:, 2:] + CENTRE


@dataclass
class Scene:
    rgb: np.ndarray
    xyz: np.ndarray


def wall(seed: int = 0, depth: float = 6.0) -> Scene:
    rng = np.random.default_rng(seed)
    smooth = cv2.resize(rng.normal(120, 15, (24, 32, 3)).astype(np.float32), (WIDTH, HEIGHT))
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - CENTRE[0]) / FOCAL, (v - CENTRE[1]) / FOCAL, np.ones(u.shape)], axis=2)
    return Scene(np.clip(smooth, 0, 255).astype(np.uint8), (depth * rays).astype(np.float32))


def hang(scene: Scene, picture: np.ndarray, corners: np.ndarray, seed: int = 0) -> Scene:
    """The scene with a picture painted into it, antialiased, with pixel noise; depth noise of 0.2 px in disparity."""
    rng = np.random.default_rng([seed, 1])
    fine, pixels = 3, projected(corners)
    shrink = min(1.0, fine * max(np.ptp(pixels, axis=0)) / picture.shape[1])
    small = cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    h, w = small.shape[:2]
    edge = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32) - np.float32(0.5)
    target = (fine * (pixels + 0.5) - 0.5).astype(np.float32)
    H = cv2.getPerspectiveTransform(edge, target)
    size = (fine * WIDTH, fine * HEIGHT)
    painted = cv2.warpPerspective(small, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask = np.zeros(size[::-1], np.uint8)
    cv2.fillConvexPoly(mask, np.rint(16 * target).astype(np.int32), 255, shift=4)
    share = cv2.resize(mask, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)[..., None] / 255.0
    painted = cv2.resize(painted, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    rgb = share * painted + (1 - share) * scene.rgb + rng.normal(0, 2, painted.shape)
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    rays = scene.xyz.astype(float) / scene.xyz[..., 2:]
    disparity = 60.0 * (rays @ normal) / (normal @ corners[0])  # px, at a baseline of 60 / FOCAL m
    disparity += rng.normal(0, 0.2, disparity.shape)
    xyz = np.where(share > 0.5, rays * (60.0 / disparity)[..., None], scene.xyz).astype(np.float32)
    return Scene(np.clip(np.rint(rgb), 0, 255).astype(np.uint8), xyz)


def found(result: Detected) -> list[int]:
    return [d.picture for d in result.detections]


def reason(result: Detected, picture: int) -> str:
    return dict(result.refused)[picture]

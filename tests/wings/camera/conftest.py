"""Detectors of the same four pictures, made once."""

import numpy as np
import pytest

from tests.wings.camera.wall import PICTURE, PICTURES, texture
from wings.camera.detector import Detector


@pytest.fixture(scope="session")
def textures() -> list[np.ndarray]:
    return [texture(seed) for seed in range(PICTURES)]


@pytest.fixture(scope="session")
def detector(textures: list[np.ndarray]) -> Detector:
    return Detector(textures, np.full(PICTURES, PICTURE))


@pytest.fixture(scope="session")
def sizeless(textures: list[np.ndarray]) -> Detector:
    return Detector(textures, None)

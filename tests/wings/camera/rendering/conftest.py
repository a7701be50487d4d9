"""A rendered recording without noise and the default one, made once; frames that are asked for again are kept."""

from functools import lru_cache

import pytest

from tests.wings.camera.rendering.galleries import CLEAN, DEFAULT
from wings.camera.gallery import Gallery
from wings.camera.rendering.render import Rendered


def kept(gallery: Gallery) -> Rendered:
    """A recording of which the frames of one look at all pictures, three of each, stay in memory."""
    recording = Rendered(gallery, 0)
    recording.frame = lru_cache(maxsize=24)(recording.frame)  # type: ignore[method-assign]
    return recording


@pytest.fixture(scope="session")
def clean() -> Rendered:
    return kept(CLEAN)


@pytest.fixture(scope="session")
def default() -> Rendered:
    return kept(DEFAULT)

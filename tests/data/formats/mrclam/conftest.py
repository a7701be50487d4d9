"""Fixtures of the tests of MRCLAM: the small dataset and its loader."""

import pytest

from data.formats.mrclam import Treatment, load_mrclam
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.world import PLAIN, save_folder


@pytest.fixture
def files():
    return world.texts()


@pytest.fixture
def load(tmp_path):
    """`load(files, **arguments)`: save as a folder and load robot 1, uncorrected unless said otherwise."""

    def run(files, **arguments):
        return load_mrclam(save_folder(tmp_path / "set", files), 1, Treatment(**{"calibration": PLAIN, **arguments}))

    return run

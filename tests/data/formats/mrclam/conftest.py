"""Fixtures of the tests of MRCLAM: the small dataset and its loader."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from data.formats.mrclam import load_mrclam
from data.log import Log
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.loading import PLAIN, treatment
from tests.data.formats.mrclam.world import Texts, save_folder


@pytest.fixture
def files() -> Texts:
    return world.texts()


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., Log]:
    """`load(files, **arguments)`: save as a folder and load robot 1, uncorrected unless said otherwise."""

    def run(files: Texts, **arguments: object) -> Log:
        return load_mrclam(save_folder(tmp_path / "set", files), 1, treatment(**{"calibration": PLAIN, **arguments}))

    return run

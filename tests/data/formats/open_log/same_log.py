"""Whether two logs are the same, bit for bit."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from data.formats.open_log import load_folder

# parts of a log are optional; a test knows which ones its log has
load: Any = load_folder


# --- round trip -------------------------------------------------------------------------------------------------------


def assert_same_log(a: Any, b: Any, where: str = "log") -> None:
    """Equal to the last bit, NaN and the sign of zero included."""
    assert type(a) is type(b), where
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, where
        assert a.shape == b.shape, where
        assert np.where(a == a, a, 0).tobytes() == np.where(b == b, b, 0).tobytes(), where
        assert np.array_equal(np.isnan(a), np.isnan(b)), where
    elif dataclasses.is_dataclass(a):
        for f in dataclasses.fields(a):
            assert_same_log(getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}")
    else:
        assert a == b, where

"""The circle world: keys do what they say, and the command that takes them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from data.errors import UsageError
from data.worlds.circle import Circle


class TestParameters:
    @pytest.mark.parametrize(
        ("change", "why"),
        [
            ({"sigma_speed": -0.1}, "sigma_speed = -0.1; must not be negative"),
            ({"sigma_point": 0.0}, "sigma_point = 0.0; a positive number"),
            ({"substeps": 0}, "substeps = 0; at least 1"),
            ({"frames": 2.5}, "frames = 2.5; a whole number"),
            ({"speed": math.nan}, "speed = nan; a finite number"),
            ({"min_range": 5.0}, "min_range = 5.0, max_range = 5.0; min_range < max_range"),
            ({"heading_noise": "during"}, "heading_noise = 'during': unknown; known: after, before"),
            ({"layout": "square"}, "layout = 'square': unknown; known: ring, scatter"),
            ({"map_seed": 2}, "map_seed = 2 has no effect with layout ring"),
            ({"layout": "scatter", "ring": 1.0}, "ring = 1.0 has no effect with layout scatter"),
            ({"ring": -20.0}, "ring = -20.0; more than -9.54"),
        ],
    )
    def test_a_senseless_value_is_named_with_its_key(self, change: dict[str, Any], why: str):
        with pytest.raises(UsageError) as error:
            Circle(**change)
        assert why in str(error.value)
        assert str(error.value).startswith("circle: ")
        assert "\n" not in str(error.value)

"""The circle world: keys do what they say, and the command that takes them."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data.convert.__main__ import main
from data.errors import UsageError
from data.formats.open_log import load_folder
from data.worlds.circle import Circle, simulate


class TestParameters:
    @pytest.mark.parametrize(
        ("change", "why"),
        [
            ({"sigma_speed": -0.1}, "sigma_speed = -0.1; must not be negative"),
            ({"sigma_turn": -1}, "sigma_turn = -1; must not be negative"),
            ({"sigma_point": 0.0}, "sigma_point = 0.0; a positive number"),
            ({"prior_sigma": -0.1}, "prior_sigma = -0.1; must not"),
            ({"covariance_floor": -1e-9}, "covariance_floor = -1e-09; must not"),
            ({"frames": 0}, "frames = 0; at least 1"),
            ({"landmarks": 0}, "landmarks = 0; at least 1"),
            ({"substeps": 0}, "substeps = 0; at least 1"),
            ({"frames": 2.5}, "frames = 2.5; a whole number"),
            ({"frames": True}, "frames = True; a whole number"),
            ({"speed": "fast"}, "speed = 'fast'; a number"),
            ({"speed": math.nan}, "speed = nan; a finite number"),
            ({"centre_y": math.inf}, "centre_y = inf; a finite number"),
            ({"period": 0.0}, "period = 0.0; a positive"),
            ({"turn_rate": 0.0}, "turn_rate = 0.0; a positive"),
            ({"max_range": -1.0}, "max_range = -1.0; a positive"),
            ({"min_range": -1.0}, "min_range = -1.0; must not"),
            ({"min_range": 5.0}, "min_range = 5.0, max_range = 5.0; min_range < max_range"),
            ({"heading_noise": "during"}, "heading_noise = 'during': unknown; known: after, before"),
            ({"speed_noise": "middle"}, "speed_noise = 'middle': unknown; known: start, end"),
            ({"layout": "square"}, "layout = 'square': unknown; known: ring, scatter"),
            ({"map_seed": 2}, "map_seed = 2 has no effect with layout ring"),
            ({"layout": "scatter", "map_seed": -2}, "map_seed = -2; must not"),
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

    def test_a_whole_number_will_do_for_any_number(self):
        assert simulate(Circle(frames=3, speed=1, period=2), 0).truth.pose[1, 0] == 2.0


class TestCommand:
    def test_every_parameter_has_a_flag_that_reaches_the_log(self, tmp_path: Path):
        circle = Circle(
            frames=30, period=0.5, speed=0.5, turn_rate=0.1, sigma_speed=0.01, sigma_turn=0.02, sigma_point=0.2,
            landmarks=9, layout="scatter", map_seed=2, centre_x=0.5, centre_y=4.0, min_range=0.25, max_range=7.0,
            prior_sigma=0.1, heading_noise="before", speed_noise="end", substeps=3, covariance_floor=1e-9,
        )  # fmt: skip
        changed = [f.name for f in fields(Circle) if getattr(circle, f.name) != f.default]
        assert set(changed) == {f.name for f in fields(Circle)} - {"ring"}
        flags = [w for n in changed for w in (f"--{n.replace('_', '-')}", str(getattr(circle, n)))]
        assert main(["circle", str(tmp_path / "round"), "--seed", "7", *flags]) == 0
        log, wanted = load_folder(tmp_path / "round"), simulate(circle, 7)
        assert np.array_equal(log.recorded.observations.z, wanted.recorded.observations.z)
        assert np.array_equal(log.recorded.increments.covariance, wanted.recorded.increments.covariance)
        assert np.array_equal(log.recorded.prior.mean, wanted.recorded.prior.mean)
        assert np.array_equal(log.truth.landmarks.xy, wanted.truth.landmarks.xy)
        assert log.recorded.covariance_floor == 1e-9
        assert log.source == {"kind": "circle", "seed": 7, "circle": asdict(circle)}

    def test_every_flag_is_described(self, capsys: pytest.CaptureFixture[str]):
        with pytest.raises(SystemExit) as end:
            main(["circle", "--help"])
        assert end.value.code == 0
        text = capsys.readouterr().out
        for f in fields(Circle):
            flag = text.index(f"  --{f.name.replace('_', '-')} ")
            assert len(text[flag : text.index("(default", flag)].split()) > 2
        assert "None" not in text

    def test_a_senseless_value_is_one_line_and_status_2(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        assert main(["circle", str(tmp_path / "round"), "--sigma-turn", "-1"]) == 2
        said = capsys.readouterr()
        assert "sigma_turn = -1" in said.err
        assert said.err.count("\n") == 1
        assert not (tmp_path / "round").exists()

"""The corridor lab: a name says which one is meant, and the commands that take it."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data import se2
from data.convert.__main__ import main
from data.errors import UsageError
from data.formats.open_log.reader import load_folder
from data.logs import open_log
from data.sensors import RelativePoint
from data.worlds import registry
from data.worlds.corridor import Corridor, simulate
from data.worlds.registry import name_of
from eval.inspect import main as inspect


class TestNames:
    @pytest.mark.parametrize(
        ("name", "corridor", "seed"),
        [
            ("corridor:0", Corridor(), 0),
            ("corridor:17:people", Corridor(people=True), 17),
            ("corridor:0:no-odometry", Corridor(odometry=False), 0),
            ("corridor:0:no-odometry+people", Corridor(people=True, odometry=False), 0),
            ("corridor:0:people=on+odometry=0", Corridor(people=True, odometry=False), 0),
            ("corridor:0:no-people+odometry", Corridor(), 0),
            (
                "corridor:0:people+range=8+min_angle=-60+srho=.02",
                Corridor(people=True, range=8.0, min_angle=math.radians(-60.0), srho=0.02),
                0,
            ),
            ("corridor:0:max-angle=45+sphi=.5", Corridor(max_angle=math.radians(45), sphi=math.radians(0.5)), 0),
            ("corridor:0:stheta_move=3+frames=88", Corridor(stheta_move=math.radians(3), frames=88), 0),
            ("corridor:0:people+crowd=20", Corridor(people=True, crowd=20), 0),
            ("corridor:3:no-odometry+forward", Corridor(odometry=False, forward=True), 3),
            (
                "corridor:0:no-odometry+forward+step_mean=1+turn_sigma=30",
                Corridor(odometry=False, forward=True, step_mean=1.0, turn_sigma=math.radians(30)),
                0,
            ),
            (
                "corridor:0:people+no-odometry+constant-velocity+velocity=.9",
                Corridor(people=True, odometry=False, constant_velocity=True, velocity=0.9),
                0,
            ),
        ],
    )
    def test_a_name_says_the_parameters_and_angles_in_degrees(self, name, corridor, seed):
        assert registry.parse(name)[1:3] == (corridor, seed)
        assert open_log(name).name == name

    @pytest.mark.parametrize(
        ("name", "wrong"),
        [
            ("corridor:", "whole number"),
            ("corridor:x", "whole number"),
            ("corridor:-1", "whole number"),
            ("corridor:1.5:people", "whole number"),
            ("corridor:" + 5000 * "1", "whole number"),
            ("corridor:0:", "''"),
            ("corridor:0:people+", "''"),
            ("corridor:0:rnage=8", "rnage"),
            ("corridor:0:no-people=1", "no-people=1"),
            ("corridor:0:no-range", "range needs a value"),
            ("corridor:0:range", "range needs a value"),
            ("corridor:0:range=", "range=: a number"),
            ("corridor:0:range=far", "range=far"),
            ("corridor:0:range=nan", "range=nan"),
            ("corridor:0:range=inf", "range=inf"),
            ("corridor:0:range=0", "range = 0"),
            ("corridor:0:srho=-.1", "srho = -0.1"),
            ("corridor:0:sphi=0", "sphi = 0"),
            ("corridor:0:sy_turn=-1", "sy_turn = -1"),
            ("corridor:0:frames=0", "frames = 0"),
            ("corridor:0:frames=4.5", "frames=4.5"),
            ("corridor:0:people=20", "crowd=N"),
            ("corridor:0:crowd=20", "without people"),
            ("corridor:0:sx_blind=1", "no-odometry"),
            ("corridor:0:no-odometry+sx_move=1", "no-odometry"),
            ("corridor:0:min_angle=-181", "min_angle = -181"),
            ("corridor:0:min_angle=90", "max_angle = 90"),
            ("corridor:0:range=8+range=9", "range is given twice"),
            ("corridor:0:people+people=on", "people is given twice"),
            ("corridor:0:people:range=8", "people:range=8"),
            ("corridor:0:forward", "forward = True has no effect with odometry"),
            ("corridor:0:no-odometry+forward+constant-velocity", "one can be stated"),
            ("corridor:0:no-odometry+forward+sx_blind=1", "with a motion prior"),
            ("corridor:0:no-odometry+step_mean=1", "without forward"),
            ("corridor:0:no-odometry+forward+velocity=2", "without constant-velocity"),
            ("corridor:0:no-odometry+turn_sigma=20", "without a motion prior"),
            ("corridor:0:no-odometry+forward+step_sigma=-1", "step_sigma = -1"),
        ],
    )
    def test_a_name_that_makes_no_sense_is_refused_in_one_line(self, name, wrong):
        with pytest.raises(UsageError) as fault:
            open_log(name)
        assert wrong in str(fault.value)
        assert "\n" not in str(fault.value)

    def test_an_unknown_key_is_answered_with_all_known_ones(self):
        with pytest.raises(UsageError) as fault:
            registry.parse("corridor:0:colour=red")
        known = str(fault.value).split("known: ")[1].split(", ")
        switches = ["people", "no-odometry", "forward", "constant-velocity"]
        others = [f.name for f in fields(Corridor) if not isinstance(f.default, bool)]
        assert known == [*switches, *(f"{name}=" for name in others)]

    @given(
        st.fixed_dictionaries(
            {},
            optional={
                "people": st.booleans(),
                "range": st.floats(1e-3, 1e3),
                "min_angle": st.floats(-math.pi, 0.0),
                "max_angle": st.floats(0.1, math.pi),
                "sphi": st.floats(1e-6, 1.0),
                "stheta_turn": st.floats(0.0, 1.0),
                "srho": st.floats(1e-9, 1.0),
                "frames": st.integers(1, 1000),
            },
        ),
        st.integers(0, 2**50),
    )
    def test_parameters_have_a_name_that_says_them_again(self, change, seed):
        corridor = Corridor(**change)
        _, again, number, _ = registry.parse(name_of("corridor", corridor, seed))
        assert number == seed
        for f in fields(Corridor):
            wanted, got = getattr(corridor, f.name), getattr(again, f.name)
            # degrees and back may lose the last bit
            assert math.isclose(wanted, got, rel_tol=1e-15) if isinstance(wanted, float) else wanted == got

    def test_a_motion_prior_changes_what_is_stated_and_nothing_that_is_seen(self):
        bare = simulate(Corridor(odometry=False), 4)
        for log in (simulate(Corridor(odometry=False, **{k: True}), 4) for k in ("forward", "constant_velocity")):
            r = log.recorded
            assert np.array_equal(r.observations.z, bare.recorded.observations.z)
            assert np.array_equal(log.truth.pose, bare.truth.pose)
            assert not r.increments.mean[0].any()
            assert not r.increments.covariance[0].any()
            assert len(np.unique(r.increments.mean[1:], axis=0)) == 1, "known before the run"
            true = se2.between(log.truth.pose[:-1], log.truth.pose[1:])
            off = true - r.increments.mean[1:]
            d2 = np.einsum("ni,ni->n", off, np.linalg.solve(r.increments.covariance[1:], off[..., None])[..., 0])
            # 99 % of what is stated; only a robot that keeps its velocity never turns in place
            inside = d2 < 11.34
            assert inside.all() if log.name.endswith("forward") else (inside == (np.abs(true[:, 2]) < 1.0)).all()
            back = np.array([-1.0, 0.0, 0.0]) - r.increments.mean[1]
            assert back @ np.linalg.solve(r.increments.covariance[1], back) > 11.34
            assert "motion prior" in log.notes[0]
        assert bare.notes == ()

    def test_the_name_of_a_log_made_from_parameters_tells_what_is_not_default(self):
        corridor = Corridor(people=True, odometry=False, min_angle=math.radians(-60), srho=0.02)
        assert simulate(corridor, 3).name == "corridor:3:people+no-odometry+min_angle=-60+srho=0.02"
        primed = Corridor(odometry=False, constant_velocity=True, turn_sigma=math.radians(45))
        assert simulate(primed, 3).name == "corridor:3:no-odometry+constant-velocity+turn_sigma=45"
        assert simulate(Corridor(), 3).name == "corridor:3"
        assert simulate(Corridor(), 3, "mine").name == "mine"


class TestCommands:
    def test_a_converted_corridor_loads_again_bit_for_bit(self, tmp_path, capsys):
        flags = (
            "--seed 7 --people --no-odometry --range 8 --min-angle -60 --srho .02 --sphi 0.5 --crowd 3 --sx-blind .3"
        )
        assert main(["corridor", str(tmp_path / "lab"), *flags.split()]) == 0
        log = load_folder(tmp_path / "lab")
        _, wanted, seed, _ = registry.parse(
            "corridor:7:people+no-odometry+range=8+min_angle=-60+srho=.02+sphi=.5+crowd=3+sx_blind=.3"
        )
        ours = simulate(wanted, seed)
        for path in ("observations.frame", "observations.z", "observations.R", "increments.mean",
                     "increments.covariance", "time", "prior.covariance", "map.xy", "map.id"):  # fmt: skip
            a, b = log.recorded, ours.recorded
            for part in path.split("."):
                a, b = getattr(a, part), getattr(b, part)
            assert np.array_equal(a, b), path
        assert np.array_equal(log.truth.pose, ours.truth.pose)
        assert np.array_equal(log.truth.landmark_of, ours.truth.landmark_of)
        assert log.recorded.sensor == ours.recorded.sensor
        assert isinstance(log.recorded.sensor, RelativePoint)
        assert log.recorded.time_is_index
        assert (log.source["kind"], log.source["seed"]) == ("corridor", 7)
        assert Corridor(**log.source["corridor"]) == wanted
        assert "44 frames" in capsys.readouterr().out

    def test_every_parameter_has_a_described_flag_with_its_default(self, capsys):
        with pytest.raises(SystemExit) as end:
            main(["corridor", "--help"])
        assert end.value.code == 0
        text = " ".join(capsys.readouterr().out.split("positional arguments")[1].split())
        for f in fields(Corridor):
            about = text.split(f" --{f.name.replace('_', '-')}")[1].split("(default: ")
            assert len(about[0].split()) > 5, f.name
        assert "sphi DEG deg, standard deviation of a bearing (default: 0.125)" in text
        assert (
            "--max-angle DEG deg, bearings between which points are observed, both ends included (default: 90)" in text
        )
        assert "examples: python -m data.convert corridor" in text

    @pytest.mark.parametrize(
        "words",
        [
            ["--seed", "-1"],
            ["--range", "0"],
            ["--crowd", "5"],
            ["--min-angle", "200"],
            ["--sphi", "nan"],
            ["--people=3"],
        ],
    )
    def test_senseless_flags_are_one_line_and_status_2(self, words, tmp_path, capsys):
        try:
            status = main(["corridor", str(tmp_path / "lab"), *words])
        except SystemExit as end:
            status = end.code  # type: ignore[assignment]
        assert status == 2
        assert capsys.readouterr().err.count("\n") == 1
        assert not (tmp_path / "lab").exists()

    @pytest.mark.parametrize("name", ["corridor:0:people", "corridor:0:no-odometry", "corridor:0:range=.1"])
    def test_inspect_describes_a_corridor(self, name, capsys):
        assert inspect([name]) == 0
        out = capsys.readouterr().out
        assert name in out
        assert "frames        44," in out

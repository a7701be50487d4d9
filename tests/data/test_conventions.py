"""A log that turns first and then drives is named, and the flag it gets mends it."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

import slamref
from data.convert.__main__ import main
from data.formats.open_log import load_folder
from data.motion.velocity import MODELS, VelocityModel, VelocityNoise, preintegrate
from data.notice import Code
from data.questions.asked import ask
from data.questions.examination import ORDERS
from data.truth import Truth
from data.worlds.registry import named_log
from eval.judgement.judgement import judge
from eval.report.overview import trust_mark
from tests.quick import slow

SIGMAS = ("--odometry-sigma", ".05,.02", "--observation-sigma", ".1,1.15deg")
PERIOD, SPEED, TURN = 0.1, 4.0, 0.4


def drive(pose, turn, order, way=SPEED * PERIOD):
    """One step of a simulator: a straight line before or after the turn, or along the arc."""
    heading = pose[2] + turn * {"turn-first": 1.0, "drive-first": 0.0, "arc": 0.5}[order]
    if order == "arc":
        way *= np.sinc(0.5 * turn / np.pi)
    return pose + [way * np.cos(heading), way * np.sin(heading), turn]


def rows(table):
    return "".join(",".join(f"{v:.9f}" for v in row) + "\n" for row in table)


@pytest.fixture
def converted(tmp_path):
    """A robot on a circle with exact readings, 10 Hz; `converted(order, *flags)`: its log; swing: of turns, uneven:
    speed.
    """

    def run(order, *flags, truth=True, swing=False, uneven=0.0, steps=300, blur=0.0, every=1, known=False):
        landmarks = np.random.default_rng(0).uniform(-15.0, 15.0, (30, 2)) + [0.0, 10.0]
        pose, poses, readings, seen = np.zeros(3), [np.zeros(4)], [], []
        for k in range(steps):
            turn = TURN * PERIOD * (np.cos(0.05 * k) if swing else 1.0)
            speed = SPEED * (1.0 + uneven * np.sin(0.07 * k))
            readings.append((k * PERIOD, speed, turn / PERIOD))
            pose, t = drive(pose, turn, order, speed * PERIOD), (k + 1) * PERIOD
            poses.append(np.array([t, *pose]))
            off = landmarks - pose[:2]
            bearing = (np.arctan2(off[:, 1], off[:, 0]) - pose[2] + np.pi) % (2.0 * np.pi) - np.pi
            near = np.hypot(*off.T) < 12.0
            seen += [(t, r, b) for r, b in zip(np.hypot(*off[near].T), bearing[near], strict=True)]
        readings.append((steps * PERIOD, SPEED, TURN))
        (tmp_path / "odo.csv").write_text("t,v,omega\n" + rows(readings))
        (tmp_path / "seen.csv").write_text("t,range,bearing\n" + rows(seen))
        noise = np.random.default_rng(1).normal(size=(len(poses), 4)) * [0.0, blur, blur, 0.3 * blur]
        (tmp_path / "truth.csv").write_text("t,x,y,theta\n" + rows((np.array(poses) + noise)[::every]))
        (tmp_path / "map.csv").write_text("x,y\n" + rows(landmarks))
        words = [
            "table", str(tmp_path / "odo.csv"), str(tmp_path / "log"), "--observations", str(tmp_path / "seen.csv"),
        ]  # fmt: skip
        words += ["--truth", str(tmp_path / "truth.csv"), "--prior", "truth"] if truth else []
        words += ["--map", str(tmp_path / "map.csv")] if known else []
        with mock.patch("data.questions.asked.ask", return_value=()):  # its test asks
            assert main([*words, *SIGMAS, "--prior-sigma", ".01,.01,.3deg", *flags]) == 0
        return load_folder(tmp_path / "log")

    return run


def asked(log):
    (found,) = [q.named for q in ask(log) if q.code is Code.CONTRADICTION] or [{"units": None}]
    return found if found["units"] is None else {**found, "by_truth": found["witness"] == "truth and odometry"}


@pytest.mark.parametrize("order", ["turn-first", slow("drive-first")])
def test_the_order_of_turning_and_driving_is_named_and_its_flag_makes_the_log_exact(order, converted):
    """Seen: pose NEES 74.5 and "either" on a circle whose readings are exact."""
    found = asked(converted(order, steps=150))
    assert (found["units"][0], found["by_truth"], found["flags"]) == (order, True, (f"--integrate {order}",))
    assert found["gain"] > 1000.0
    mended = converted(order, "--integrate", order, steps=150)
    assert asked(mended)["units"] is None
    path = slamref.compare(mended.inputs(), "slam", ["dead-reckoning"], "nn")[0].trajectory("online").pose
    assert np.abs(path[:, :2] - mended.truth.pose[:, :2]).max() < 1e-6


@pytest.mark.parametrize(("order", "truth"), [
    ("turn-first", {"blur": 0.015}), slow("drive-first", {"every": 5}),
    slow("drive-first", {"blur": 0.015}), slow("turn-first", {"every": 5}),
])  # fmt: skip
def test_noisy_or_rare_true_poses_tell_over_several_frames(order, truth, converted):
    """Seen, with a map: NEES 64 with noise of 2 cm, 92 with every fifth pose, and no question."""
    found = asked(converted(order, **truth))
    assert (found["units"][0], found["by_truth"]) == (order, True)
    assert asked(converted("arc", **truth))["units"] is None


def test_a_wrong_mounting_is_not_taken_for_another_order(converted):
    """Seen: a sensor stated 0.2 m farther ahead was called drive-first. At an even speed both are one."""
    for forward, uneven in (("0.35,0,0", 0.0), ("-0.2,0,0", 0.8)):
        assert asked(converted("arc", "--sensor-pose", forward, truth=False, uneven=uneven))["units"] is None
    assert asked(converted("turn-first", truth=False))["units"] is None


@pytest.mark.parametrize("order", ["turn-first", "drive-first"])
def test_without_ground_truth_the_observations_tell(order, converted):
    found = asked(converted(order, "--odometry-sigma", ".01,.005", truth=False, uneven=0.8))
    assert (found["units"][0], found["by_truth"]) == (order, False)


@pytest.mark.parametrize("more", [{"truth": False}, slow({"swing": True})])
def test_along_arcs_nothing_is_asked_with_truth_and_without(more, converted):
    assert asked(converted("arc", **more))["units"] is None


def test_where_all_turns_are_noise_no_order_is_asked():
    """Seen: nothing was left to compare, and the examination failed."""
    log = named_log("arena:5:frames=60")
    noisy = replace(log.recorded.increments, covariance=400.0 * log.recorded.increments.covariance)
    log = replace(log, recorded=replace(log.recorded, increments=noisy), label=log.granted, truth=Truth())
    assert asked(log)["units"] is None


@pytest.mark.slow
def test_the_headline_says_neither_and_why(converted):
    log = converted("turn-first")
    trial = slamref.Trial(log, "slam", tuple(slamref.compare(log.inputs(), "slam", ["ekf", "batch"], "nn")))
    facts = judge(trial, slamref.score([trial]), ())
    assert facts.verdict == "neither"
    assert facts.objections[0].objection == "convention"
    assert "--integrate turn-first" in trust_mark(facts).note


@pytest.mark.parametrize(("model", "order"), [("turn_first", "turn-first"), ("drive_first", "drive-first")])
def test_the_motion_models_drive_as_the_simulators_do(model, order):
    assert set(ORDERS) == {"turn-first", "drive-first"}
    assert model in MODELS
    noise = VelocityNoise("density", sigma=(0.05, 0.02))
    time = np.arange(4.0) * PERIOD
    found, _ = preintegrate(VelocityModel(noise, model), time, np.full(4, SPEED), np.full(4, TURN), time[[0, 2]])
    pose = drive(drive(np.zeros(3), TURN * PERIOD, order), TURN * PERIOD, order)
    np.testing.assert_allclose(found.mean[1], pose, atol=1e-12)

"""Lines of benchmarks say what was measured."""

import math

import numpy as np
import pytest

from association.expectation import gate_threshold
from data.se2 import pose_error
from eval.benchmark import main
from eval.benchmarks import speed
from eval.replay.run import step_by_step
from tests.builders.tables import rows
from tests.research.growth import GROWTH, PER_METRE, growth_figure, line_world, lines, slope, text


def test_the_hard_frame_is_as_ambiguous_as_asked():
    e = speed.hard_frame(20, 1000, 10)
    compatible = e.individual_distances() < gate_threshold(speed.GATE)
    assert compatible.shape == (20, 1000)
    assert (compatible.sum(axis=1) >= 2).sum() == 10
    joint = e.joint(np.arange(1000))
    assert joint[0, 2] == pytest.approx(0.03), "an error of the robot shifts every expectation alike"
    assert joint[0, 0] == pytest.approx(0.031)


def test_the_line_is_driven_until_every_landmark_was_seen():
    world = line_world(100)
    o = world.observations
    assert len(world) == 100 // PER_METRE
    assert set(o.label.tolist()) == set(range(100))
    assert o.z[:, 0].max() < 2.1
    assert world.increments.mean[1:, 0].mean() == pytest.approx(1.0, abs=0.02)
    assert world.increments.mean[0].tolist() == [0.0, 0.0, 0.0]
    assert world.prior.mean.tolist() == [0.5, 0.0, 0.0]
    np.testing.assert_allclose(np.sqrt(world.increments.covariance[1].diagonal()), [0.02, 0.02, 0.005])
    np.testing.assert_allclose(np.sqrt(o.R[0].diagonal()), [0.02, 0.005])


def test_a_median_is_taken_after_a_warm_up_and_a_table_has_rates_where_there_is_a_time(monkeypatch):
    clock = iter([0.0, 5.0, 10.0, 11.0, 20.0, 23.0])
    monkeypatch.setattr("eval.benchmarks.speed.time.perf_counter", lambda: next(clock))
    calls = []
    assert speed.median_seconds(lambda: calls.append(1), 3) == 3.0
    assert len(calls) == 4
    rated = speed.Timed("a", 0.5, 1000, "frames", "1", "< 1 s")
    lines = speed.table([rated, speed.Timed("b", math.nan, 10, "frames"), speed.Timed("c", 0.0, 10, "frames")])
    head, first, second, third = lines.split("\n")
    assert head.split() == ["median", "s", "per", "second", "ratio", "goal"]
    assert first.split() == ["a", "0.50000", "2,000", "frames", "1", "<", "1", "s"]
    assert second.split() == ["b"]
    assert third.split() == ["c", "0.00000"]


def test_growth_is_measured_drawn_and_written_with_the_machine(tmp_path, monkeypatch):
    monkeypatch.setitem(GROWTH, "twins", (lambda n: iter([("a", n, lambda: sum(range(30_000 * n)))]), (1, 4, 16, 64)))
    found = lines("twins", quick=False)
    (shown,) = (line.split() for line in text(found).splitlines())
    assert shown[:2] == ["twins", "a"]
    assert float(" ".join(shown).partition("n^")[2].split()[0]) == pytest.approx(1.0, abs=0.15)
    (ax,) = growth_figure(found).axes
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.lines[0].get_xdata().tolist() == [1, 4, 16, 64]
    speed.write({"twins": found}, tmp_path / "g.csv")
    made = rows(tmp_path / "g.csv")
    assert [(r["table"], r["what"], r["units"]) for r in made] == [("twins", "a", str(n)) for n in (1, 4, 16, 64)]
    assert all("cores" in r["machine"] and r["numpy"] == np.__version__ for r in made)


def test_only_the_tables_asked_for_are_made(monkeypatch, capsys, refused):
    for name in ("localization", "association"):
        monkeypatch.setattr(
            f"eval.benchmarks.speed.{name}_lines", lambda quick, name=name: [speed.Timed(name, 1.0, 1, "s")]
        )
    assert main(["--only", "association,localization", "--quick"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "median", "association", "median", "localization",
    ]  # fmt: skip
    for wrong in (["--only", "speed"], ["--large", "out"], ["--only", "frames"]):
        refused(main, wrong)


def test_the_plain_numpy_loop_is_the_same_filter():
    inputs = speed.localization_log(60)
    ours = step_by_step("ekf", inputs, "localization").online.pose
    np.testing.assert_allclose(pose_error(speed.numpy_localizer(inputs), ours), 0.0, atol=1e-9)


def test_the_exponent_of_growth_is_that_of_a_power_law():
    sizes = [1e3, 1e4, 1e5]
    assert slope(sizes, [3e-5 * n**1.5 for n in sizes]) == pytest.approx(1.5)

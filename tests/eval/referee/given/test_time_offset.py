"""The offset between two clocks is found whatever frames, noise and spans, and not guessed where none stands out."""

from __future__ import annotations

import numpy as np
import pytest

from data import se2
from data.errors import DataError
from eval.referee.given.time_offset import time_offset
from eval.score import main as score

DRIVEN = 60.0
"""s"""


def path(time, laps=False):
    """A robot whose speed and turn rate vary; `laps`: on one circle."""
    fine = np.arange(-5.0, DRIVEN + 5.0, 0.002)
    v = np.full(len(fine), 1.0) if laps else 1.0 + 0.4 * np.sin(0.9 * fine) + 0.2 * np.sin(0.23 * fine)
    omega = np.full(len(fine), 0.3) if laps else 0.4 * np.sin(0.37 * fine + 1.0) + 0.2 * np.cos(1.3 * fine)
    heading = np.cumsum(omega) * 0.002
    xy = np.cumsum(np.column_stack([v * np.cos(heading), v * np.sin(heading)]), axis=0) * 0.002
    at = [np.interp(time, fine, values) for values in (*xy.T, heading)]
    return np.column_stack([at[0], at[1], se2.wrap_angle(at[2])])


def pair(offset, rate=(20.0, 10.0), noise=0.0, begin=0.0, end=DRIVEN, seed=0, laps=False):
    """Stamps and poses of an estimate that drifts, in another frame and behind by `offset`, and of the truth."""
    rng = np.random.default_rng(seed)
    true, own = np.arange(0.0, DRIVEN, 1.0 / rate[0]), np.arange(begin, end, 1.0 / rate[1])
    pose = se2.compose(np.array([30.0, -4.0, 2.0]), path(own, laps=laps))
    drift = noise * np.sqrt(1.0 / rate[1]) * rng.standard_normal(pose.shape) * [1.0, 1.0, 0.5]
    pose += np.cumsum(drift, axis=0)
    return own - offset, pose, true, path(true, laps=laps)


@pytest.mark.parametrize("blank", [None, 1, 3])
@pytest.mark.parametrize("offset", [0.0, 0.137, -2.5, 1.7e9])
def test_an_exact_path_gives_its_offset_with_headings_or_by_its_speed_alone(offset, blank):
    given = pair(offset)
    if blank is not None:
        given[blank][:, 2] = np.nan
    assert time_offset("mine", *given).seconds == pytest.approx(offset, abs=2e-3)


def test_noisy_paths_are_within_their_standard_errors():
    found = [time_offset("mine", *pair(0.42, noise=0.02, seed=seed)) for seed in range(12)]
    errors = np.array([f.seconds - 0.42 for f in found])
    stated = np.array([f.error for f in found])
    assert np.sqrt(np.mean(errors**2)) < 0.05
    assert 0.4 < np.sqrt(np.mean((errors / stated) ** 2)) < 2.5


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_steady_motion_is_not_guessed_at(noise):
    with pytest.raises(DataError, match="state it, as in --time-offset"):
        time_offset("mine", *pair(0.5, noise=noise, laps=True))


def test_too_short_a_path_is_refused():
    time, pose, true, truth = pair(0.0)
    with pytest.raises(DataError, match="fewer than three poses"):
        time_offset("mine", time[:2], pose[:2], true, truth)
    with pytest.raises(DataError, match="too short for rates"):
        time_offset("mine", time[:4], pose[:4], true, truth)


@pytest.fixture
def files(tmp_path):
    time, pose, true, truth = pair(2.0)
    for name, table in (("mine", np.column_stack([time, pose])), ("true", np.column_stack([true, truth]))):
        rows = [",".join(map(repr, row)) for row in table.tolist()]
        (tmp_path / f"{name}.csv").write_text("\n".join(["t,x,y,theta", *rows]))
    return [str(tmp_path / "mine.csv"), str(tmp_path / "true.csv")]


def test_the_flag_moves_the_stamps_and_says_so(files, capsys):
    said = {}
    for offset in ("2", "auto"):
        assert score([*files, "--align", "se2", "--time-offset", offset]) == 0
        out, err = capsys.readouterr()
        said[offset] = dict(line.split(maxsplit=1) for line in out.splitlines()), err
    assert float(said["2"][0]["rmse_position_m"]) == pytest.approx(0.0, abs=1e-3)
    assert float(said["auto"][0]["rmse_position_m"]) == pytest.approx(0.0, abs=5e-3)
    assert "2 s were added to its stamps" in said["2"][1]
    assert "were added to its stamps, where its speeds and turn rates fit" in said["auto"][1]


@pytest.mark.parametrize(
    ("flag", "said"),
    [("soon", "a number of seconds or auto is needed"), ("truth=1", "move the result by the negative")],
)
def test_other_values_are_refused(files, flag, said, capsys):
    assert score([*files, "--time-offset", flag]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_without_an_overlap_the_flag_is_named_and_works(files, tmp_path, capsys):
    head, *rows = (tmp_path / "mine.csv").read_text().splitlines()
    moved = [f"{float(t) + 1e5!r},{rest}" for t, rest in (row.split(",", 1) for row in rows)]
    (tmp_path / "mine.csv").write_text("\n".join([head, *moved]))
    assert score(files) == 2
    assert "`--time-offset auto` estimates an offset" in capsys.readouterr().err
    assert score([*files, "--time-offset", "auto", "--align", "se2"]) == 0
    values = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert float(values["rmse_position_m"]) < 0.01

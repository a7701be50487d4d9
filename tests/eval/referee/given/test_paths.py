"""Paths of other programs: matched with the truth, clocks apart or not, aligned, numbered; relative errors."""

import math

import numpy as np
import pytest

from data import se2
from data.errors import DataError
from data.formats.results.path import GivenPath
from data.logs import open_log
from data.result import DISCARD, NEW, MapEstimate, Trajectory
from eval.referee.consistency import nees
from eval.referee.errors import TOLERANCE, pairs_by_way, rpe_columns
from eval.referee.given.in_space import aligning, in_plane
from eval.referee.given.pairing import time_offset
from eval.referee.given.runs import (
    TruePath,
    begun_by,
    created_by,
    given_run,
    log_of,
    match,
    moved,
    moved_map,
    moved_walls,
)
from eval.score import main as score

TIME = np.array([0.0, 0.5, 1.0, 3.0, 3.5, 4.0, 4.5])
TRUTH = np.array([
    [0.0, 0.0, 3.0], [1.0, 0.0, 3.1], [2.0, 2.0, -3.1], [5.0, 2.0, 0.0], [np.nan] * 3, [6.0, 2.0, 0.2], [7.0, 2.0, 0.4],
])  # fmt: skip


def test_stamps_of_the_truth_take_it_bit_for_bit_and_others_are_interpolated_in_short_gaps():
    found = match(TIME, TIME, TRUTH)
    assert found.truth.tobytes() == TRUTH.tobytes()
    assert (found.matched, found.unmatched, found.interpolated) == (6, 1, 0)
    found = match(TIME + 4e-7, TIME, TRUTH)
    assert (found.matched, found.interpolated) == (6, 0)  # the last one, too, which is beyond the span
    found = match(np.array([0.75]), TIME, TRUTH)
    assert found.truth[0] == pytest.approx([1.5, 1.0, np.pi], abs=1e-9) or found.truth[0, 2] == pytest.approx(-np.pi)
    assert found.interpolated == 1
    assert match(np.array([2.0]), TIME, TRUTH, 2.0).matched == 1
    assert match(np.array([0.25]), TIME, TRUTH, 0.4).matched == 0
    truth_time = np.array([0.0, 1.0 + 6e-7, 2.0 + 8e-7, 3.0 + 1.7e-6])
    truth = np.column_stack([np.array([0.0, 1.0, 1.0, 2.0]), np.zeros(4), np.zeros(4)])
    found = match(np.array([0.5, 2.5]), truth_time, truth)
    assert found.interpolated == 2
    # the two in the middle are half a metre from the chord of their neighbours
    assert found.error == pytest.approx(0.25 * 0.5, rel=1e-5)
    assert np.isnan(match(np.array([0.5]), truth_time, truth, 0.9).error)


@pytest.mark.parametrize("stamp", [-0.01, 4.51, 2.0, 3.2, 3.5, 3.7])
def test_outside_in_a_gap_and_next_to_an_unknown_truth_it_is_unknown(stamp):
    found = match(np.array([stamp]), TIME, TRUTH)
    assert np.isnan(found.truth).all()
    assert (found.matched, found.unmatched) == (0, 1)


RNG = np.random.default_rng(2)
WAY = np.column_stack([np.cumsum(RNG.uniform(0.1, 1.0, 40)), np.sin(np.arange(40)), RNG.uniform(-3, 3, 40)])
MOTION = np.array([4.0, -2.0, 2.5])


def aligned(pose, truth, how):
    return aligning(in_plane(pose), in_plane(truth), how, plane=True)


def covariances(n=40):
    root = RNG.normal(size=(n, 3, 3)) * 0.1
    return root @ root.transpose(0, 2, 1)


@pytest.mark.parametrize(("how", "headings"), [("first", 1.0), ("se2", 1.0), ("sim3", math.nan), ("first", math.nan)])
def test_a_path_that_is_the_truth_elsewhere_comes_back(how, headings):
    found = aligned(se2.compose(MOTION, WAY) * [1.0, 1.0, headings], WAY, how)
    assert np.allclose((found.scale, *found.planar), (1.0, *se2.inverse(MOTION)), atol=1e-9)
    assert aligned(WAY + MOTION, WAY, "shift").planar == pytest.approx([-4.0, 2.0, 0.0])


def test_a_map_is_moved_with_its_path_and_nees_stay_what_they_were():
    assert aligned(WAY, WAY, "none") is None
    assert aligned(WAY, np.full_like(WAY, np.nan), "se2") is None
    truth = WAY.copy()
    truth[:3] = np.nan
    estimate = se2.compose(MOTION, WAY) + np.linspace(0, 1, 40)[:, None]
    T = aligned(estimate, truth, "first").planar
    assert se2.compose(T, estimate)[3] == pytest.approx(truth[3], abs=1e-9)
    path = Trajectory(WAY + 0.1 * RNG.normal(size=WAY.shape), covariances())
    elsewhere = moved(MOTION, path)
    before = nees(path.pose, path.covariance, WAY, "pose")
    after = nees(elsewhere.pose, elsewhere.covariance, se2.compose(MOTION, WAY), "pose")
    assert after == pytest.approx(before, rel=1e-9)
    C = covariances(5)[:, :2, :2]
    number = np.arange(5)
    m = moved_map(MOTION, MapEstimate(number, WAY[:5, :2], C, number, number))
    assert m.xy == pytest.approx(se2.compose(MOTION, WAY[:5])[:, :2])
    R = se2.rotation(2.5)
    assert m.covariance[3] == pytest.approx(R @ C[3] @ R.T)


def test_a_map_of_walls_is_moved_as_the_points_on_them():
    number, walls = np.arange(3), np.array([[2.0, 0.3], [-1.0, 2.0], [0.0, -3.0]])
    C = 1e-4 * np.tile(np.array([[4.0, 1.0], [1.0, 2.0]]), (3, 1, 1))
    m = moved_walls(MOTION, MapEstimate(number, walls, C, number, number))
    for (rho, alpha), (rho2, alpha2) in zip(walls, m.xy, strict=True):
        normal = np.array([np.cos(alpha), np.sin(alpha)])
        there = se2.transform_points(MOTION, rho * normal + np.outer([-3.0, 5.0], [-normal[1], normal[0]]))
        assert there @ [np.cos(alpha2), np.sin(alpha2)] == pytest.approx(rho2)
    drawn = walls[1] + np.random.default_rng(0).multivariate_normal(np.zeros(2), C[1], 20000)
    many = np.arange(len(drawn))
    elsewhere = moved_walls(MOTION, MapEstimate(many, drawn, np.tile(C[1], (len(drawn), 1, 1)), many, many))
    assert np.cov(elsewhere.xy.T) == pytest.approx(m.covariance[1], rel=0.05)


def test_landmarks_are_numbered_as_they_were_created_and_begin_with_their_first_observation():
    decisions = np.array([NEW, NEW, 0, DISCARD, NEW])
    final = np.array([NEW, 0, 0, DISCARD, NEW])
    assert created_by(decisions, final, "slam").tolist() == [0, 1, -1, -1, 2]
    assert created_by(decisions, final, "localization").tolist() == [-1] * 5
    created = np.array([0, -1, 1, -1, -1, 2, -1])
    final = np.array([DISCARD, 0, NEW, 0, 1, 1, 2])  # 0 and 2 without what created them; 1 as it was
    assert begun_by(final, created).tolist() == [-1, 0, 1, -1, -1, -1, 2]
    # in a known map nothing begins, whatever its ids are
    assert begun_by(np.array([4, 4, 7]), np.full(3, -1)).tolist() == [-1] * 3


@pytest.mark.parametrize(("late", "on_its_frames"), [(0.0, True), (5e-7, True), (0.01, False)])
def test_on_the_frames_of_the_log_it_is_a_run_of_the_log(late, on_its_frames):
    log = open_log("arena:0")
    path = GivenPath("a", "TUM", log.recorded.time + late, log.truth.pose)
    run = given_run("a", "slam", {"final": path}, log, TruePath(log.recorded.time, log.truth.pose))
    assert (log_of(run, log) is log) is on_its_frames


STAMPS = np.arange(101.0)


def line(n=101, step=0.25):
    return np.column_stack([step * np.arange(n), np.zeros(n), np.zeros(n)])


def test_relative_errors_are_those_computed_by_hand():
    truth = line()
    found = rpe_columns(truth * [1.02, 1.0, 1.0], truth, STAMPS)
    assert found["rpe_1m_m"] == pytest.approx(0.02)
    assert found["rpe_10m_m"] == pytest.approx(0.2, rel=0.01)  # the last poses have ways of 9 m and more
    assert found["rpe_frame_m"] == pytest.approx(0.005)
    assert found["rpe_10m_deg"] == 0.0
    truth = np.column_stack([line()[:, :2], np.linspace(3.0, 3.3, 101)])
    moved = se2.compose(np.array([5.0, 6.0, 1.0]), truth)
    truth[:, 2] = se2.wrap_angle(truth[:, 2])
    assert max(rpe_columns(moved, truth, STAMPS).values()) < 1e-6
    found = rpe_columns(line(9), line(9), STAMPS[:9])
    assert found["rpe_1m_m"] == 0.0
    assert found["rpe_10m_m"] is None
    assert rpe_columns(line(1), line(1), STAMPS[:1])["rpe_frame_m"] is None
    truth = line()
    truth[::2] = np.nan
    estimate = np.column_stack([line()[:, :2], 0.01 * np.arange(101)])
    assert rpe_columns(estimate, truth, STAMPS)["rpe_frame_deg"] == pytest.approx(math.degrees(0.02))


@pytest.mark.parametrize("step", [0.1, 1.0009, 7.0])
def test_no_pair_is_across_a_gap_of_the_truth(step):
    truth = line()
    estimate = truth + np.where(np.arange(101) < 50, 0.0, 3.0)[:, None] * [1, 0, 0]
    truth[45:56] = np.nan
    found = rpe_columns(estimate, truth, step * STAMPS)
    assert max(found[f"rpe_{name}_m"] for name in ("frame", "1m", "10m")) < 1e-9


def test_pairs_are_those_of_a_search_through_all_poses():
    rng = np.random.default_rng(3)
    step = rng.uniform(0.0, 0.5, 300) * (rng.random(300) > 0.3)  # it often stands still
    xy = np.column_stack([np.cumsum(step), np.zeros(300)])
    way = np.cumsum(np.abs(np.diff(xy[:, 0], prepend=xy[0, 0])))
    for distance in (0.3, 1.0, 10.0):
        wanted = []
        for i in range(299):
            off = np.abs(way[i + 1 :] - way[i] - distance)
            if off.min() <= TOLERANCE * distance:
                wanted.append((i, i + 1 + int(off.argmin())))
        assert list(zip(*(p.tolist() for p in pairs_by_way(xy, distance)))) == wanted


DRIVEN = 60.0  # s


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
    assert time_offset("mine", *given)[0] == pytest.approx(offset, abs=2e-3)


def test_noisy_paths_are_within_their_standard_errors():
    found = [time_offset("mine", *pair(0.42, noise=0.02, seed=seed)) for seed in range(12)]
    errors, stated = np.array(found).T - [[0.42], [0.0]]
    assert np.sqrt(np.mean(errors**2)) < 0.05
    assert 0.4 < np.sqrt(np.mean((errors / stated) ** 2)) < 2.5


@pytest.mark.parametrize(("drawn", "rows", "rate", "said"), [
    ({"laps": True}, None, 1.0, "state it, as in --time-offset"),
    ({"laps": True, "noise": 0.02}, None, 1.0, "state it, as in --time-offset"),
    ({}, 2, 1.0, "fewer than three poses"), ({}, 4, 1.0, "too short for rates"),
    ({"noise": 0.002}, None, 1.035, r"different rates, by -?3"),
])  # fmt: skip
def test_steady_motion_short_paths_and_clocks_of_different_rates_are_not_guessed_at(drawn, rows, rate, said):
    time, pose, true, truth = pair(0.5, **drawn)
    with pytest.raises(DataError, match=said):
        time_offset("mine", rate * time[:rows] + 7.0, pose[:rows], true, truth)


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


def test_without_an_overlap_the_flag_is_named_and_works_and_other_values_are_refused(files, tmp_path, capsys, refused):
    for flag, said in (("soon", "a number of seconds or auto is needed"), ("truth=1", "result by the negative")):
        assert said in refused(score, [*files, "--time-offset", flag])
    head, *rows = (tmp_path / "mine.csv").read_text().splitlines()
    moved = [f"{float(t) + 1e5!r},{rest}" for t, rest in (row.split(",", 1) for row in rows)]
    (tmp_path / "mine.csv").write_text("\n".join([head, *moved]))
    assert "`--time-offset auto` estimates an offset" in refused(score, files)
    assert score([*files, "--time-offset", "auto", "--align", "se2"]) == 0
    values = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert float(values["rmse_position_m"]) < 0.01

"""Teams: the joint filter against batch least squares, exchanges of estimates, a written dataset, and studies."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from data.errors import DataError, UsageError
from data.formats.mrclam import FROZEN, load_mrclam
from data.inputs import LandmarkMap
from data.logs import Reading
from data.result import DISCARD
from data.se2 import between, compose, inverse
from data.sensors import RangeBearing
from eval.compare import compare
from eval.judgement.judgement import judge
from eval.plan.flags.table import Selection
from eval.player.document import company_of, played
from eval.player.scene import scene
from eval.referee import consistency
from eval.referee.result_files import TEAM
from eval.referee.score import Trial, score
from eval.replay.settings import Setup
from eval.report.terminal import groups_of
from tests.builders.logs import increments_of, inputs_of, observations_of
from tests.builders.unpacked import unpacked
from wings.cooperative.experiments import experiments, named_team, team_logs
from wings.cooperative.report import judged, rows_of
from wings.cooperative.runs import Gates, TeamFilter, independent, intersected
from wings.cooperative.team import team_of
from wings.cooperative.world import Team, simulate_all

KNOWN = LandmarkMap(np.array([0]), np.array([[3.0, 1.0]]))


def linear_pair(rng, frames=6):
    """Two robots whose headings are known and stay zero: positions, odometry, one landmark, encounters both ways."""
    P, Q, R = np.diag([0.3, 0.2, 1e-14]), np.diag([0.04, 0.02, 1e-14]), np.diag([0.01, 0.02])
    prior = [np.array([0.0, 0.0, 0.0]), np.array([2.0, -1.0, 0.0])]
    moves = rng.normal(0.5, 0.3, (2, frames, 2))
    of_landmark, of_robot = rng.normal(1.0, 0.5, (frames, 2)), rng.normal(1.0, 0.5, (2, frames, 2))
    members, labels, seen = [], [], []
    for k in range(2):
        steps = increments_of(np.column_stack([moves[k], np.zeros(frames)]), Q)
        rows = frames if k == 0 else 0  # robot 1 alone sees the landmark
        seen_by_it = observations_of(np.arange(rows), of_landmark[:rows], R)
        members.append(inputs_of(steps, seen_by_it, known=KNOWN, start=prior[k], spread=P))
        labels.append(np.zeros(rows, np.int64))
        seen.append((np.arange(frames), of_robot[k], np.tile(R, (frames, 1, 1)), np.full(frames, 2 - k)))
    return team_of((1, 2), members, labels, (0.0, 0.0), seen), (P, Q, R, prior, moves, of_landmark, of_robot)


def least_squares(parts, last):
    """Positions of both robots at frame `last`, and their covariance, from all data up to it by normal equations."""
    P, Q, R, prior, moves, of_landmark, of_robot = parts
    size = 4 * (last + 1)
    rows, right = [], []

    def add(blocks, value, covariance):
        A = np.zeros((2, size))
        for at, sign in blocks:
            A[:, at : at + 2] += sign * np.eye(2)
        root = np.linalg.inv(np.linalg.cholesky(covariance[:2, :2]))
        rows.append(root @ A)
        right.append(root @ value)

    for f in range(last + 1):
        for k in range(2):
            at = 4 * f + 2 * k
            if f:
                add([(at, 1), (at - 4, -1)], moves[k, f], Q)
            else:
                add([(at, 1)], prior[k][:2], P)
            add([(4 * f + 2 - 2 * k, 1), (at, -1)], of_robot[k, f], R)
        add([(4 * f, -1)], of_landmark[f] - KNOWN.xy[0], R)
    A, b = np.concatenate(rows), np.concatenate(right)
    C = np.linalg.inv(A.T @ A)
    return (C @ A.T @ b)[-4:], C[-4:, -4:]


def test_joint_filter_is_batch_least_squares_naive_exchange_claims_more_and_intersection_less_where_all_is_linear():
    team, parts = linear_pair(np.random.default_rng(5))
    filter_ = TeamFilter(team, KNOWN, "joint", Gates())
    tracks = filter_.run()
    places = [0, 1, 3, 4]
    for last in range(6):
        mean, C = least_squares(parts, last)
        for k in range(2):
            assert tracks[k].pose[last, :2] == pytest.approx(mean[2 * k : 2 * k + 2], abs=1e-6)
            own = C[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
            assert tracks[k].covariance[last][:2, :2] == pytest.approx(own, abs=1e-6)
    assert filter_.P[np.ix_(places, places)] == pytest.approx(C, abs=1e-6), "with the correlation between the robots"
    assert (tracks[0].stats[:, 1] == 4).all()
    assert (tracks[1].stats[:, 1] == 2).all()
    size = {
        exchange: np.linalg.det(TeamFilter(team, KNOWN, exchange, Gates()).run()[1].covariance[5][:2, :2])
        for exchange in ("naive", "intersection")
    }
    assert size["naive"] < np.linalg.det(C[2:, 2:]) < size["intersection"]


def random_covariance(rng, n):
    A = rng.standard_normal((n, n + 1))
    return A @ A.T + 1e-3 * np.eye(n)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0))
def test_intersection_is_conservative_for_every_correlation(seed, share):
    rng = np.random.default_rng(seed)
    P_a, P_b, R = (random_covariance(rng, n) for n in (3, 3, 2))
    H, G = rng.standard_normal((2, 3)), rng.standard_normal((2, 3))
    U = np.linalg.qr(rng.standard_normal((3, 3)))[0]  # a correlation up to one in any direction
    cross = np.linalg.cholesky(P_a) @ (share * U) @ np.linalg.cholesky(P_b).T
    K, claimed = intersected(P_a, H, G @ P_b @ G.T, R)
    F = np.eye(3) - K @ H
    across = F @ cross @ (K @ G).T
    true = F @ P_a @ F.T + K @ (G @ P_b @ G.T + R) @ K.T - across - across.T
    assert np.linalg.eigvalsh(claimed - true)[0] > -1e-9 * np.linalg.norm(claimed)
    assert np.linalg.det(claimed) <= np.linalg.det(P_a) * (1 + 1e-9)
    assert np.linalg.det(independent(P_a, H, G @ P_b @ G.T, R)[1]) <= np.linalg.det(claimed) * (1 + 1e-9)


@pytest.mark.parametrize("task", ["localization", "slam"])
def test_smoother_and_filter_agree_with_the_truth_as_they_claim(task):
    for log in simulate_all(Team(robots=3, frames=40, landmarks=4), 1):
        runs = compare(log.inputs(labels=True), task, ("dead-reckoning", "ekf", "batch"))
        assert [r.status for r in runs] == ["ok"] * 3
        for run in runs[1:]:
            path = run.trajectory(run.phases[-1])
            assert np.nanmean(consistency.nees(path.pose, path.covariance, log.truth.pose, "pose")) < 15.0
        assert runs[2].last_step_sigma < 1e-3
        a, b = (r.trajectory(r.phases[-1]) for r in runs[1:])  # the newest pose knows the same, up to linearization
        assert b.pose[-1] == pytest.approx(a.pose[-1], abs=0.5 * math.sqrt(np.linalg.eigvalsh(a.covariance[-1])[-1]))
        assert np.linalg.det(b.covariance[20]) < np.linalg.det(a.covariance[20])


def test_robots_are_told_apart_by_place():
    (log, *_) = simulate_all(Team(robots=3, frames=40, landmarks=8), 2)
    (run,) = compare(log.inputs(), "localization", ["ekf"], "nn")
    found, every = judged(log.recorded.team, 0, run.sighted), len(log.recorded.team.of(0))
    assert found.tp + found.tn + found.fp + found.fn == every
    assert found.tp > 0.9 * every
    wrong = np.where(run.sighted == 2, 3, np.where(run.sighted == 3, 2, run.sighted))
    assert judged(log.recorded.team, 0, wrong).fp == found.tp
    assert judged(log.recorded.team, 0, np.full(len(wrong), DISCARD)).fn == every


def test_experiments_are_every_robot_with_every_exchange():
    made = experiments("arena:4:robots=2+frames=20", Selection(), Setup(), Reading(), lambda _: None)
    names = [(e.log.name.rpartition("-")[2], e.variant_of is None, e.work[0].estimators) for e in made]
    assert names[:2] == [("robot1", True, ("dead-reckoning", "ekf", "batch")), ("robot1:naive", False, ("ekf",))]
    assert [n for n, _, _ in names[4:]] == ["robot2", "robot2:naive", "robot2:intersection", "robot2:alone"]
    runs = compare(made[0].log.inputs(labels=True), "localization", ["ekf", "isam2"])
    assert [r.status for r in runs] == ["ok", "incomplete"], "iSAM2 is for one robot"
    assert {r["robots_fp"] for r in rows_of(made[0].log, runs[0])} == {0}


@pytest.mark.parametrize(("name", "selection", "said"), [
    ("arena:0", Selection(), "no team"), ("arena:0:robots=1", Selection(), "two robots"),
    ("team:0:robots=2+robot=3", Selection(), "there are 2"), ("team:0:scale=0.1", Selection(), "one robot"),
    ("team:0:frames=9", Selection(estimator=("isam2",)), "isam2"),
    ("team:0:frames=9", Selection(association=("scan",)), "scan"),
    ("team:0:frames=9", Selection(task=("slam",), association=("nn",)), "labels"),
])  # fmt: skip
def test_what_is_no_team_is_refused(name, selection, said):
    with pytest.raises(UsageError, match=said):
        experiments(name, selection, Setup(), Reading(), lambda _: None)


def trials_of(name, association="known"):
    made = experiments(name, Selection(association=(association,)), Setup(), Reading(), lambda _: None)
    labels = association == "known"
    ran = [(e, compare(e.log.inputs(labels=labels), e.task, w.estimators, w.association)) for e in made for w in e.work]
    return [Trial(e.log, e.task, tuple(runs), e.variant_of) for e, runs in ran]


def test_the_player_of_a_robot_has_all_robots_on_its_clock_and_who_observed_whom():
    trials = trials_of("arena:4:robots=3+frames=30")
    group = next(g for g in played(trials) if g[0].log.name.endswith("robot2"))
    assert [t.log.name.rpartition(":")[2] for t in group[1:]] == ["naive", "intersection", "alone"]
    team = group[0].log.recorded.team
    chunk = scene(group, Setup(), company_of(group, trials))
    arrays, step = unpacked(chunk), 0.1 * chunk["quantum"]
    assert [(r["name"], r["key"]) for r in chunk["team"]["robots"]] == [
        ("robot 1", "mate0."), ("robot 2", ""), ("robot 3", "mate2.")
    ]  # fmt: skip
    assert len({r["colour"] for r in chunk["team"]["robots"]}) == 3
    for run in chunk["runs"]:
        for row in (0, 2):
            own = next(
                t for t in trials if t.log.name.endswith(f"robot{row + 1}{':' * bool(run['variant'])}{run['variant']}")
            )
            other = own.find(run["estimator"], run["association"])
            for phase in run["phases"]:
                found = arrays[f"{run['key']}mate{row}.{phase}_xy"]
                assert np.abs(found - other.trajectory(phase).pose[:, :2]).max() < step
        met = f"{run['key']}met" in arrays
        assert met == (run["decides"] and run["variant"] != "alone")
        if met:  # by label all are right
            assert arrays[f"{run['key']}met"][:, 0].tolist() == (team.encounters.label - 1).tolist()
            assert set(arrays[f"{run['key']}met_outcome"][:, 0]) == {0.0}
    assert arrays["met_frame"][:, 0].tolist() == team.encounters.instant.tolist()
    seen = RangeBearing().body_points(team.encounters.z, team.encounters.R)[0]
    assert np.abs(arrays["met_point"] - seen).max() < step
    assert np.abs(arrays["mate0.truth"] - trials[0].log.truth.pose[:, :2]).max() < step


def test_a_robot_that_saw_robots_alone_is_no_dead_reckoning():
    trials = trials_of("arena:0:robots=5+frames=60")
    judged = {t.log.name.rpartition("-")[2]: judge(t) for t in trials if "robot5" in t.log.name}
    assert not any(r.idle for r in judged["robot5"].last)
    assert not judged["robot5"].log_faults.empty
    assert all(r.idle for r in judged["robot5:alone"].last if r.estimator != "dead-reckoning")
    assert judged["robot5:alone"].log_faults.empty
    pairs = [(t, judge(t)) for t in trials if "robot5" in t.log.name]
    rows = [r for g in groups_of(pairs, score([]), (), ()) for r in g.rows]
    assert {r.estimator for r in rows} >= {"ekf", "ekf (naive)", "ekf (intersection)", "batch (alone)"}


def test_rows_of_a_team_are_those_that_the_page_describes():
    trials = trials_of("team:2:robots=2+frames=20")
    table = TEAM.table([row for t in trials for run in t.runs for row in rows_of(t.log, run)])
    assert set(table["exchange"]) == {"none", "joint", "naive", "intersection", "alone"}
    assert table["rmse_position_m"].notna().all()


def written(folder, robots, *, truth=(1, 2, 3, 4, 5), frames=60):
    """A dataset with robots that go straight in parallel, see a landmark ahead, and the robot to their left."""
    folder.mkdir()
    lines = {"Barcodes.dat": [(s, 2 * s) for s in range(1, 8)]}
    places = {6: (8.0, 0.5), 7: (9.0, 3.0)}
    lines["Landmark_Groundtruth.dat"] = [(s, x, y, 0.0, 0.0) for s, (x, y) in places.items()]
    stamps, speed = 1000.0 + 0.2 * np.arange(frames), 0.1
    for r in robots:
        pose = np.column_stack([0.1 * (stamps - 1000.0), np.full(frames, 0.7 * r), np.zeros(frames)])
        pose[:, 0] -= 0.5 * r  # so that the next one is in front, to the left
        if r in truth:
            lines[f"Robot{r}_Groundtruth.dat"] = np.column_stack([stamps, pose])
        lines[f"Robot{r}_Odometry.dat"] = np.column_stack([stamps, np.full(frames, speed), np.zeros(frames)])
        seen = []
        for k in range(2, frames - 2, 5):
            points = {**places, r - 1: (pose[k, 0] + 0.5, 0.7 * (r - 1))} if r - 1 in robots else places
            for s, at in points.items():
                rel = compose(inverse(pose[k]), np.array([*at, 0.0]))
                distance, bearing = math.hypot(*rel[:2]), math.atan2(rel[1], rel[0])
                seen.append((stamps[k] + 0.04, 2 * s, 1.01 * distance * math.cos(bearing) + 0.06, bearing))
        lines[f"Robot{r}_Measurement.dat"] = seen
    for name, rows in lines.items():
        table = np.atleast_2d(np.array(rows, float))
        numbers = ["%d" if (column == np.rint(column)).all() and i < 2 else "%.6f" for i, column in enumerate(table.T)]
        np.savetxt(folder / name, table, numbers, header="header")
    return folder


def test_written_dataset_with_five_robots(tmp_path):
    folder = written(tmp_path / "MRCLAM_Dataset8", range(1, 6))
    logs = named_team(str(folder))
    assert [log.name for log in logs] == [f"mrclam8-robot{k}" for k in range(1, 6)]
    team = logs[0].recorded.team
    assert [set(team.encounters.label[team.of(k)].tolist()) for k in range(5)] == [set(), {1}, {2}, {3}, {4}]
    assert pytest.approx(FROZEN.noise(team.encounters.z)) == team.encounters.R
    for k, log in enumerate(logs, 1):
        alone = load_mrclam(folder, k)
        assert log.recorded.prior.mean == pytest.approx(alone.recorded.prior.mean, abs=1e-9)
        assert log.truth.landmark_of.tolist() == alone.truth.landmark_of.tolist()
        assert log.recorded.observations.z == pytest.approx(alone.recorded.observations.z)
        ekf, batch = compare(log.inputs(labels=True), "localization", ("ekf", "batch"))
        for run in (ekf, batch):
            assert np.nanmax(np.abs(between(log.truth.pose, run.trajectory(run.phases[-1]).pose)[:, :2])) < 0.1
        assert (ekf.sighted == team.encounters.label[team.of(k - 1)]).all()


def test_robot_without_truth_is_left_out_and_one_is_no_team(tmp_path):
    logs = team_logs(written(tmp_path / "MRCLAM_Dataset7", (1, 2, 3), truth=(1, 3)))
    assert [log.source["robot"] for log in logs] == [1, 3]
    with pytest.raises(DataError, match="a team needs two"):
        team_logs(written(tmp_path / "MRCLAM_Dataset9", (3,)))


def test_world_refuses_another_sensor():
    assert isinstance(Team().model(), RangeBearing)
    with pytest.raises(UsageError, match="sensor"):
        replace(Team(), sensor="relative_point")


@pytest.mark.slow
def test_hundred_robots_are_as_consistent_as_their_exchange():
    means = {}
    for exchange in ("joint", "naive", "intersection"):
        own = []
        for seed in range(100):
            log = simulate_all(Team(exchange=exchange), 500 + seed)[seed % 5]
            (run,) = compare(log.inputs(labels=True), "localization", ["ekf"])
            own.append(np.nanmean(consistency.nees(run.online.pose, run.online.covariance, log.truth.pose, "pose")))
        means[exchange] = consistency.verdict(np.array(own), 3)
    assert {exchange: v.word for exchange, v in means.items()} == {
        "joint": consistency.CONSISTENT, "naive": consistency.OVERCONFIDENT, "intersection": consistency.CONSERVATIVE,
    }  # fmt: skip
    assert means["naive"].lower > 4.0

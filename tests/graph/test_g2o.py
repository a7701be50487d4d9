"""g2o graphs and logs: what gtsam makes of a file, our batch makes of the log it becomes, and back again."""

import math
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from data import se2
from data.convert.__main__ import main
from data.errors import DataError, UsageError
from data.formats.g2o import POSE_IDS, Estimate, graph_text, labelled, log_of, read_graph
from data.formats.graph_file import read_graph_file, with_information
from data.formats.open_log import load_folder, write_folder
from data.log import Log
from data.pose_measurements import FixKind
from data.se2 import compose, inverse
from data.sensors import Range
from data.worlds.arena import Arena, simulate
from eval.referee.errors import observed
from eval.replay.run import compare
from wings.audit.files import build, optimized

WORLD = Arena(frames=30, landmarks=8)
POSES = range(8, 38)
"""Ids of the poses, above those of the landmarks."""


def numbers(line: str) -> list[float]:
    return [float(f) for f in line.split()[1:]]


def of_gtsam(path: Path) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """gtsam's own reading of vertices and EDGE_SE2; landmark edges, which it does not read, by their definition."""
    graph, values = gtsam.readG2o(str(path), False)
    graph = gtsam.NonlinearFactorGraph(graph)
    for line in path.read_text().splitlines():
        tag, v = line.split()[0], numbers(line)
        if tag == "FIX":
            graph.add(gtsam.NonlinearEqualityPose2(int(v[0]), values.atPose2(int(v[0]))))
        elif tag == "EDGE_SE2_XY":
            information = np.array([[v[4], v[5]], [v[5], v[6]]])
            model = gtsam.noiseModel.Gaussian.Information(information)
            graph.add(gtsam.CustomFactor(model, [int(v[0]), int(v[1])], point_error(np.array(v[2:4]))))
        elif tag == "EDGE_BEARING_SE2_XY":
            model = gtsam.noiseModel.Isotropic.Sigma(1, v[3] ** -0.5)
            graph.add(gtsam.BearingFactor2D(int(v[0]), int(v[1]), gtsam.Rot2(v[2]), model))
    for line in path.read_text().splitlines():
        if line.startswith("VERTEX_XY"):
            i, x, y = numbers(line)
            if not values.exists(int(i)):
                values.insert(int(i), np.array([x, y]))
    return graph, values


def point_error(measured):
    def error(this, values, jacobians):
        pose, point = values.atPose2(this.keys()[0]), values.atPoint2(this.keys()[1])
        Hx, Hl = np.zeros((2, 3), order="F"), np.zeros((2, 2), order="F")
        seen = pose.transformTo(point, Hx, Hl)
        if jacobians is not None:
            jacobians[0], jacobians[1] = Hx, Hl
        return seen - measured

    return error


def minimum(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def batch_of(log: Log):
    return compare(log.inputs(labels=True).without_map(), "slam", ("batch",), "known")[0]


@pytest.fixture
def arena_graph(tmp_path: Path) -> Path:
    log = simulate(WORLD, 3)
    path = tmp_path / "arena.g2o"
    path.write_text(graph_text(log.recorded, labelled(log)))
    return path


def test_our_batch_finds_the_minimum_that_gtsam_finds_in_the_file(arena_graph):
    log = log_of("arena", read_graph(arena_graph))
    run, expected = batch_of(log), minimum(*of_gtsam(arena_graph))
    theirs = np.array([[p.x(), p.y(), p.theta()] for p in (expected.atPose2(k) for k in POSES)])
    assert np.abs(se2.pose_error(run.final.pose, theirs)).max() < 1e-6
    label = log.granted
    founders = np.flatnonzero(run.created >= 0)
    for number, xy in zip(run.map.number, run.map.xy, strict=True):
        name = int(label[founders[run.created[founders] == number][0]])
        assert xy == pytest.approx(expected.atPoint2(name), abs=1e-6)


def test_bearings_alone_give_the_minimum_of_bearing_factors(arena_graph, tmp_path):
    lines = []  # the scale comes from the odometry
    for line in arena_graph.read_text().splitlines():
        if line.startswith("EDGE_SE2_XY"):
            i, j, x, y, *_ = numbers(line)
            line = f"EDGE_BEARING_SE2_XY {int(i)} {int(j)} {float(np.arctan2(y, x))!r} 2500.0"
        lines.append(line)
    path = tmp_path / "bearings.g2o"
    path.write_text("\n".join(lines))
    log = log_of("bearings", read_graph(path))
    assert log.recorded.sensor.name == "bearing"
    run = batch_of(log)
    landmarks = dict(zip(run.map.number.tolist(), run.map.xy, strict=True))
    used = np.where(np.isin(observed(run), list(landmarks)), 1000 + observed(run), -1)
    again = tmp_path / "again.g2o"
    again.write_text(
        graph_text(log.recorded, Estimate(run.final.pose, used, {1000 + n: landmarks[n] for n in landmarks}))
    )
    assert 0.8 * len(used) < (used >= 0).sum() == again.read_text().count("EDGE_BEARING_SE2_XY")
    expected = minimum(*of_gtsam(again))
    theirs = np.array([[p.x(), p.y(), p.theta()] for p in (expected.atPose2(k) for k in range(len(log.recorded)))])
    assert np.abs(se2.pose_error(run.final.pose, theirs)).max() < 1e-5
    with pytest.raises(UsageError, match="which locate no landmarks"):
        labelled(log)


def test_landmarks_keep_their_ids_and_loop_closures_their_information(arena_graph, tmp_path, capsys):
    """Of three closures one joins neighbours again; their information differs by direction."""
    closures = ("37 8 0.5 0.3 2.0 50 3 2 40 1 90", "10 30 1 2 -1 60 0 5 60 0 80", "12 13 1 0 0 9 0 0 9 0 9")
    with arena_graph.open("a") as file:
        file.writelines(f"EDGE_SE2 {edge}\n" for edge in closures)
    assert main(["g2o", str(arena_graph), str(tmp_path / "log")]) == 0
    assert main(["g2o", str(tmp_path / "log"), str(tmp_path / "back.g2o")]) == 0
    assert ", 3 closures" in capsys.readouterr().out
    one, two = read_graph(arena_graph), read_graph(tmp_path / "back.g2o")
    assert list(two.file.points) == list(one.file.points)
    assert list(two.file.poses) == list(POSES)
    by = [*range(29), 31, 30, 29]  # closures by their later pose
    assert two.motion.ends.tolist() == one.motion.ends[by].tolist()
    assert two.motion.measured == pytest.approx(one.motion.measured[by])
    assert two.motion.covariance == pytest.approx(one.motion.covariance[by], rel=1e-9, abs=1e-12)
    assert two.observation.ends.tolist() == one.observation.ends.tolist()


def test_loop_closures_become_closures_and_are_spoken_of(tmp_path):
    chain = "".join(f"VERTEX_SE2 {7 + 2 * k} {k} 0 0\n" for k in range(4))
    chain += "".join(f"EDGE_SE2 {7 + 2 * k} {9 + 2 * k} 1 0 0 100 0 0 100 0 400\n" for k in range(3))
    path = tmp_path / "loop.g2o"
    path.write_text(chain + "EDGE_SE2 7 13 3.1 0.2 0.1 50 0 0 50 0 80\nEQUIV 7 9\nEDGE_SE2 9 9 1 0 0\nFIX 9\n")
    assert main(["g2o", str(path), str(tmp_path / "log")]) == 0
    log = load_folder(tmp_path / "log")
    closures = log.recorded.closures
    assert log.truth.relations is None
    assert (closures.frame1.tolist(), closures.frame2.tolist()) == ([0], [3])
    assert closures.relative.tolist() == [[3.1, 0.2, 0.1]]
    said = " ".join(log.notes)
    assert "1 EDGE_SE2 outside the chain" in said
    assert "1 EQUIV left out" in said
    assert "1 EDGE_SE2 from a vertex to itself (line 10) left out" in said
    assert "FIX 9" in said
    assert log.recorded.increments.covariance[1] == pytest.approx(np.diag([0.01, 0.01, 0.0025]))


CLOSURES = ("17 9 0.5 0.3 2.0 50 3 2 40 1 90", "10 16 1 2 -1 60 0 5 60 0 80", "12 13 1 0 0.9 9 1 2 9 3 9")
"""Backwards, far apart, and between neighbours; their information differs by direction."""


def test_a_closure_has_the_error_of_gtsam_s_factor(tmp_path):
    """To first order: gtsam's error is the logarithm of the relative pose seen from the measured end."""
    rng = np.random.default_rng(5)
    ids = range(8, 18)
    text = "".join(f"VERTEX_SE2 {i} {i} 0 0\n" for i in ids)
    text += "".join(f"EDGE_SE2 {i} {i + 1} 1 0 0 100 0 0 100 0 400\n" for i in ids[:-1])
    path = tmp_path / "a.g2o"
    path.write_text(text + "".join(f"EDGE_SE2 {edge}\n" for edge in CLOSURES))
    closures = log_of("a", read_graph(path)).recorded.closures
    factors, _ = gtsam.readG2o(str(path), False)
    latest = {tuple(factors.at(n).keys()): factors.at(n) for n in range(factors.size())}
    assert closures.sources == ("EDGE_SE2",)
    assert closures.later.tolist() == [5, 8, 9]
    for k, i, j in zip(range(3), closures.frame1.tolist(), closures.frame2.tolist(), strict=True):
        for _ in range(20):
            off, start = 1e-6 * rng.normal(size=3), rng.normal(size=3)
            end = se2.compose(start, closures.relative[k] + off)
            values = gtsam.Values()
            values.insert(ids[i], gtsam.Pose2(*start))
            values.insert(ids[j], gtsam.Pose2(*end))
            ours = 0.5 * off @ np.linalg.solve(closures.covariance[k], off)
            assert ours == pytest.approx(latest[ids[i], ids[j]].error(values), rel=1e-4)


def test_vertices_that_are_the_truth_score_the_log(arena_graph, tmp_path):
    assert main(["g2o", str(arena_graph), str(tmp_path / "log"), "--true"]) == 0
    log = load_folder(tmp_path / "log")
    assert log.truth.known_poses == WORLD.frames
    assert log.recorded.map is not None


def test_a_run_of_a_report_becomes_a_graph_that_is_at_its_minimum(tmp_path):
    from eval.run_all import main as run

    write_folder(simulate(WORLD, 4), tmp_path / "log")
    out = tmp_path / "report"
    words = ["--log", str(tmp_path / "log"), "--task", "slam", "--estimator", "batch", "--no-plots", "--out", str(out)]
    assert run([*words, "--association", "jcbb"]) == 0
    folder = out / "runs" / "log" / "slam-batch-jcbb"
    assert main(["g2o", str(tmp_path / "log"), str(tmp_path / "run.g2o"), "--run", str(folder)]) == 0
    graph, values = of_gtsam(tmp_path / "run.g2o")
    # points instead of ranges and bearings: the same to first order
    assert graph.error(values) == pytest.approx(graph.error(minimum(graph, values)), rel=0.05)
    survey = load_folder(tmp_path / "log").truth.landmarks
    lines = (tmp_path / "run.g2o").read_text().splitlines()
    ids, *xy = np.array([numbers(line) for line in lines if line.startswith("VERTEX_XY")]).T
    assert len(ids) > 4
    assert np.hypot(*(np.array(xy).T - survey.positions(ids.astype(int))).T).max() < 0.5


def test_where_one_pose_has_a_line_the_others_begin_where_edges_put_them(tmp_path):
    """A square whose third edge points backward; a second pose with a line means that lines are missing."""
    turn, rest = "1 0 1.5707963267948966", "9 0 0 9 0 9"
    edges = f"EDGE_SE2 7 8 {turn} {rest}\nEDGE_SE2 8 9 {turn} {rest}\n"
    edges += f"EDGE_SE2 10 9 0 1 -1.5707963267948966 {rest}\n"
    path = tmp_path / "square.g2o"
    path.write_text(f"VERTEX_SE2 7 3 4 0\n{edges}")
    log = log_of("square", read_graph(path))
    assert log.recorded.prior.mean == pytest.approx([3.0, 4.0, 0.0])
    assert log.recorded.increments.mean[1:] == pytest.approx(np.array([[1.0, 0.0, 0.5 * np.pi]] * 3), abs=1e-12)
    assert log.notes[0].startswith("One pose has a line")
    path.write_text(f"VERTEX_SE2 7 3 4 0\nVERTEX_SE2 8 4 4 1.5\n{edges}")
    with pytest.raises(DataError, match="vertex 9 is missing"):
        read_graph_file(path)


@pytest.mark.parametrize(("text", "said"), [
    ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "in space"),
    ("VERTEX_SE2 0 0 0\n", ":1: VERTEX_SE2 with 3 numbers; 4 are needed"),
    (
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 9 0 0 9 0 9\n"
        "EDGE_SE2 1 0 -1 0 1 9 0 0 1e30 0 7\n",
        ":4: EDGE_SE2: its covariance is singular to rounding",
    ),
    ("VERTEX_SE2 0 0 0 0\nVERTEX_XY 0 1 1\n", "vertex 0 is repeated"),
    ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n", "no EDGE_SE2 between the successive poses 0 and 1"),
    ("VERTEX_SE2 0 0 0 0\nEDGE_SE2_XY 5 9 1 0 1 0 1\n", ":2: EDGE_SE2_XY: vertex 5 is missing"),
    ("VERTEX_SE2 3 0 0 0\nEDGE_SE2 3 4 1 0-2 1 0 0 1 0 1\n", "with 10 numbers; 11 are needed; '0-2' is no number"),
    ("LANDMARK 0 7 24\n", "LANDMARK with 3 numbers; 7 are needed; as gtsam"),
    ("EDGE_SE2 0 1 1 0 90 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n", "turns of most edges exceed 2 pi"),
    ("VERTEX_SE2 0 0 0 0\nEDGE_SE2_XY 0 9 1 0 1 0 1e-320\n", ":2: EDGE_SE2_XY: its information is nearly none"),
])  # fmt: skip
def test_what_is_wrong_in_a_file_is_one_line(text, said, tmp_path):
    path = tmp_path / "bad.g2o"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        log_of("bad", read_graph(path))
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("name", ["w100.graph", "w100_30.g2o", "noisyToyGraph.txt", "pose2example.txt"])
def test_a_pose_graph_is_optimized_to_the_optimum_of_gtsam(name):
    """The pose graphs that ship with it: chi-square to 1e-9, by the batch smoother and by iSAM2 in the end."""
    path = Path(gtsam.findExampleDataFile(name))
    graph, values = gtsam.load2D(str(path)) if name == "w100.graph" else gtsam.readG2o(str(path), False)
    graph = gtsam.NonlinearFactorGraph(graph)
    first = min(values.keys())
    graph.add(gtsam.NonlinearEqualityPose2(first, values.atPose2(first)))
    theirs = minimum(graph, values)
    chi_square = 2.0 * graph.error(theirs)
    inputs = log_of(name, read_graph(path)).inputs()
    runs = {run.estimator: run for run in compare(inputs, "slam", ["batch", "isam2"], "jcbb")}
    for estimator in ("batch", "isam2"):
        run = runs[estimator]
        assert run.failure is None
        assert run.total_nis[0] == pytest.approx(chi_square, rel=1e-9, abs=1e-9)
        assert run.total_nis[1] == 3 * len(inputs.closures)
        apart = se2.between(run.final.pose[0], run.final.pose)
        there = [theirs.atPose2(first).between(theirs.atPose2(k)) for k in sorted(values.keys())]
        assert np.abs(apart[:, :2] - [[p.x(), p.y()] for p in there]).max() < 1e-5
        assert run.closures_final.used.all()


def test_several_sensors_become_points_of_each_and_ranges_from_beside_the_robot_are_refused():
    log = log_of_two_sensors()
    text = graph_text(log.recorded, labelled(log))
    edges = [numbers(line) for line in text.splitlines() if line.startswith("EDGE_SE2_XY")]
    assert [e[2:4] for e in edges] == [pytest.approx([2.5, 0.0]), pytest.approx([0.0, 2.0])]
    alone = replace(log.recorded, sensors=(log.recorded.sensors[0], Range(label="radio", translation=(0.1, 0.0))))
    with pytest.raises(UsageError, match="the log has observations of range alone"):
        graph_text(alone, labelled(log))


def log_of_two_sensors() -> Log:
    """A laser ahead of the robot's centre, and tags seen by a camera that looks to the left."""
    return Log.from_arrays(
        "two", (np.zeros(3), np.zeros(3)), [
            {"name": "laser", "kind": "range_bearing", "translation": [-0.5, 0.0], "sigma": [0.1, 0.1]},
            {"name": "tags", "kind": "relative_point", "rotation": -math.pi / 2, "sigma": [0.1, 0.1]},
        ], [[0, 2.0, 0.0], [0, 2.0, 0.0]], observed_by=["laser", "tags"], label=[3, 4],
        increments=np.zeros((2, 3)), covariance=[0.1, 0.1, 0.1],
    )  # fmt: skip


CHAIN = [(0, 1, 1.0, 0.1, 0.2), (1, 2, 1.1, 0.0, 0.3), (2, 3, 0.9, -0.1, 0.1)]
VERTICES = "".join(f"VERTEX_SE2 {k} {k} 0.1 {0.1 * k}\n" for k in range(4))
EDGES = "".join(f"EDGE_SE2 {a} {b} {x} {y} {t} 90 3 1 80 2 400\n" for a, b, x, y, t in CHAIN)


@pytest.fixture
def written(tmp_path):
    def write(text, name="made.g2o"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def squares(file):
    """Chi-square at the vertices, by gtsam."""
    graph, values, _ = build(file)
    return 2.0 * graph.error(values)


def g2os_square(measured, information, i, j):
    """Of g2o's own definition: the pose inverse(measured) * inverse(i) * j as x, y, theta."""
    error = compose(inverse(measured), compose(inverse(i), j))
    return float(error @ information @ error)


def test_a_relation_of_sensors_with_offsets_has_g2os_error(written):
    """The definition is g2o's EdgeSE2Offset; small residuals make the first order exact enough."""
    first, second = np.array([0.3, -0.1, 0.4]), np.array([-0.2, 0.5, -1.1])
    i, j = np.array([1.0, 2.0, 0.7]), np.array([2.1, 2.4, 1.0])
    information = np.array([[90.0, 3.0, 1.0], [3.0, 80.0, 2.0], [1.0, 2.0, 400.0]])
    z = compose(compose(inverse(first), compose(inverse(i), j)), second) + [1e-4, -2e-4, 3e-4]
    lines = [f"PARAMS_SE2OFFSET {k} {' '.join(map(repr, o.tolist()))}" for k, o in ((4, first), (5, second))]
    lines += [f"VERTEX_SE2 {k} {' '.join(map(repr, p.tolist()))}" for k, p in ((0, i), (1, j))]
    lines.insert(0, f"EDGE_SE2_OFFSET 0 1 4 5 {' '.join(map(repr, z.tolist()))} 90 3 1 80 2 400")
    file = read_graph_file(written("\n".join(lines)))
    expected = g2os_square(z, information, compose(i, first), compose(j, second))
    assert squares(file) == pytest.approx(expected, rel=2e-3)
    again = read_graph_file(written(with_information(file, {0: file.edges[0].information}, set()), "again.g2o"))
    assert again.edges[0].information == pytest.approx(file.edges[0].information)
    log = log_of("sensors", read_graph(file.path))
    assert log.recorded.increments.mean[1] == pytest.approx(compose(compose(first, z), inverse(second)))


def test_a_point_that_a_sensor_with_an_offset_sees_is_where_it_is(written):
    o, z = np.array([0.3, -0.1, 0.4]), np.array([2.0, 1.0])
    text = f"PARAMS_SE2OFFSET 0 {o[0]} {o[1]} {o[2]}\n{VERTICES}VERTEX_XY 9 4 4\n{EDGES}"
    path = written(text + "EDGE_SE2_POINTXY_OFFSET 1 9 0 2.0 1.0 25 0 4\n")
    log = log_of("points", read_graph(path))
    assert log.recorded.observations.z[0] == pytest.approx(compose(o, np.array([*z, 0.0]))[:2])
    assert np.sort(np.linalg.eigvalsh(log.recorded.observations.R[0])) == pytest.approx([0.04, 0.25])
    point, pose = np.array([4.0, 4.0, 0.0]), compose(np.array([1.0, 0.1, 0.1]), o)
    off = compose(inverse(pose), point)[:2] - z
    rest = squares(read_graph_file(written(VERTICES + EDGES, "rest.g2o")))
    assert squares(read_graph_file(path)) - rest == pytest.approx(off @ np.diag([25.0, 4.0]) @ off)
    own = path.read_text().replace("EDGE_SE2_POINTXY_OFFSET", "EDGE_SE2_POINT_XY").replace("SE2OFFSET", "SE2_OFFSET")
    lines = [f"TUTORIAL_{line}" for line in own.replace("VERTEX_XY", "VERTEX_POINT_XY").splitlines()]
    tutorial = read_graph_file(written("\n".join(lines), "tutorial.g2o"))
    assert squares(tutorial) == pytest.approx(squares(read_graph_file(path)), rel=1e-12)
    assert with_information(tutorial, {}, set()).splitlines() == lines
    with pytest.raises(DataError, match="no PARAMS_SE2OFFSET 3"):
        read_graph(written(text + "EDGE_SE2_POINTXY_OFFSET 1 9 3 2.0 1.0 25 0 4\n"))


def test_priors_are_factors_of_an_audit_and_that_of_the_first_pose_is_the_logs(written):
    pose = "EDGE_PRIOR_SE2 0 0.1 0.2 0.05 100 0 0 50 0 25\nEDGE_PRIOR_SE2 2 2 0 0.2 4 0 0 4 0 4\n"
    path = written(VERTICES + EDGES + pose + "EDGE_PRIOR_SE2_XY 3 3.5 0.1 4 0 16\n")
    rest = squares(read_graph_file(written(VERTICES + EDGES, "rest.g2o")))
    added = 100 * 0.1**2 + 50 * 0.1**2 + 25 * 0.05**2 + 4 * 0.1**2 + 4 * 0.5**2
    assert squares(read_graph_file(path)) - rest == pytest.approx(added, rel=0.02)  # errors are seen from turned frames
    graph, values, names = build(read_graph_file(written(f"{path.read_text()}FIX 0\n", "held.g2o")))
    assert names[-1] == "fixed"
    assert optimized(graph, values).atPose2(0).equals(values.atPose2(0), 1e-9)
    log = log_of("fixed", read_graph(path))
    assert log.recorded.prior.mean == pytest.approx([0.1, 0.2, 0.05])
    assert log.recorded.prior.covariance[2, 2] == pytest.approx(1 / 25)
    fixes = log.recorded.fixes
    assert (fixes.frame.tolist(), fixes.kind.tolist()) == ([2, 3], [FixKind.POSE, FixKind.POSITION])
    assert fixes.z[1].tolist() == [3.5, 0.1, 0.0]
    assert np.diagonal(fixes.covariance[1])[:2] == pytest.approx([1 / 4, 1 / 16])
    back = written(graph_text(log.recorded, labelled(log)), "back.g2o")
    again = log_of("again", read_graph(back)).recorded
    assert again.prior.covariance == pytest.approx(log.recorded.prior.covariance)
    assert again.fixes.z == pytest.approx(fixes.z)
    assert again.fixes.covariance == pytest.approx(fixes.covariance)
    alone = log_of("alone", read_graph(written(VERTICES + EDGES + pose.splitlines()[1], "alone.g2o"))).recorded
    assert alone.prior.covariance[0, 0] == 100.0
    with pytest.raises(DataError, match="prior of 7: no pose"):
        read_graph_file(written(VERTICES + EDGES + "EDGE_PRIOR_SE2 7 0 0 0 1 0 0 1 0 1\n"))


ODOMETRY = [" ".join(map(str, edge)) for edge in CHAIN]
COVARIANCES = "".join(f"ODOMETRY {e} 0.01 0 0 0.04 0 0.0025\n" for e in ODOMETRY) + "LANDMARK 1 0 2 1 0.04 0 0.25\n"
ROOTS = "".join(f"{t} {e} 10 0 0 5 0 20\n" for t, e in zip(("Odometry", "EDGE2", "Constraint2"), ODOMETRY, strict=True))


@pytest.mark.parametrize(
    ("text", "states"), [(COVARIANCES, "covariance"), (ROOTS + "Landmark 1 0 2 1 5 0 2\n", "root")]
)
def test_text_of_gtsam_and_of_isam_is_told_apart_by_its_numbers(written, tmp_path, text, states):
    path = written(text, "text.txt")
    file = read_graph_file(path)
    assert file.noise == states
    for edge in file.edges[:3]:
        assert edge.information == pytest.approx(np.diag([100.0, 25.0, 400.0]))
    assert file.edges[3].information == pytest.approx(np.diag([25.0, 4.0]))
    assert main(["g2o", str(path), str(tmp_path / "log")]) == 0
    log = load_folder(tmp_path / "log")
    assert len(log.recorded) == 4
    assert log.label.tolist() == [0]  # poses and landmarks have ids of their own
    assert any("--noise" in n for n in log.notes)
    other = read_graph_file(path, "information").edges[0].information
    assert other == pytest.approx(np.diag([0.01, 0.04, 0.0025] if states == "covariance" else [10.0, 5.0, 20.0]))


def test_roots_with_all_entries_are_triangles(written):
    path = written("EDGE2 0 1 1 0 0 10 1 2 8 3 20\nEDGE2 1 2 1 0 0 10 1 2 8 3 20\n", "rows.graph")
    R = np.array([[10.0, 1.0, 2.0], [0.0, 8.0, 3.0], [0.0, 0.0, 20.0]])
    file = read_graph_file(path)
    assert file.edges[0].information == pytest.approx(R.T @ R)
    again = written(with_information(file, {0: file.edges[0].information}, set()), "again.graph")
    assert read_graph_file(again).edges[0].information == pytest.approx(R.T @ R)
    with pytest.raises(DataError, match="zero on its diagonal"):
        read_graph_file(written("ODOMETRY 0 1 1 0 0 10 1 2 8 3 0\n", "zero.txt"))


def test_a_toro_graph_with_gaps_in_no_order_keeps_its_ids_there_and_back(written, tmp_path, capsys):
    ids = [3, 10, 17, 40]
    lines = [f"VERTEX2 {i} {k} 0 0" for k, i in reversed(list(enumerate(ids)))]
    lines += [f"EDGE2 {ids[b]} {ids[a]} -1 0 0 90 3 80 400 1 2" for a, b, *_ in reversed(CHAIN)]
    path = written("\n".join([*lines, "EDGE2 3 40 3 0 0 9 0 9 9 0 0"]), "toro.graph")
    assert main(["g2o", str(path), str(tmp_path / "log")]) == 0
    assert load_folder(tmp_path / "log").source[POSE_IDS] == ids
    assert main(["g2o", str(tmp_path / "log"), str(tmp_path / "back.g2o")]) == 0
    back = read_graph(tmp_path / "back.g2o")
    assert list(back.file.poses) == ids
    assert back.motion.ends.tolist() == [[3, 10], [10, 17], [17, 40], [3, 40]]
    first, there = read_graph(path), np.linalg.inv(back.motion.covariance)
    assert there[3] == pytest.approx(np.diag([9.0, 9.0, 9.0]))
    assert np.linalg.inv(first.motion.covariance)[0] == pytest.approx(np.array([[90, 3, 1], [3, 80, 2], [1, 2, 400]]))
    capsys.readouterr()


def test_ranges_with_bearings_become_observations(written):
    log = log_of("polar", read_graph(written(VERTICES + EDGES + "BR 1 9 0.5 2.0 0.02 0.1\n")))
    assert log.recorded.observations.z.tolist() == [[2.0, 0.5]]
    assert np.diagonal(log.recorded.observations.R[0]) == pytest.approx([0.01, 0.0004])

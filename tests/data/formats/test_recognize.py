"""What is no log yet: the command is said that makes one of it; landmarks of bearings alone are placed or refused."""

import numpy as np
import pytest
from scipy.io import savemat

import slamref
from data import se2
from data.convert.__main__ import main as convert
from data.formats.g2o import BEARING, RANGE, Estimate, graph_text, log_of, read_graph
from data.formats.recognize import what_to_type
from eval.inspect import main
from eval.replay.settings import Setup
from eval.studies.twins import source_of, twin
from tests.data.formats.mrclam import world


def test_a_recording_is_named_in_one_line_with_the_command_that_converts_it(tmp_path, refused):
    source = world.save_folder(tmp_path / "my set", world.texts())
    savemat(tmp_path / "mine.mat", {"odom": np.zeros((3, 3)), "scan": np.zeros((3, 5))})
    (tmp_path / "lab" / "landmark").mkdir(parents=True)
    savemat(tmp_path / "lab" / "log.mat", {"log": np.zeros(1)})
    for path, *words in (
        (source, "a UTIAS MRCLAM dataset; type slamref convert mrclam", "--robot 1"),
        (tmp_path / "mine.mat", "odom, scan", "slamref convert table"),
        (tmp_path / "lab" / "log.mat", f"slamref inspect {tmp_path / 'lab'}"),
    ):
        said = refused(main, [str(path)])
        assert all(word in said for word in words)


@pytest.mark.parametrize(("name", "text", "words"), [
    ("walk.xyz", "\x00\x01", ("a file of unknown type", "slamref convert table --help")),
    ("folder", None, ("no such file", "slamref convert")),
    ("odometry.csv", "t,x,y,theta,s\n0,0,0,0,1\n1,1,0,0,2\n", ("no observations", "--observations")),
])  # fmt: skip
def test_what_cannot_be_a_log_is_answered_with_what_is_missing_and_what_to_type(name, text, words, tmp_path, refused):
    path = tmp_path / name
    if text is None:
        path.mkdir()
    else:
        path.write_text(text)
    table = text is not None and "t,x" in text
    said = refused(convert, ["table", str(path), str(tmp_path / "log")]) if table else refused(main, [str(path)])
    assert all(word in said for word in words), said


def test_a_pose_graph_without_observations_is_sent_to_the_command_that_optimizes_it(tmp_path):
    for name, tag in (("a.g2o", "EDGE_SE2"), ("b.graph", "EDGE2"), ("c.txt", "ODOMETRY")):
        (tmp_path / name).write_text(f"{tag} 0 1 1 0 0 1 0 0 1 0 1\n\n{tag} 0 1 1 0 0 1 0 0 1 0 1\n")
        said = what_to_type(tmp_path / name)
        assert f"a pose graph; slamref audit {tmp_path / name} optimizes it, slamref convert g2o" in said
    (tmp_path / "d.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 0 7 1 1 1 0 1\n")
    assert "slamref convert g2o" in what_to_type(tmp_path / "d.g2o")
    (tmp_path / "table.txt").write_text("time x y\n0 1 2\n")
    assert "slamref convert table" in what_to_type(tmp_path / "table.txt")


RADIUS, FRAMES = 8.0, 120
STEP = np.array([0.4, 0.0, 0.4 / RADIUS])
SIGMA = [0.02, 0.02, 0.005]
SIGMA_BEARING = 0.01


def circle(path, points, *, frames=FRAMES, reach=12.0, seed=0):
    """A robot on a circle that sees directions of landmarks; its true path (N, 3). Vertices of poses are the
    odometry's; of landmarks the `true` ones, all `zero`, or `none`.
    """
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-14.0, 14.0, (14, 2))
    true, reckoned, edges = [np.array([RADIUS, 0.0, 0.5 * np.pi])], [np.array([RADIUS, 0.0, 0.5 * np.pi])], []
    for k in range(frames - 1):
        true.append(se2.compose(true[-1], STEP))
        measured = STEP + rng.normal(size=3) * SIGMA
        reckoned.append(se2.compose(reckoned[-1], measured))
        x, y, a = (1.0 / s**2 for s in SIGMA)
        edges.append(f"EDGE_SE2 {k} {k + 1} {' '.join(map(repr, measured.tolist()))} {x} 0 0 {y} 0 {a}")
    for k, pose in enumerate(true):
        off = landmarks - pose[:2]
        bearing = np.arctan2(off[:, 1], off[:, 0]) - pose[2] + SIGMA_BEARING * rng.normal(size=len(off))
        for i in np.flatnonzero(np.hypot(*off.T) < reach):
            turned = float(se2.wrap_angle(bearing[i]))
            edges.append(f"EDGE_BEARING_SE2_XY {k} {1000 + i} {turned!r} {SIGMA_BEARING**-2}")
    lines = [f"VERTEX_SE2 {k} {' '.join(map(repr, p.tolist()))}" for k, p in enumerate(reckoned)]
    if points != "none":
        places = landmarks if points == "true" else np.zeros_like(landmarks)
        lines += [f"VERTEX_XY {1000 + i} {x} {y}" for i, (x, y) in enumerate(places.tolist())]
    path.write_text("\n".join([*lines, *edges, "FIX 0"]) + "\n")
    return np.array(true)


def test_ranges_of_a_graph_are_those_of_a_sensor_of_ranges_alone_and_are_written_back(tmp_path):
    circle(tmp_path / "b.g2o", "true")
    lines = [line.split() for line in (tmp_path / "b.g2o").read_text().splitlines()]
    made = [[RANGE, *w[1:3], repr(abs(float(w[3]))), "25.0"] if w[0] == BEARING else w for w in lines]
    (tmp_path / "r.g2o").write_text("\n".join(" ".join(w) for w in made))
    log = log_of("ranges", read_graph(tmp_path / "r.g2o"))
    seen = log.recorded.observations
    assert log.recorded.sensor.name == "range"
    assert seen.z[:, 0] == pytest.approx([float(w[3]) for w in made if w[0] == RANGE])
    assert seen.R[:, 0, 0] == pytest.approx(0.04)
    places = Estimate(
        np.zeros((len(log.recorded), 3)), log.granted, {int(i): np.zeros(2) for i in np.unique(log.granted)}
    )
    back = [line.split() for line in graph_text(log.recorded, places).splitlines() if line.startswith(RANGE)]
    assert [float(w[3]) for w in back] == pytest.approx(seen.z[:, 0])


@pytest.mark.parametrize("points", ["none", *(pytest.param(p, marks=pytest.mark.slow) for p in ("true", "zero"))])
def test_a_graph_of_bearings_is_solved_whatever_its_vertices(points, tmp_path):
    true = circle(tmp_path / "b.g2o", points)
    log = log_of("bearings", read_graph(tmp_path / "b.g2o"))
    runs = slamref.compare(log.inputs(labels=True), "slam", ["ekf", "isam2", "batch"])
    rmse = {}
    for run in runs:
        assert run.failure is None
        off = run.trajectory(run.phases[-1]).pose[:, :2] - true[:, :2]
        rmse[run.estimator] = float(np.sqrt((off**2).sum(axis=1).mean()))
    assert max(rmse["isam2"], rmse["batch"]) < 0.06
    assert rmse["ekf"] < 0.2
    trial = slamref.Trial(log, "slam", tuple(runs))
    assert "landmarks" not in {n.code for n in slamref.notices([trial])}
    nis = slamref.score([trial]).metrics.query("estimator == 'batch'").nis
    assert nis.item() == pytest.approx(1.0, abs=0.15)  # a bearing has one degree of freedom


def test_twins_of_bearings_draw_no_ranges(tmp_path):
    circle(tmp_path / "b.g2o", "none")
    log = log_of("bearings", read_graph(tmp_path / "b.g2o"))
    (smoother,) = slamref.compare(log.inputs(labels=True), "slam", ["batch"])
    found = twin(source_of(log, smoother, ("batch",), Setup()), 0).recorded.observations
    np.testing.assert_array_equal(found.z[:, 0], log.recorded.observations.z[:, 0])
    off = se2.wrap_angle(found.z[:, 1] - log.recorded.observations.z[:, 1])
    assert np.std(off) == pytest.approx(np.sqrt(2.0) * SIGMA_BEARING, rel=0.1)


def test_a_folder_of_tables_is_answered_with_the_command_that_takes_them(tmp_path, refused):
    for name in ("wheel_odom.csv", "gps_fix.csv", "uwb.csv", "beacons.txt", "notes.csv"):
        (tmp_path / name).write_text("a,b\n1,2\n")
    said = what_to_type(tmp_path).replace(str(tmp_path), "D")
    assert (
        "convert table D/wheel_odom.csv LOG --fixes D/gps_fix.csv --map D/beacons.txt --observations D/uwb.csv" in said
    )

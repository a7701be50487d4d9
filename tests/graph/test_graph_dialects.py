"""Dialects of graph files: sensors with an offset, priors, Toro, text whose noise gtsam and iSAM read differently."""

from __future__ import annotations

import numpy as np
import pytest

from data.convert.__main__ import main
from data.errors import DataError
from data.formats.g2o import POSE_IDS, log_of, read_graph
from data.formats.g2o_out import graph_text, labelled
from data.formats.graph_file import read_graph_file, with_information
from data.formats.open_log.reader import load_folder
from data.pose_measurements import FixKind
from data.se2 import compose, inverse
from wings.audit.files import build

CHAIN = [(0, 1, 1.0, 0.1, 0.2), (1, 2, 1.1, 0.0, 0.3), (2, 3, 0.9, -0.1, 0.1)]
POSES = "".join(f"VERTEX_SE2 {k} {k} 0.1 {0.1 * k}\n" for k in range(4))
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
    seen = compose(compose(inverse(first), compose(inverse(i), j)), second)
    z = seen + [1e-4, -2e-4, 3e-4]
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
    text = f"PARAMS_SE2OFFSET 0 {o[0]} {o[1]} {o[2]}\n{POSES}VERTEX_XY 9 4 4\n{EDGES}"
    path = written(text + "EDGE_SE2_POINTXY_OFFSET 1 9 0 2.0 1.0 25 0 4\n")
    log = log_of("points", read_graph(path))
    assert log.recorded.observations.z[0] == pytest.approx(compose(o, np.array([*z, 0.0]))[:2])
    assert np.sort(np.linalg.eigvalsh(log.recorded.observations.R[0])) == pytest.approx([0.04, 0.25])
    point, pose = np.array([4.0, 4.0, 0.0]), compose(np.array([1.0, 0.1, 0.1]), o)
    off = compose(inverse(pose), point)[:2] - z
    rest = squares(read_graph_file(written(POSES + EDGES, "rest.g2o")))
    assert squares(read_graph_file(path)) - rest == pytest.approx(off @ np.diag([25.0, 4.0]) @ off)
    with pytest.raises(DataError, match="no PARAMS_SE2OFFSET 3"):
        read_graph(written(text + "EDGE_SE2_POINTXY_OFFSET 1 9 3 2.0 1.0 25 0 4\n"))


def test_priors_are_factors_of_an_audit_and_that_of_the_first_pose_is_the_logs(written):
    pose = "EDGE_PRIOR_SE2 0 0.1 0.2 0.05 100 0 0 50 0 25\nEDGE_PRIOR_SE2 2 2 0 0.2 4 0 0 4 0 4\n"
    path = written(POSES + EDGES + pose + "EDGE_PRIOR_SE2_XY 3 3.5 0.1 4 0 16\n")
    rest = squares(read_graph_file(written(POSES + EDGES, "rest.g2o")))
    added = 100 * 0.1**2 + 50 * 0.1**2 + 25 * 0.05**2 + 4 * 0.1**2 + 4 * 0.5**2
    assert squares(read_graph_file(path)) - rest == pytest.approx(added, rel=0.02)  # errors are seen from turned frames
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
    alone = log_of("alone", read_graph(written(POSES + EDGES + pose.splitlines()[1], "alone.g2o"))).recorded
    assert alone.prior.covariance[0, 0] == 100.0
    with pytest.raises(DataError, match="prior of 7: no pose"):
        read_graph_file(written(POSES + EDGES + "EDGE_PRIOR_SE2 7 0 0 0 1 0 0 1 0 1\n"))


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
    assert back.pose[0].tolist() == ids
    assert back.motion.ends.tolist() == [[3, 10], [10, 17], [17, 40], [3, 40]]
    first, there = read_graph(path), np.linalg.inv(back.motion.covariance)
    assert there[3] == pytest.approx(np.diag([9.0, 9.0, 9.0]))
    assert np.linalg.inv(first.motion.covariance)[0] == pytest.approx(np.array([[90, 3, 1], [3, 80, 2], [1, 2, 400]]))
    capsys.readouterr()


def test_ranges_with_bearings_become_observations(written):
    log = log_of("polar", read_graph(written(POSES + EDGES + "BR 1 9 0.5 2.0 0.02 0.1\n")))
    assert log.recorded.observations.z.tolist() == [[2.0, 0.5]]
    assert np.diagonal(log.recorded.observations.R[0]) == pytest.approx([0.01, 0.0004])

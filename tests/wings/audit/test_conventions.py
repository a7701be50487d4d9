"""Conventions of g2o files in space are asked where the residuals speak for them; and the chordal start."""

import dataclasses

import gtsam
import numpy as np
import pytest

from data.formats.graph_file import read_graph_file
from tests.quick import slow
from tests.wings.audit.test_audit import grid
from wings.audit import page
from wings.audit.files import build, chordal_start

ROTATION, TRANSLATION = 0.02, 0.1


def written(tmp_path, information, *, seed=0, exact=False):
    """A walk in space with many loops; the file states `information` (6,), translation first."""
    rng = np.random.default_rng(seed)
    sigma = np.repeat([ROTATION, TRANSLATION], 3) * (not exact)
    poses = [gtsam.Pose3()]
    for _ in range(79):
        turn = gtsam.Rot3.RzRyRx(*rng.normal(0, 0.4, 3))
        poses.append(poses[-1].compose(gtsam.Pose3(turn, np.array([1.0, 0.0, 0.0]))))
    pairs = [(k, k + 1) for k in range(79)] + [tuple(sorted(rng.choice(80, 2, False).tolist())) for _ in range(90)]
    upper = np.diag(information)[np.triu_indices(6)]
    lines = []
    for a, b in pairs:
        z = poses[a].between(poses[b]).retract(rng.normal(0, 1.0, 6) * sigma)
        q = z.rotation().toQuaternion()
        numbers = [*z.translation(), q.x(), q.y(), q.z(), q.w(), *upper]
        lines.append(" ".join([f"EDGE_SE3:QUAT {a} {b}", *map(repr, map(float, numbers))]))
    path = tmp_path / "graph.g2o"
    path.write_text("\n".join(lines) + "\n")
    return path, poses


RIGHT = np.repeat([TRANSLATION**-2, ROTATION**-2], 3)


@pytest.mark.parametrize(("stated", "convention"), [
    (RIGHT, set()), (RIGHT * np.repeat([1.0, 4.0], 3), {"half-angle"}), (RIGHT[[3, 4, 5, 0, 1, 2]], {"order"}),
    (np.sqrt(RIGHT), {"root"}), slow(RIGHT * 9.0, set()),
])  # fmt: skip
def test_the_convention_that_the_residuals_speak_for_is_asked(tmp_path, stated, convention):
    path, out = written(tmp_path, stated)[0], tmp_path / "out.g2o"
    report = page.opened(str(path), None, draws=0).report
    assert {q.convention for q in report.questions} == convention
    assert report.words().count("?") == len(report.questions)
    for noise in [{"half-angle": "half-angle", "order": "rotation-first"}[c] for c in convention - {"root"}]:
        found = page.opened(str(path), None, draws=0, noise=noise)
        assert not found.report.rejected
        page.cured(found, out, draws=0)
        entries = np.array([line.split()[-21:] for line in out.read_text().splitlines()], float)
        assert entries[:, [0, 6, 11, 15, 18, 20]].mean(0) == pytest.approx(stated, rel=0.5)


def test_a_chordal_start_of_exact_relations_is_exact(tmp_path):
    path, poses = written(tmp_path, RIGHT, exact=True)
    found = chordal_start(read_graph_file(path))
    for key, pose in enumerate(poses):
        assert found[key].translation() == pytest.approx(pose.translation(), abs=1e-9)
    planar = read_graph_file(path)
    edges = [dataclasses.replace(e, tag="EDGE_SE2", measured=np.array([1.0, 0.0, 0.1]), information=np.eye(3))
             for e in planar.edges[:60]]  # fmt: skip
    found = chordal_start(dataclasses.replace(planar, edges=edges))
    pose = gtsam.Pose2()
    for k in range(61):
        assert found[k].translation() == pytest.approx(pose.translation(), abs=1e-9)
        pose = pose.compose(gtsam.Pose2(1.0, 0.0, 0.1))


def test_a_noise_that_no_line_states_is_assumed_and_never_believed(tmp_path):
    """Edges without information had the identity, and words called it stated."""
    bare = [" ".join(line.split()[:6]) for line in grid().splitlines()]
    path = tmp_path / "g.g2o"
    path.write_text("\n".join(bare))
    report = page.opened(str(path), None, 0).report
    assert report.words().startswith("No noise is stated of odometry and loop, so that a sigma of 1 is assumed; the ")
    assert "believed where" not in report.words()
    assert not report.rejected
    assert not report.even
    assert report.facts.asked[2].sigma == pytest.approx(0.02, rel=0.3)
    path.write_text("\n".join(f"{line} 1 0 0 1 0 1" * (line[0] == "E") for line in bare))
    unit = page.opened(str(path), None, 0).report
    assert not unit.facts.assumed
    assert unit.even == (1.0,)
    path.write_text(
        "".join(f"VERTEX_SE2 {k} {k} 0 0\nEDGE_SE2_XY {k} 9 {4 - k} 0\n" for k in range(4)) + "VERTEX_XY 9 4 0\n"
    )
    assert page.opened(str(path), None, 0).report.facts.assumed


def test_measured_positions_in_space_are_priors(tmp_path):
    lines = [f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1" for k in range(4)]
    unit = " ".join("1" if i == j else "0" for i in range(6) for j in range(i, 6))
    lines += [f"EDGE_SE3_SWITCHABLE {k} {k + 1} 99 1 0 0 0 0 0 1 {unit}" for k in range(3)]
    lines += [f"EDGE_SE3_PRIORXYZ {k} {k} 0.5 {k * k} 4 0 0 4 0 1" for k in range(4)]
    (tmp_path / "g.g2o").write_text("\n".join(lines) + "\n")
    report = page.opened(str(tmp_path / "g.g2o"), None, draws=0).report
    assert report.kinds.loc["position", "n"] == 4
    assert not report.unread

    assert report.audit.place[:, 1] == pytest.approx(0.5, abs=1e-5)


def test_a_graph_of_one_edge_has_nothing_to_test(tmp_path):
    poses = "VERTEX_SE2 0 0 0 0\nFIX 0\nVERTEX_SE2 1 1 2 0\nEDGE_SE2 0 1 1 0 0 10 0 0 10 0 10\n"
    (tmp_path / "g.g2o").write_text(poses + "EDGE_SE2_ROBUST 0 1 Cauchy 1.0 3 0 0 20 0 0 10 0 10\n")
    report = page.opened(str(tmp_path / "g.g2o"), None, draws=0).report
    assert ("EDGE_SE2_ROBUST" in str(report.unread), report.kinds["redundancy"].tolist()) == (True, [0.0])


def test_a_measured_pose_in_space_is_a_prior_of_the_robot_beside_a_vertex_that_is_held(tmp_path):
    """A sensor's pose beside its place on the robot, as g2o writes it; without rotation's information a position."""
    rng, upper = np.random.default_rng(0), np.triu_indices(6)
    root = rng.normal(0, 1, (6, 6)) + 4 * np.eye(6)
    full, level = (" ".join(map(str, a[upper])) for a in (root @ root.T, np.diag([4, 1, 9, 0, 0, 0])))
    lines = [f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1" for k in range(3)] + ["FIX 0"]
    lines += ["EDGE_SE3:QUAT 0 1 1 0.1 0 0 0 0 1", "EDGE_SE3:QUAT 1 2 1 0.1 0 0 0 0 1"]
    lines += ["PARAMS_SE3OFFSET 7 0.5 -0.2 0.3 0.6 0 0 0.8", f"EDGE_SE3_PRIOR 1 7 1.5 0 0.2 0 0 0 1 {full}"]
    lines += [f"EDGE_SE3_PRIOR 2 2 0.5 0 0 0 {0.5**0.5} {0.5**0.5} {level}"]
    (tmp_path / "g.g2o").write_text("\n".join(lines) + "\n")
    graph, values, names = build(file := read_graph_file(tmp_path / "g.g2o"))
    assert names[2:] == ["prior", "position", "fixed"]
    z, sensor = gtsam.Pose3(gtsam.Rot3(), [1.5, 0, 0.2]), gtsam.Pose3(gtsam.Rot3(0.8, 0.6, 0, 0), [0.5, -0.2, 0.3])
    robot = z.compose(sensor.inverse()).retract(rng.normal(0, 0.01, 6))
    values.update(1, robot)
    error = gtsam.Pose3.Logmap(z.between(robot.compose(sensor)))[[3, 4, 5, 0, 1, 2]]
    assert 2 * graph.at(2).error(values) == pytest.approx(error @ root @ root.T @ error, rel=1e-6)
    assert np.diag(file.priors[1].information) == pytest.approx([1.0, 4.0, 9.0])


@pytest.mark.parametrize("d", [2, 3])
def test_poses_that_are_seen_without_a_rotation_are_landmarks_whatever_their_numbers(tmp_path, d):
    """The step from the last pose 5 to point 6 was one of odometry, free rotations shared in the noise of points."""
    rng, n, tag = np.random.default_rng(d), d * (d + 1) // 2, "SE2" if d == 2 else "SE3:QUAT"
    turn, upper = ("0", "0 0 0 1")[d - 2], np.triu_indices(n)
    motion, seen = (np.diag([40.0] * d + [r] * (n - d))[upper].tolist() for r in (40.0, 1e-6))
    places = np.vstack([np.arange(5)[:, None] * np.eye(d)[0], rng.uniform(-5, 5, (30, d))])
    lines = [f"VERTEX_{tag} {k + 1} {' '.join(map(repr, p.tolist()))} {turn}" for k, p in enumerate(places)]
    for a, b in [(k, k + 1) for k in range(4)] + [(k, j) for k in range(5) for j in range(5, 35)]:
        z = (places[b] - places[a] + rng.normal(0, 2 / 40**0.5, d) * (b > 4)).tolist()
        lines.append(
            " ".join([f"EDGE_{tag} {a + 1} {b + 1}", *map(repr, z), turn, *map(str, seen if b > 4 else motion)])
        )
    (tmp_path / "g.g2o").write_text("\n".join(lines))
    found = page.opened(str(tmp_path / "g.g2o"), None, draws=0)
    assert found.report.kinds["n"].to_dict() == {"odometry": 4, "landmark": 150}
    assert found.report.kinds["sigma_factor"]["landmark"] == pytest.approx(2.0, rel=0.1)
    assert page.cured(found, tmp_path / "better.g2o", 0)["left_out"].tolist() == [0, 0]
    assert (tmp_path / "better.g2o").read_text().count("e-06") == 150 * (n - d)

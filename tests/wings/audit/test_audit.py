"""The command and the function `audit`: tables, words, exit status, bad files."""

import pathlib

import gtsam
import numpy as np
import pandas as pd
import pytest

import slamref
from data.errors import DataError, UsageError
from data.formats.graph_file import read_graph_file, with_information
from tests.research.audit import LOOPS, Case, spoilt, structure
from tests.wings.audit import graphs
from wings.audit import page
from wings.audit.audit import examined
from wings.audit.command import main
from wings.audit.files import build, optimized


def opened(*arguments, **how):
    return page.opened(*arguments, **how).report


COLUMNS = ["keys", "kind", "dim", "chi2", "redundancy", "unchecked", "deleted", "rank", "p", "p_family",
           "minimal_error", "influence_m"]  # fmt: skip
KINDS = ["n", "dim", "chi2", "redundancy", "component", "se", "sigma_factor"]
SHIPPED = ("pose2example.txt", "w100.graph", "w100_30.g2o", "example.graph", "pose3example-grid.txt", "Klaus3.g2o",
           "known_landmark_localization_20.g2o", "edge_se3_trackxyz_nonidentity_offset.g2o",
           "noisyToyGraph.txt", pytest.param("cityTrees_reduced_1k.g2o", marks=pytest.mark.slow))  # fmt: skip


def grid(seed=0, wrong=0.0, odometry=1.0, spatial=False):
    """Text of a g2o file: a walk over a square grid, with loops; one wrong by `wrong` sigmas in each component."""
    rng = np.random.default_rng(seed)
    sigma = np.array([0.1, 0.1, 0.02])
    true = [gtsam.Pose2()]
    for _ in range(80):
        true.append(true[-1].compose(gtsam.Pose2(1, 0, rng.choice([0, np.pi / 2, -np.pi / 2]))))
    pairs = [(k, k + 1) for k in range(80)]
    pairs += [tuple(sorted(rng.choice(81, 2, replace=False).tolist())) for _ in range(60)]
    lines = []
    for n, (a, b) in enumerate(pairs):
        e = rng.normal(0, sigma) * (odometry if n < 80 else 1.0) + wrong * sigma * (n == 100)
        z = true[a].between(true[b]).retract(e)
        lines.append(f"EDGE_SE2 {a} {b} {z.x()!r} {z.y()!r} {z.theta()!r} 100 0 0 100 0 2500")
    vertices = [f"VERTEX_SE2 {k} {p.x()!r} {p.y()!r} {p.theta()!r}" for k, p in enumerate(true)]
    return "\n".join([*vertices, *lines]) + "\n"


@pytest.fixture
def written(tmp_path):
    def write(text, name="graph.g2o"):
        (tmp_path / name).write_text(text)
        return str(tmp_path / name)

    return write


def test_columns_and_rows(written):
    report = opened(written(grid()), None, draws=20)
    assert list(report.factors.columns[:12]) == COLUMNS
    assert list(report.kinds.columns[:7]) == KINDS
    assert list(report.factors.index) == list(range(140))
    assert report.factors["keys"][3] == (3, 4)
    assert report.factors["redundancy"].sum() == pytest.approx(140 * 3 - 80 * 3, abs=1e-8)
    assert (list(report.kinds.index), report.kinds["n"].sum()) == (["odometry", "loop"], 140)
    assert report.audit.decrement < 0.01
    given = opened(written(grid()), optimize=False, draws=0)
    assert given.audit.decrement > 1.0
    assert "not the optimum" in given.words()


def test_a_clean_graph_ends_with_0_a_wrong_loop_with_1_and_its_tables(written, capsys, tmp_path):
    assert main([written(grid(seed=1)), "--draws", "0"]) == 0  # of seed 0, five loops agree by chance: p = 0.03
    assert main([written(grid(seed=1, wrong=5.0)), "--out", str(tmp_path / "out"), "--draws", "10"]) == 1
    table = pd.read_csv(tmp_path / "out" / "factors.csv")
    assert list(table.columns[:13]) == ["factor", *COLUMNS]
    assert table["p_family"].idxmin() == 100
    assert "<img" in (tmp_path / "out" / "report.html").read_text()
    out = capsys.readouterr().out
    assert "All but 1 factor of 140 agree with the stated noise" in out
    assert "Factor 100 (loop" in out
    assert main([written(grid(odometry=2.0)), "--draws", "0"]) == 1
    assert "stated sigma of odometry" in capsys.readouterr().out


def test_a_function_of_a_script(written, capsys, tmp_path):
    text = """
import gtsam
def build():
    g, v = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(3):
        v.insert(k, gtsam.Pose2(k, 0, 0))
        g.add(gtsam.PriorFactorPose2(k, gtsam.Pose2(k + 0.01, 0, 0), gtsam.noiseModel.Isotropic.Sigma(3, 0.1)))
    return g, v
def other():
    return 3
"""
    place = written(text, "mine.py")
    main([f"{place}:build", "--draws", "0"])
    opened(f"{place}:build", None, draws=0).figure()  # factors of one variable
    assert "3 parts" in capsys.readouterr().out
    with pytest.raises(UsageError, match="returned int"):
        opened(f"{place}:other", None)
    with pytest.raises(UsageError, match=r"no 'nothing' in mine\.py"):
        opened(f"{place}:nothing", None)
    with pytest.raises(UsageError, match="only a graph file"):
        page.cured(page.opened(f"{place}:build", None, draws=0), tmp_path / "x.g2o")


@pytest.mark.parametrize("name", SHIPPED)
def test_files_that_ship_with_gtsam(name):
    report = opened(gtsam.findExampleDataFile(name), None, draws=0)
    assert report.factors["redundancy"].sum() == pytest.approx(report.audit.freedom, abs=1e-6)
    assert report.words()
    report.figure()


BAD = [
    ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0", "with 10 numbers; 11 are needed"),
    ("EDGE_SE2 0 1 1 0 0 1 0 0 0 1 0 0 0 1", "11 are needed .of matrices"),
    ("EDGE_SE2 0 1 1 0 nan 1 0 0 1 0 1", "'nan' is not a number"),
    ("EDGE_SE2 0 1 1 0 0 57295,8 0 0 1 0 1", "'57295,8' is not a number; write a point: 57295.8"),
    ("EDGE_SE2 0 1.5 1 0 0 1 0 0 1 0 1", "'1.5' is not an id"),
    ("EDGE_SE2 0 99 1 0 0 1 0 0 1 0 1", "vertex 99 is missing"),
    ("EDGE_SE2 0 1 1 0 0 1 0 0 0 0 1", "not positive definite"),
    ("EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1", "not positive definite .least eigenvalue -1"),
    ("EDGE_SE2 0 1 1 0 0 500 0 500 3000 0 0", "Toro's order"),
    ("EDGE_SE2 0 1 1 0 0 1 5 0 1 0 1", "is 5, at most 1 beside its diagonal"),
    ("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1", "0 is a pose2"),
    ("VERTEX_SE2 3 0 0 0", "vertex 3 is repeated"), ("VERTEX_SE3:QUAT 300 0 0 0 0 0 0 2", "quaternion of norm 2"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "message"), BAD)
def test_a_bad_line_is_named(written, line, message, refused):
    text = grid()
    path = written(text + line + "\n")
    number = text.count("\n") + 1
    assert f"{path}:{number}: " in refused(main, [path])
    with pytest.raises(DataError, match=message):
        read_graph_file(pathlib.Path(path))


@pytest.mark.parametrize("count", [20, pytest.param(80, marks=pytest.mark.slow)])
def test_damaged_files_are_refused_in_one_line(written, count):
    rng, refused = np.random.default_rng(0), 0
    shipped = ("known_landmark_localization_20.g2o", "pose3example-grid.txt", "example.graph")
    texts = [grid(), *(pathlib.Path(gtsam.findExampleDataFile(name)).read_text() for name in shipped)]
    for k in range(count):
        text = texts[k % 4]
        at = int(rng.integers(len(text)))
        junk = str(rng.choice(["", "x", " ", "-", "\n", "nan", "9999", "e308", "\x00"]))
        damaged = text[:at] + junk + text[at + int(rng.integers(4)) :]
        try:
            opened(written(damaged), None, draws=0)
        except DataError:
            refused += 1
    assert count / 8 < refused < count


def test_written_with_other_information(written):
    file = read_graph_file(pathlib.Path(written(grid())))
    text = with_information(file, {3: np.diag([1.0, 2.0, 3.0])}, {7})
    again = read_graph_file(pathlib.Path(written(text)))
    assert len(again.edges) == 139
    assert np.allclose(again.edges[3].information, np.diag([1.0, 2.0, 3.0]))
    file = read_graph_file(pathlib.Path(gtsam.findExampleDataFile("w100.graph")))
    stated = np.array([[4, 1, 0.5], [1, 5, 0.2], [0.5, 0.2, 6]])
    again = read_graph_file(pathlib.Path(written(with_information(file, {0: stated}, set()))))
    assert np.allclose(again.edges[0].information, stated)


def gtsams_minimum(path):
    """Twice the error of gtsam's own reader and optimizer; the first pose is held where it is."""
    graph, values = gtsam.load2D(str(path))
    held = gtsam.NonlinearFactorGraph(graph)
    held.add(gtsam.PriorFactorPose2(0, values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    return 2.0 * graph.error(gtsam.LevenbergMarquardtOptimizer(held, values).optimize())


@pytest.mark.parametrize("name", ["noisyToyGraph.txt", "w100_30.g2o", "w100.graph"])
def test_pose_graphs_that_gtsam_ships_reach_the_minimum_of_gtsams_own_optimizer(name):
    path = gtsam.findExampleDataFile(name)
    graph, values, _ = build(read_graph_file(pathlib.Path(path)))
    assert 2.0 * graph.error(optimized(graph, values)) == pytest.approx(gtsams_minimum(path), rel=1e-6)


def test_text_of_isam_states_covariances_as_gtsam_reads_it(written):
    known = grid().splitlines()
    ends = [" ".join(line.split()[1:6]) for line in known if line.startswith("EDGE")]
    path = written("".join(f"ODOMETRY {e} 0.01 0 0 0.01 0 0.0004\n" for e in ends), "graph.txt")
    file = read_graph_file(pathlib.Path(path))
    graph, values, _ = build(file)
    assert 2.0 * graph.error(optimized(graph, values)) == pytest.approx(gtsams_minimum(path), rel=1e-6)
    again = written(with_information(file, {0: np.diag([4.0, 5.0, 8.0])}, set()), "again.txt")
    assert np.allclose(read_graph_file(pathlib.Path(again)).edges[0].information, np.diag([4.0, 5.0, 8.0]))


def test_edges_alone_and_two_files_without_tags_are_the_same_graph(written, tmp_path, refused):
    rows = [line.split() for line in grid().splitlines()]
    (folder := tmp_path / "two").mkdir()
    for tag, names in (("VERTEX_SE2", "id,x,y,yaw"), ("EDGE_SE2", "i,j,dx,dy,dth,xx,xy,xt,yy,yt,tt")):
        written("\n".join([names, *(",".join(row[1:]) for row in rows if row[0] == tag)]), f"two/{tag}.csv")
    (e, v), whole = sorted(map(str, folder.iterdir())), opened(written(grid()), None, draws=0).factors["deleted"]
    for place, more in ((e, ()), (v, [e]), (v, [written(grid())]), (str(folder), ())):
        own = opened(place, None, draws=0, more=more).factors["deleted"]
        assert own.to_numpy() == pytest.approx(whole.to_numpy(), rel=1e-4, abs=1e-6)
    assert main([v, e, "--draws", "0"]) == 1
    assert "name both: slamref audit A B" in refused(main, [v])
    for name, text, what in (
        (v, "0,0,0,0\n1,1,0,0", "EDGE_SE2.csv:3: EDGE_SE2: vertex 2 is missing"),
        (v, "id,theta,x,y\n0,0,0,0", "VERTEX_SE2.csv:1: columns id, theta, x, y; rows without tags are id x y theta"),
        (f"{folder}/w.g2o", "", "3 files that may hold graphs (EDGE_SE2.csv, VERTEX_SE2.csv, w.g2o); one is needed"),
    ):
        pathlib.Path(name).write_text(text)
        assert what in refused(main, [str(folder)])


def test_indeterminate_variables_and_duplicates_are_named():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    for k in range(6):
        values.insert(k, gtsam.Pose2(k, 0, 0))
        if k:
            graph.add(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(1, 0, 0), noise))
    graph.add(gtsam.BetweenFactorPose2(0, 5, gtsam.Pose2(5, 0, 0.01), noise))
    graph.add(gtsam.BetweenFactorPose2(0, 5, gtsam.Pose2(5, 0, 0.01), noise))
    landmark = gtsam.symbol("l", 7)
    values.insert(landmark, np.array([2.0, 3.0]))
    graph.add(gtsam.BearingFactor2D(2, landmark, gtsam.Rot2(1.0), gtsam.noiseModel.Isotropic.Sigma(1, 0.1)))
    report = slamref.audit(graph, values, draws=0)
    assert report.facts.gauge == 3
    assert report.facts.loose == (("l7", 1, True, False, 7),)
    assert report.facts.duplicates == ("5 and 6",)
    assert report.factors["unchecked"].tolist()[-1]


@pytest.mark.slow
def test_a_cure_is_applied(written, tmp_path, capsys):
    path = written(grid(seed=4, wrong=6.0, odometry=1.3))
    out = tmp_path / "better.g2o"
    assert main([path, "--draws", "0", "--rescale", str(out)]) == 1
    assert "chi2_per_freedom" in capsys.readouterr().out
    before, after = page.cured(page.opened(path, None, draws=0), out, draws=0).to_dict("records")
    assert after["left_out"] >= 1
    assert out.read_text().count("# left out: EDGE_SE2") == after["left_out"]
    assert before["chi2_per_freedom"] > 1.3
    assert after["chi2_per_freedom"] == pytest.approx(1.0, abs=0.02)
    assert after["rejected"] == 0
    robust = page.cured(page.opened(path, None, draws=0), out, draws=0, robust=True).to_dict("records")[1]
    assert robust["robust"] >= 1
    assert robust["left_out"] == 0
    assert robust["factors"] == 140
    kept = page.opened(str(out), None, draws=0)
    assert "left out" not in out.read_text()
    assert kept.file.edges[100].information[0, 0] < 0.3 * kept.file.edges[101].information[0, 0]


def test_sound_loops_between_the_places_of_false_ones_are_not_wrong():
    """Seen: 15 sound loops were named, too, since leaving them out explains a little more."""
    d = spoilt(structure("Intel-like", 150, 911), Case(LOOPS, 10, 20.0), np.random.default_rng([911, 77]))
    assert examined(d.graph, optimized(d.graph, d.path), draws=0).wrong.tolist() == d.false


@pytest.mark.slow
def test_a_gross_error_in_space_costs_no_sound_loop(tmp_path):
    """From the optimum that a loop of 10^6 sigma bent, two steps of odometry were left out as well."""
    rng, s = np.random.default_rng(0), structure("garage", 150, 0)
    graph, i = s.graph(rng), int(rng.choice(s.loops))
    ends = tuple(s.pairs[i])
    off = rng.normal(size=6)
    z = s.poses[ends[0]].between(s.poses[ends[1]]).retract(1e6 * s.sigma * off / np.linalg.norm(off))
    graph.replace(i, s.relation(*ends, z, np.zeros(6)))
    gtsam.writeG2o(graph, s.path(graph), str(tmp_path / "g.g2o"))
    found = page.opened(str(tmp_path / "g.g2o"), None, draws=0)
    made = page.cure(found.file, found.report.audit, found.values)
    assert [found.file.edges[k].ends for k in made.left_out] == [ends]


def test_another_minimum_is_named(written):
    """A ring whose vertices never turn: the optimizer stays there."""
    n, radius = 40, 10.0
    turns, lines = np.linspace(0, 2 * np.pi, n + 1)[:-1], []
    true = [gtsam.Pose2(radius * np.cos(a), radius * np.sin(a), a + np.pi / 2) for a in turns]
    for k in range(n):
        z = true[k].between(true[(k + 1) % n])
        lines.append(f"EDGE_SE2 {k} {(k + 1) % n} {z.x()!r} {z.y()!r} {z.theta()!r} 100 0 0 100 0 100")
    vertices = [f"VERTEX_SE2 {k} {p.x()!r} {p.y()!r} {np.pi / 2}" for k, p in enumerate(true)]
    report = opened(written("\n".join([*vertices, *lines]) + "\n"), None, draws=0)
    (other,) = report.minima
    assert other.start == "the vertices"
    assert other.ours < 1e-9 < other.error  # the lowest is examined
    assert "another minimum" in report.words()


def test_a_noise_that_is_not_definite_is_named():
    graph, values = graphs.planar(1)
    bad = gtsam.noiseModel.Gaussian.Covariance(np.array([[1.0, 2.0], [2.0, 1.0]]))
    graph.add(gtsam.PriorFactorPoint2(gtsam.symbol("l", 0), np.zeros(2), bad))
    with pytest.raises(DataError, match=f"factor {graph.size() - 1}: its noise is not positive definite"):
        slamref.audit(graph, values)


@pytest.mark.parametrize("make", [graphs.planar, graphs.spatial])
def test_a_file_that_gtsam_wrote_has_the_statistics_of_its_graph(make, tmp_path):
    source, values = make(11)
    graph = gtsam.NonlinearFactorGraph()
    for i in range(source.size()):
        factor = source.at(i)
        if type(factor).__name__.startswith("BetweenFactorPose"):
            plain = getattr(factor.noiseModel(), "noise", factor.noiseModel)
            graph.add(factor.cloneWithNewNoiseModel(plain()) if hasattr(factor.noiseModel(), "noise") else factor)
    keys = {key for i in range(graph.size()) for key in list(graph.at(i).keys())}
    poses = gtsam.Values(values)
    for key in set(values.dims()) - keys:
        poses.erase(key)
    gtsam.writeG2o(graph, poses, str(tmp_path / "g.g2o"))
    direct = slamref.audit(graph, optimized(graph, poses), draws=0)
    read = opened(str(tmp_path / "g.g2o"), None, draws=0)
    assert read.factors["redundancy"].to_numpy() == pytest.approx(direct.factors["redundancy"].to_numpy(), abs=1e-3)
    assert read.factors["chi2"].to_numpy() == pytest.approx(direct.factors["chi2"].to_numpy(), rel=0.01, abs=1e-3)


@pytest.mark.parametrize("make", [graphs.planar, graphs.spatial, graphs.inertial])
def test_every_graph_has_words_and_a_figure(make):
    graph, values = make(2)
    report = slamref.audit(graph, values, draws=20)
    assert len(report.words().split("\n")) >= 3
    assert len(report.figure().axes) >= 2
    assert len(report.worst()) == 10


def test_landmarks_of_lower_ids_than_poses_have_a_second_start(written):
    """The first pose, not the first id, ties the path along the edges to the vertices."""
    text = "VERTEX_SE2 5 0 0 0\nVERTEX_SE2 6 1 0 0\nVERTEX_XY 0 1 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n"
    text += "EDGE_SE2_XY 5 0 1 1 1 0 1\nEDGE_SE2_XY 6 0 0 1 1 0 1\n"
    assert opened(written(text), None, draws=0).minima == ()


def test_a_variable_without_information_of_its_own_is_left_out():
    """A bearing in the direction of nothing else: its landmark's front has no row left."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(0, np.zeros(2))
    values.insert(1, np.zeros(2))
    graph.add(gtsam.BetweenFactorPoint2(0, 1, np.zeros(2), gtsam.noiseModel.Isotropic.Sigma(2, 1.0)))
    assert slamref.audit(graph, values, draws=0).facts.gauge == 2


def test_stages_are_told_and_a_search_has_a_bound(tmp_path, capsys, monkeypatch):
    place, said = str(tmp_path / "g.g2o"), []
    (tmp_path / "g.g2o").write_text(grid(wrong=9.0))
    page.opened(place, None, draws=0, told=lambda stage, **numbers: said.append((stage, numbers)))
    assert [name for name, _ in said[:4]] == ["opened", "optimized", "tested", "searched"]
    assert said[0][1] == {"factors": 140, "variables": 81}
    assert said[2][1]["freedom"] == 3 * 140 - 3 * (81 - 1)  # as the page counts: without the gauge
    assert said[2][1]["rejected"] >= 1
    del said[:]
    page.opened(place, None, draws=0, steps=0, told=lambda stage, **_: said.append(stage))
    assert said == ["opened", "optimized", "tested"]
    monkeypatch.setattr("wings.audit.command.SOON", 0.0)
    assert main([place, "--draws", "0", "--steps", "3"]) == 1
    assert "step 1 of at most 3" in capsys.readouterr().err

"""Results in the formats of others, each the same path, with the landmarks and decisions beside it."""

import json
import math
import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from smfeval.align import propagate_step
from smfeval.format import Gauge, Representation, SquareHeader, TangentConvention, TangentOrder
from smfeval.io.header import write_header
from smfeval.io.triangular import pack_lower_triangular
from smfeval.io.writer import write_steps
from smfeval.se3.lie import pose_matrix
from smfeval.steps import GaussianStep

from data.errors import DataError, UsageError
from data.formats.results.path import LEFT, LOCAL, ROBOT, Manner
from data.formats.results.reading import read_path
from data.formats.results.space import projection
from data.formats.results.tables import companions
from data.result import DISCARD, NEW

TIME = np.array([1403636579.763555584, 1403636579.813555456, 1403636580.263555584])
POSE = np.array([[1.0, 2.0, 0.1], [1.5, -2.0, 3.1], [2.0, 0.5, -3.1]])


def quaternions(heading):
    return np.sin(heading / 2), np.cos(heading / 2)


def tum(folder):
    s, c = quaternions(POSE[:, 2])
    rows = ["# timestamp tx ty tz qx qy qz qw", ""]
    rows += [f"{t!r} {p[0]} {p[1]} 0.5 0 0 {a} {b}" for t, p, a, b in zip(TIME.tolist(), POSE, s, c)]
    (folder / "a.txt").write_text("\n".join(rows) + "\n")
    return "a.txt", Manner()


def euroc(folder):
    s, c = quaternions(POSE[:, 2])
    stamps = ["1403636579763555584", "1403636579813555456", "1403636580263555584"]
    rows = ["#timestamp [ns], p_RS_R_x [m], ..., q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_x"]
    rows += [f"{t},{p[0]},{p[1]},0.5,{b},0,0,{a},0.3,0,0" for t, p, a, b in zip(stamps, POSE, s, c)]
    (folder / "a.csv").write_text("\n".join(rows) + "\n")
    return "a.csv", Manner()


SAME = np.eye(3)


def kitti(folder, turned=SAME, axes=ROBOT):
    rows = []
    for x, y, h in POSE:
        R = np.array([[math.cos(h), -math.sin(h), 0.0], [math.sin(h), math.cos(h), 0.0], [0.0, 0.0, 1.0]])
        T = np.column_stack([turned.T @ R @ turned, turned.T @ [x, y, 0.5]])
        rows.append(" ".join(repr(float(v)) for v in T.ravel()))
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "times.txt").write_text("".join(f"{t!r}\n" for t in TIME.tolist()))
    return "poses.txt", Manner(times=folder / "times.txt", axes=axes)


def camera(folder):
    """The same in a camera's axes, those of the format: right, down, forward."""
    return kitti(folder, np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), None)


def ours(folder):
    rows = ["t,x,y,theta", *(f"{t!r},{p[0]},{p[1]},{p[2]}" for t, p in zip(TIME.tolist(), POSE))]
    (folder / "final.csv").write_text("\n".join(rows) + "\n")
    return "final.csv", Manner()


@pytest.mark.parametrize("write", [tum, euroc, kitti, camera, ours])
def test_every_format_is_recognized_by_its_content(write, tmp_path):
    name, manner = write(tmp_path)
    other = tmp_path / "renamed.data"  # the ending says nothing
    (tmp_path / name).rename(other)
    path = read_path(str(other), manner)
    assert path.time == pytest.approx(TIME, abs=3e-7)
    assert path.pose == pytest.approx(POSE, abs=1e-12)
    said = projection(path)
    assert said == ("" if write is ours else "projected to the plane: z 0.5 to 0.5 m ignored")


def test_columns_of_ours_come_in_any_order_a_pose_may_be_blank_and_of_one_stamp_the_last_counts(tmp_path):
    (tmp_path / "a").write_text("theta,x,t,y,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0.1,1,0,2,4,1,0,3,0,1\n,,1,,,,,,,\n")
    path = read_path(str(tmp_path / "a"))
    assert path.pose[0].tolist() == [1.0, 2.0, 0.1]
    assert path.covariance[0].tolist() == [[4.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 1.0]]
    assert np.isnan(path.pose[1]).all()
    (tmp_path / "a").write_text("t,x,y,theta\n0,1,0,0\n0,2,0,0\n1,3,0,0\n")
    path = read_path(str(tmp_path / "a"))
    assert path.pose[:, 0].tolist() == [2.0, 3.0]
    assert path.notes[0].startswith("1 poses share their stamp")


def test_nanoseconds_belong_to_whole_seconds(tmp_path):
    for seconds, read in (((3, 4, 5), [3.5, 4.25, 5.75]), ((3.1, 4.2, 5.3), [3.1, 4.2, 5.3])):
        rows = "".join(
            f"{t},{n},{t},0,0\n" for t, n in zip(seconds, (500_000_000, 250_000_000, 750_000_000), strict=True)
        )
        (tmp_path / "a.csv").write_text(f"time,header.stamp.nsecs,x,y,theta\n{rows}")
        assert read_path(str(tmp_path / "a.csv")).time.tolist() == pytest.approx(read)


T = "0 0 0 0 0 0 0 1"
FAULTS = {
    "cut": (f"{T}\n1 0 0 0 0 0\n", ":2: 6 fields; 8 are needed (the file ends here: was it cut off?)"),
    "nan": ("0 nan 0 0 0 0 0 1\n1 nan 0 0 0 0 0 1\n", ": each of 2 poses has a NaN; one without is needed; --columns"),
    "back": (f"# TUM\n1{T[1:]}\n{T}\n", ":3: stamp 0.0 is before 1.0"),
    "back, EuRoC": (
        "1403636579763555584,0,0,0,1,0,0,0\n1403636578763555584,0,0,0,1,0,0,0\n", ":2: stamp 14036365787",
    ),
    "quaternion": (f"{T}\n1 0 0 0 0 0 0 0\n", ":2: quaternion [0.0, 0.0, 0.0, 0.0] has length 0"),
    "12 other columns": (f"{T} 0 0 0 0\n", ":1: no KITTI pose (no rotation); name columns: --columns x=2"),
    "strange": ("1 2 3\n", ":1: 3 fields, '1,2,3': no known trajectory format; a CSV with"),
    "covariance": ("t,x,y,theta,c_xx\n0,1,2,3,4\n", ":1: column c_xy: no such column, but c_xx"),
    "negative": ("t,x,y,theta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0,0,0,0,1,0,0,1,0,-2\n", ":2: covariance of x, y"),
    "square": (f"#%FORMAT SQUARE/0.3\n#%REPRESENTATION gaussian_se3\n{T}\n", "the header lacks TANGENT_CONVENTION"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_is_named_with_its_line(fault, tmp_path):
    text, wanted = FAULTS[fault]
    (tmp_path / "a").write_text(text)
    with pytest.raises(DataError) as error:
        read_path(str(tmp_path / "a"))
    assert str(error.value).startswith(str(tmp_path / "a"))
    assert wanted in str(error.value)


def test_what_a_file_does_not_say_must_be_said_and_nothing_else(tmp_path):
    for make, manner, wanted in (
        (kitti, Manner(stamps="ns"), "--times FILE names them"),
        (tum, Manner(times=tmp_path / "times.txt"), "a.txt has stamps of its own"),
        (tum, Manner(frame="local"), "has no covariance"),
        (ours, Manner(cov=tmp_path / "a.txt"), r"--cov .*a TUM file"),
    ):
        name, _ = make(tmp_path)
        with pytest.raises(UsageError, match=wanted):
            read_path(str(tmp_path / name), manner)


CONVENTIONS = {LOCAL: TangentConvention.RIGHT, LEFT: TangentConvention.LEFT}


def steps(n=12, order=TangentOrder.TRANS_ROT):
    """Tilted poses with full covariances; of order rotation first, the same ones written in that order."""
    rng = np.random.default_rng(4)
    swap = [0, 1, 2, 3, 4, 5] if order is TangentOrder.TRANS_ROT else [3, 4, 5, 0, 1, 2]
    made = []
    for k in range(n):
        half = rng.normal(0.0, [0.05, 0.08, 1.0]) / 2.0
        q = np.array([*half, 1.0])
        root = 0.05 * rng.normal(size=(6, 6))
        C = (root @ root.T)[np.ix_(swap, swap)]
        made.append(GaussianStep(0.1 * k, rng.normal(0.0, 3.0, 3), q / np.linalg.norm(q), C))
    return made


def header(frame=LOCAL, order=TangentOrder.TRANS_ROT, **more):
    kind = Representation.GAUSSIAN_SE3
    common = ("SQUARE/0.3", kind, "world", "robot", Gauge.SE3, "seconds", "mine", "1")
    return SquareHeader(*common, CONVENTIONS[frame], order, "axis_angle", **more)


def square(path, made, head):
    with path.open("w") as file:
        write_header(file, head)
        write_steps(file, made, head)
    return str(path)


def wide(path, made, columns=slice(None)):
    rows = [[s.timestamp, *s.translation, *s.quat_xyzw, *pack_lower_triangular(s.covariance)] for s in made]
    np.savetxt(path, np.array(rows)[:, columns], fmt="%.17g")
    return str(path)


def test_wide_a_sidecar_and_a_header_say_the_same_and_a_sidecar_declares_its_own_frame(tmp_path):
    made, last = steps(), TangentOrder.ROT_TRANS
    wanted = read_path(square(tmp_path / "square", made, header()))
    plain = wide(tmp_path / "plain.tum", made, slice(0, 8))
    side = Path(wide(tmp_path / "side.cov", made, [0, *range(8, 29)]))
    assert wanted.frame == LOCAL
    for path in (
        read_path(wide(tmp_path / "wide.tum", made)),
        read_path(plain, Manner(cov=side)),
        read_path(square(tmp_path / "other", steps(order=last), header(order=last))),
    ):
        assert path.pose == pytest.approx(wanted.pose, abs=1e-9)
        assert path.covariance == pytest.approx(wanted.covariance, rel=1e-12, abs=1e-15)
    assert read_path(plain).covariance is None
    side.write_text("#%TANGENT_CONVENTION left_perturbation\n" + side.read_text())
    path = read_path(plain, Manner(cov=side))
    wanted = read_path(square(tmp_path / "square", made, header(LEFT)))
    assert path.frame == LEFT
    assert path.covariance == pytest.approx(wanted.covariance, rel=1e-12, abs=1e-15)


def test_turning_a_path_turns_its_covariance_as_smfeval_does(tmp_path):
    """The NEES of errors does not change if truth and estimate are moved alike, whatever the frame."""
    T = pose_matrix(np.array([3.0, -1.0, 0.0]), np.array([0.0, 0.0, np.sin(0.4), np.cos(0.4)]))
    for frame in (LOCAL, LEFT):
        made = steps()
        moved = [propagate_step(s, T, 1.0, CONVENTIONS[frame], TangentOrder.TRANS_ROT) for s in made]
        before = read_path(square(tmp_path / "a", made, header(frame))).covariance
        after = read_path(square(tmp_path / "b", moved, header(frame))).covariance
        J = np.eye(3)
        J[:2, :2] = T[:2, :2]
        assert after == pytest.approx(J @ before @ J.T, rel=1e-9, abs=1e-12)


def landmarks(folder, text):
    (folder / "landmarks.csv").write_text(text)
    return companions(folder).landmarks


turn = np.linspace(0.0, 3.0, 40)
PLANE = np.column_stack([5.0 * np.sin(turn), 5.0 - 5.0 * np.cos(turn), turn])
T = np.tile(np.eye(4), (40, 1, 1))
T[:, :2, 3], T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = PLANE[:, :2], *[f(turn) for f in
    (np.cos, lambda a: -np.sin(a), np.sin, np.cos)]  # fmt: skip
FLAT = [{"x": x, "y": y, "yaw": a} for x, y, a in PLANE.tolist()]
FIELDS = [{"t": k, "pose": {"position": {"x": p["x"], "y": p["y"]}, "yaw": p["yaw"]}} for k, p in enumerate(FLAT)]
FRAMES = {"frames": [{"file": "a.png", "transform_matrix": M} for M in T.tolist()]}
TEXTS = {
    "g.json": json.dumps(FIELDS), "h.json": "\n".join(map(json.dumps, FIELDS)), "j.json": json.dumps(FRAMES),
    "i.json": json.dumps({str(k): p for k, p in enumerate(FLAT)}), "m.txt": "\n".join(map(str, PLANE.tolist())),
    "e.log": "".join(f"{k} {k} {k + 1}\n" + "".join("\t".join(map(str, r)) + "\n" for r in M) for k, M in enumerate(T)),
    "n.log": "\n".join(f"Pose: x={p['x']}, y={p['y']}, yaw={p['yaw']}" for p in FLAT),
}  # fmt: skip
OTHERS = {name: lambda p, text=text: p.write_text(text) for name, text in TEXTS.items()} | {
    "a.npy": lambda p: np.save(p, T), "b.npy": lambda p: np.save(p, PLANE),
    "c.mat": lambda p: savemat(p, {"T": np.moveaxis(T, 0, 2)}), "d.txt": lambda p: np.savetxt(p, T.reshape(40, 16)),
    "e.csv": lambda p: np.savetxt(p, T.reshape(-1, 4), delimiter=","),
    "f.txt": lambda p: np.savetxt(p, np.column_stack([np.arange(40), T.reshape(40, 16)])),
    "k.pkl": lambda p: p.write_bytes(pickle.dumps([list(row) for row in PLANE])),
    "l.pkl": lambda p: p.write_bytes(pickle.dumps({"x": PLANE[:, 0], "y": PLANE[:, 1], "yaw": turn}, protocol=2)),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_poses_of_other_programs_files_are_one_path(name, tmp_path):
    OTHERS[name](tmp_path / name)
    path = read_path(str(tmp_path / name), Manner(axes=ROBOT) if name[0] in "acdefj" else Manner())
    assert path.pose == pytest.approx(PLANE, abs=1e-6)


def test_stamps_of_their_own_file_titles_and_camera_axes_of_numbered_poses(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savetxt("a.txt", PLANE), np.savetxt("t.txt", 7.0 + 0.5 * np.arange(40))
    assert read_path("a.txt", Manner(times=Path("t.txt"))).time == pytest.approx(7.0 + 0.5 * np.arange(40))
    rows = "\n".join(f"{k} {x} {y} {a}" for k, (x, y, a) in enumerate(PLANE))
    Path("b.txt").write_text(f"rmse = 0.0116\nstamp x y yaw\n{rows}\n")
    path = read_path("b.txt")
    assert path.pose == pytest.approx(PLANE)
    assert "line 1 is a title above the names: rmse = 0.0116" in path.notes
    down = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # a camera's axes from a robot's
    M = np.concatenate([down @ T[:, :3, :3] @ down.T, down @ T[:, :3, 3:]], axis=2)
    np.savetxt("c.txt", np.column_stack([np.arange(40), M.reshape(40, 12)]))
    assert read_path("c.txt").pose == pytest.approx(PLANE, abs=1e-9)
    assert any("its axes are a camera's" in note for note in read_path("c.txt").notes)


def test_a_truth_takes_no_column_of_the_estimate_beside_it(tmp_path):
    rows = "\n".join(f"{x},{y},{k},{x},{y}" for k, (x, y, _) in enumerate(PLANE))
    (tmp_path / "a.csv").write_text(f"x,y,z,gtx,gty\n{rows}\n")
    truth = Manner(columns={"x": "gtx", "y": "gty"}, true=True, rows=True)
    assert read_path(str(tmp_path / "a.csv"), truth).space is None


def test_of_objects_one_may_lack_what_all_others_have(tmp_path):
    rows = [{"t": k, "x": np.array([p["x"]]), "p": np.array([[p["y"]], [p["yaw"]]])} for k, p in enumerate(FLAT)]
    (tmp_path / "a.pkl").write_bytes(pickle.dumps([{"t": -1, "x": 0, "p": False}, *rows]))
    path = read_path(str(tmp_path / "a.pkl"), Manner(columns={"y": "p_1", "yaw": "p_2"}))
    assert path.pose == pytest.approx(PLANE)


class Called:
    def __reduce__(self):
        return Path.touch, (Path("called"),)


def test_no_code_of_a_pickle_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.pkl").write_bytes(pickle.dumps({"pose": SimpleNamespace(x=PLANE[:, 0], y=PLANE[:, 1]), "more": Called()}))
    assert read_path("a.pkl").pose[:, :2] == pytest.approx(PLANE[:, :2])
    assert not Path("called").exists()
    for damaged in (Path("a.pkl").read_bytes()[:-40], pickle.dumps(pd.DataFrame(PLANE))):
        Path("b.pkl").write_bytes(damaged)
        with pytest.raises(DataError, match=r"b.pkl: no plain numbers, lists and arrays: "):
            read_path("b.pkl")


def test_landmarks_have_what_their_columns_say(tmp_path):
    found = landmarks(
        tmp_path, "landmark,x,y,c_xx,c_xy,c_yy,first_frame,times_seen\n7,1.5,-2,0.04,0.01,0.09,12,3\n2,0,4,1,0,2,0,1\n"
    )
    assert found.number.tolist() == [7, 2]
    assert found.xy.tolist() == [[1.5, -2.0], [0.0, 4.0]]
    assert found.covariance.tolist() == [[[0.04, 0.01], [0.01, 0.09]], [[1.0, 0.0], [0.0, 2.0]]]
    assert found.first_frame.tolist() == [12, 0]
    assert found.times_seen.tolist() == [3, 1]


@pytest.mark.parametrize(("rows", "said"), [
    ("3,1,2,1,0,1,0,0\n4,1,2,1,2,1,0,0\n", ":3: covariance of x, y, heading has the eigenvalue -1; "),
    ("3,1,2,1,0,1,0,0\n3,1,2,1,0,1,0,0\n", ":3: column landmark: 3 is repeated"),
    ("-1,1,2,1,0,1,0,0\n", ":2: column landmark: -1 is not a whole number from 0 up"),
    ("3,1,2,1,0,1,0,0.5\n", ":2: column times_seen: 0.5 is not a whole number from -1 up"),
], ids=["covariance", "twice", "negative", "times seen"])  # fmt: skip
def test_a_landmark_that_makes_no_sense_is_named_with_its_line(tmp_path, rows, said):
    with pytest.raises(DataError) as error:
        landmarks(tmp_path, f"landmark,x,y,c_xx,c_xy,c_yy,first_frame,times_seen\n{rows}")
    assert str(error.value).startswith(f"{tmp_path / 'landmarks.csv'}{said}")


def test_a_final_decision_is_the_first_one_where_there_is_no_other(tmp_path):
    file = tmp_path / "decisions.csv"
    file.write_text("decision,observation,frame\n4,0,2\n-1,1,2\n-2,0,3\n")
    found = companions(tmp_path)
    assert found.decisions.tolist() == [[2, 0, 4, 4], [2, 1, NEW, NEW], [3, 0, DISCARD, DISCARD]]
    assert (found.file, found.landmarks) == (file, None)
    file.write_text("frame,observation,decision,final_decision\n2,0,4,-2\n2,1,-1,5\n")
    assert companions(tmp_path).decisions.tolist() == [[2, 0, 4, DISCARD], [2, 1, NEW, 5]]
    file.write_text("frame,observation,decision\n2,0,-3\n")
    with pytest.raises(DataError, match=r":2: column decision: -3 is not a whole number from -2 up"):
        companions(tmp_path)

"""`slamref score` on small files of kinds that once gave a plausible wrong number: the right number, or a question."""

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data.se2 import compose
from eval.score import main as score
from tests.mistakes import world

PLACES = [(0.0, 0.0), (2.0, 0.0), (4.0, 0.0), (4.0, 2.0), (4.0, 3.0)]
CURVE = [(0.5 * k, 2.0 * math.sin(0.3 * k)) for k in range(40)]
DEG = math.pi / 180.0


@pytest.fixture
def scored(tmp_path, capsys, refused):
    """`scored(estimate, truth, *flags)`: names and values, what is asked, and what is noted, of two texts or files."""

    def run(estimate, truth, *flags, status=0):
        files = []
        for name, text in (("mine.txt", estimate), ("true.txt", truth)):
            if isinstance(text, str):
                (tmp_path / name).write_text(text)
                files.append(str(tmp_path / name))
            else:
                files.append(str(text[0]))
        given = [*files, *(str(f).replace("DIR", str(tmp_path)) for f in flags)]
        if status:
            return refused(score, given)
        assert score(given) == 0
        out, err = capsys.readouterr()
        values = {k: float(v) for k, v in re.findall(r"^(\w+) (-?[\d.e+-]+|nan)$", out, re.M)}
        return values, [line for line in err.splitlines() if line.startswith("note: question: ")], out + err

    return run


def lines(rows, header=""):
    body = "\n".join(" ".join(repr(float(v)) for v in row) for row in rows)
    return f"{header}\n{body}\n" if header else f"{body}\n"


def commas(rows, header):
    return header + "\n" + "\n".join(",".join(str(v) for v in row) for row in rows) + "\n"


def tum(places, yaw=0.0, z=0.0, step=1.0, start=0.0):
    return lines(
        (start + step * k, x, y, z, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)) for k, (x, y) in enumerate(places)
    )


NAMES = {
    "TUM, w first": ("# timestamp tx ty tz qw qx qy qz", " ", "txyzWXYZ"),
    "no comment": ("time,pos_x,pos_y,pos_z,quat_w,quat_x,quat_y,quat_z", ",", "txyzWXYZ"),
    "units": ("t [s], x [mm], y [mm], yaw [deg]", ",", "tmnd"),
    "suffixes": ("time_s,x_mm,y_mm,heading_deg", ",", "tmnd"),
    "rostopic": (
        "%time,field.header.stamp,field.header.frame_id,field.pose.pose.position.x,field.pose.pose.position.y,"
        "field.pose.pose.position.z,field.pose.pose.orientation.x,field.pose.pose.orientation.y,"
        "field.pose.pose.orientation.z,field.pose.pose.orientation.w",
        ",",
        "wNfxyzXYZW",
    ),
    "OpenVINS state": ("# timestamp(s) q p v bg ba", " ", "tXYZWxyz000000000"),
    "roll pitch yaw": ("t,x,y,z,roll,pitch,yaw", ",", "txyz00r"),
    "swapped": ("# t y x z qx qy qz qw", " ", "tyxzXYZW"),
}


@pytest.mark.parametrize("kind", NAMES)
def test_names_of_columns_decide_their_order_and_units(kind, scored):
    header, separator, order = NAMES[kind]
    a = 10.0 * DEG
    rows = []
    for k, (x, y) in enumerate(CURVE):
        of = {"t": k, "x": x, "y": y, "z": 0, "X": 0, "Y": 0, "Z": math.sin(a / 2), "W": math.cos(a / 2), "0": 0}
        of |= {"m": 1e3 * x, "n": 1e3 * y, "d": 10.0, "r": a, "f": "map"}
        of |= {"N": (1_700_000_000 + k) * 10**9, "w": (1_700_000_500 + k) * 10**9}
        rows.append(separator.join(str(of[c]) for c in order))
    start = 1_700_000_000.0 if kind == "rostopic" else 0.0
    values, asked, _ = scored(header + "\n" + "\n".join(rows) + "\n", tum(CURVE, start=start))
    assert values["rmse_position_m"] == pytest.approx(0.0, abs=1e-6)
    assert values["rmse_heading_deg"] == pytest.approx(10.0, abs=1e-5)
    assert values["matched"] == len(CURVE)
    assert not asked


@pytest.mark.parametrize(("header", "wanted"), [
    ("#timestamp,x,y,q0,q1,q2,q3", "no orientation"),
    ("#timestamp,x,y,qx,qy,qz,w_rate", "no column qw"),
    ("timestamp,x,z,qx,qy,qz,qw", "no column y"),
    ("timestamp,x,y,x,yaw,a,b", "both name x"),
    ("t [s],x [rod],y [rod],yaw [rad],a,b,c", "unit 'rod' of x"),
    ("t [s],x,y,yaw [gon],a,b,c", "unit 'gon' of yaw"),
    ("t [min],x,y,yaw,a,b,c", "unit 'min' of t"),
])  # fmt: skip
def test_a_header_that_is_not_understood_is_refused(header, wanted, scored):
    row = [0, 1, 2, 0, 0, 0, 1]
    assert wanted in scored(commas([row, [1, *row[1:]]], header), tum(PLACES), status=2)


def test_units_of_stamps_that_disagree_are_refused_and_a_flag_mends_them(scored):
    # A tolerance of a microsecond is one: stamps 40 ms apart do not match.
    header = "#timestamp,x,y,z,qx,qy,qz,qw"
    estimate = commas([(1403636579.04 + k, x, y, 0, 0, 0, 0, 1) for k, (x, y) in enumerate(CURVE)], header)
    truth = commas([(1403636579.0 + k, x, y, 0, 0, 0, 0, 1) for k, (x, y) in enumerate(CURVE)], header)
    error = scored(estimate, truth, "--truth-gap", "0.5", status=2)
    assert re.search("none of its 40 stamps.* poses up to 1 s apart; --truth-gap 1 interpolates", error)
    fast = [(0.5 * k / 10, 0.1 * k) for k in range(2000)]
    estimate = tum(fast)  # 1 kHz in ms, which may be 1 Hz in s
    truth = tum(fast[::2], step=0.002)
    assert "ms in one of the two" in scored(estimate, truth, status=2)
    values, asked, _ = scored(estimate, truth, "--unit", "estimate=ms", "--unit", "truth=s")
    assert values["rmse_position_m"] == pytest.approx(0.0, abs=1e-9)
    assert not asked
    header = "#timestamp [ns],x,y,z,qx,qy,qz,qw"
    text = commas([(1403636579.0 + k, x, y, 0, 0, 0, 0, 1) for k, (x, y) in enumerate(CURVE)], header)
    assert "--unit s" in scored(text, tum(CURVE, start=1403636579.0), status=2)
    values, _, _ = scored(text, tum(CURVE, start=1403636579.0), "--unit", "estimate=s")
    assert values["matched"] == len(CURVE)
    values, asked, said = scored(tum(CURVE, step=60.0), tum(CURVE, step=60.0))
    assert values["matched"] == len(CURVE)
    assert not asked
    sparse, dense = tum(CURVE[::10], step=10.0), tum(CURVE)
    values, asked, said = scored(sparse, dense)
    assert values["matched"] == 4
    assert values["rmse_position_m"] == pytest.approx(0.0, abs=1e-9)
    assert "stamps in s" in said


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("start", [0.0, 950_000.0, 1_700_000_000.0])  # eleven days since a start: us since 2000?
def test_units_of_stamps_are_inferred_and_said(unit, scale, start, scored):
    rows = [(round((start + 0.1 * k) * scale), x, y, 0, 0, 0, 0, 1) for k, (x, y) in enumerate(CURVE)]
    text = "\n".join(" ".join(map(str, row)) for row in rows) + "\n"
    values, asked, said = scored(text, tum(CURVE, step=0.1, start=start))
    assert values["matched"] == len(CURVE)
    assert values["rmse_position_m"] == pytest.approx(0.0, abs=1e-6)
    assert f"stamps in {unit} by their {'size' if start > 1e9 else 'rate'}" in said
    assert not asked


def kitti(places, height=0.0):
    return lines((1, 0, 0, x, 0, 1, 0, height, 0, 0, 1, z) for x, z in places)


def test_kitti_is_in_a_cameras_axes_and_of_the_same_length(scored, tmp_path):
    (tmp_path / "times.txt").write_text("".join(f"{k}\n" for k in range(5)))
    estimate = kitti([(x, z + 5.0) for x, z in PLACES])
    values, asked, said = scored(estimate, kitti(PLACES), "--times", "DIR/times.txt")
    assert values["rmse_position_m"] == pytest.approx(5.0)
    assert ("a camera's axes" in said, asked) == (True, [])
    assert "of numbers of rows" in scored(tum(PLACES, start=7), tum(PLACES), "--times", "estimate=DIR/times.txt")[2]
    error = scored(kitti(PLACES[:-1]), kitti(PLACES), status=2)
    assert re.search("4 poses without stamps, and 5 of .* --times estimate=FILE", error)


@pytest.mark.parametrize("stamped", ["neither", "truth", "estimate"])
def test_kitti_without_stamps_is_matched_row_by_row(stamped, scored):
    height = [(x, z + 1.0) for x, z in PLACES]
    of_robot = [(z, -x) for x, z in PLACES]
    estimate = tum([(z, -x) for x, z in height]) if stamped == "estimate" else kitti(height)
    values, asked, said = scored(estimate, tum(of_robot) if stamped == "truth" else kitti(PLACES))
    assert (values["rmse_position_m"], values["matched"], asked) == (pytest.approx(1.0), len(PLACES), [])
    assert "without stamps" in said or stamped == "truth"


def upright(places):
    """The same path in the plane of x and z, turned by a quarter about x."""
    h = math.sqrt(0.5)
    return lines((k, x, 0.0, y, h, 0.0, 0.0, h) for k, (x, y) in enumerate(places))


@pytest.mark.parametrize("places", [PLACES, [(2.0 * k, 0.0) for k in range(5)]], ids=["curve", "line"])
def test_two_files_in_two_planes_are_aligned_in_space(places, scored):
    estimate = upright(places)
    values, asked, _ = scored(estimate, tum(places))
    assert values["rmse_aligned_m"] == pytest.approx(0.0, abs=1e-6)
    assert values["rmse_position_3d_se3_m"] == pytest.approx(0.0, abs=1e-6)
    assert any("90 deg" in a for a in asked)
    if places is PLACES:  # on a line w-first quaternions explain it as well
        assert any("worlds' axes" in a for a in asked)
    for how in ("se2", "se3", "sim3", "first"):
        values, asked, _ = scored(estimate, tum(places), "--align", how)
        assert values["rmse_position_m"] == pytest.approx(0.0, abs=1e-6)
        assert values["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-4)
        assert not [a for a in asked if "verticals" in a]


def test_degrees_in_both_files_are_inferred_and_many_turns_in_rad_are_none(scored):
    way = [(math.cos(0.05 * k), math.sin(0.05 * k)) for k in range(100)]
    h = [math.degrees(0.05 * k) + 90.0 for k in range(100)]
    values, asked, said = scored(headed(h, way), headed([a + 1 for a in h], way))
    assert values["rmse_heading_deg"] == pytest.approx(1.0)
    assert ("inferred: headings are in degrees" in said, asked) == (True, [])
    h = [0.05 * k * 10 for k in range(100)]
    way = [(math.cos(v), math.sin(v)) for v in h]
    assert not scored(headed(h, way), headed(h, way))[1]


def headed(headings, places=CURVE, more=""):
    return commas([(k, x, y, h) for k, ((x, y), h) in enumerate(zip(places, headings))], "t,x,y,theta" + more)


ROBOT = lines((1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, 0) for x, y in PLACES)
AHEAD = [(x, 0.02 * k**2) for k, (x, _) in enumerate(CURVE)]
ASKED = {
    "an estimate in mm": (tum([(1000 * x, 1000 * y) for x, y in CURVE]), tum(CURVE)),
    "an estimate in cm": (tum([(100 * x, 100 * y) for x, y in CURVE]), tum(CURVE)),
    "a truth in mm": (tum(CURVE), tum([(1000 * x, 1000 * y) for x, y in CURVE])),
    "an estimate in feet": (tum([(x / 0.3048, y / 0.3048) for x, y in CURVE]), tum(CURVE)),
    "an estimate in degrees": (headed(np.degrees(np.linspace(0, 3, 40))), headed(np.linspace(0, 3, 40))),
    "a truth in degrees": (headed(np.linspace(0, 3, 40)), headed(np.degrees(np.linspace(0, 3, 40)))),
    "both in a robot's axes": (ROBOT, ROBOT),
    "a camera's axes": (lines((k, -y, 0, x, 0, 0, 0, 1) for k, (x, y) in enumerate(AHEAD)), tum(AHEAD)),
}


@pytest.mark.parametrize("fault", ASKED)
def test_the_flags_that_are_asked_for_end_the_questions_as_typed(fault, scored):
    values, asked, _ = scored(*ASKED[fault])
    assert asked
    flags = [word for text in asked for word in re.findall(r"`(--.*?)`", text)[0].split()]
    better, again, _ = scored(*ASKED[fault], *flags)
    assert not again
    assert better["rmse_position_m"] <= values["rmse_position_m"]


def test_covariances_of_the_truth_alone_are_a_question_and_a_truth_that_tips_over_is_none_of_axes(scored):
    full = lines((*map(float, row.split()), *np.eye(6)[np.tril_indices(6)]) for row in tum(CURVE).splitlines())
    _, (asked,), _ = scored(tum(CURVE), full)
    assert "swapped" in asked
    values, asked, _ = scored(full, tum(CURVE))
    assert (values["nees_pose"], asked) == (0.0, [])
    tips = [(math.sin(0.1 * k) * math.sqrt(0.5), math.cos(0.1 * k)) for k in range(len(CURVE))]
    truth = lines((k, x, y, 0, s, s, 0, c) for k, ((x, y), (s, c)) in enumerate(zip(CURVE, tips)))
    assert "no turn of axes explains" in scored(tum(CURVE), truth)[2]
    t = 0.05 * np.arange(len(WAY))
    q = Rotation.from_euler("ZYX", np.column_stack([WAY[:, 3], 0.9 * np.sin(t), 0.72 * np.cos(0.7 * t)])).as_quat()
    mine, *true = (lines(np.column_stack([WAY[:, :3], 0 * t, q[:, [*map(int, k)]]])) for k in ("0123", "0132", "1032"))
    assert [len(scored(mine, one)[1]) for one in true] == [0, 1]  # headings alone fit the last
    aside = [(k % 3, 0) for k in range(20)]
    line = [lines((k, 2 * k, *yz[::way], 0, 0, 0, 1) for k, yz in enumerate(aside)) for way in (1, -1)]
    assert not [text for text in scored(*line, "--align", "se3")[1] if "verticals" in text]  # which is turned about


@pytest.mark.parametrize("planar", [False, True])
def test_a_mirrored_path_is_asked_about_and_not_turned_over(planar, scored):
    """In space a flat path fits its mirror image when it is turned upside down."""
    turned = [(x, -y) for x, y in CURVE]
    files = [headed(np.zeros(40), turned), headed(np.zeros(40))] if planar else [tum(turned), tum(CURVE)]
    values, (asked,), _ = scored(*files)
    assert values["rmse_aligned_m"] > 1.0
    assert "mirror image" in asked


SIGMA = np.diag([0.1, 0.2, 0.3, 0.001, 0.002, 0.003])
SWAP = [3, 4, 5, 0, 1, 2]


def drawn(seed=1):
    """Poses with errors of these deviations in the world's axes, and the truth."""
    rng = np.random.default_rng(seed)
    rows, truth = [], []
    for k, (x, y) in enumerate(CURVE):
        e = SIGMA @ rng.normal(size=6)
        rows.append((k, x + e[0], y + e[1], e[2], 0.0, 0.0, math.sin(e[5] / 2), math.cos(e[5] / 2)))
        truth.append((k, x, y, 0.0, 0.0, 0.0, 0.0, 1.0))
    return rows, truth


def wide(rows, C):
    return [(*row, *C[np.tril_indices(6)]) for row in rows]


def test_the_order_of_a_tangent_is_obeyed_wherever_it_stands_or_asked_for(scored):
    rows, truth = drawn()
    C = SIGMA**2
    right, _, _ = scored(lines(wide(rows, C)), lines(truth))
    other = lines(wide(rows, C[np.ix_(SWAP, SWAP)]))
    for text, flags in (
        ("#%TANGENT_ORDER rotation_translation\n" + other, ()),
        (other + "#%TANGENT_ORDER rotation_translation\n", ()),
        (other, ("--cov-order", "rotation-first")),
    ):
        values, asked, _ = scored(text, lines(truth), *flags)
        assert values["nees_pose"] == pytest.approx(right["nees_pose"])
        assert not asked
    assert 2.0 < right["nees_pose"] < 4.0
    values, (asked,), _ = scored(other, lines(truth))
    assert values["nees_pose"] > 100.0
    assert "--cov-order" in asked


def test_the_frame_of_covariances_is_said_and_asked_for_where_another_fits(scored):
    """Certain along the world's x, on a way that turns: in the body's axes it would be certain along the way."""
    rng = np.random.default_rng(2)
    rows, truth = [], []
    for k in range(60):
        a = 0.1 * k
        x, y, h = 10.0 * math.sin(a), 10.0 * math.cos(a), -a
        q = (0.0, 0.0, math.sin(h / 2), math.cos(h / 2))
        truth.append((k, x, y, 0.0, *q))
        rows.append((k, x + rng.normal(0.0, 0.01), y + rng.normal(0.0, 0.5), 0.0, *q))
    C = np.diag([0.01, 0.5, 0.1, 0.1, 0.1, 0.1]) ** 2
    values, asked, said = scored(lines(wide(rows, C)), lines(truth))
    assert values["nees_pose"] > 100.0
    assert "covariances are read as local ones" in said
    assert any("--cov-frame world" in a for a in asked)
    values, asked, _ = scored(lines(wide(rows, C)), lines(truth), "--cov-frame", "world")
    assert 1.0 < values["nees_position"] < 3.0
    assert not asked


def test_rows_with_nan_are_left_out_counted_and_said(scored):
    rows = [list(map(float, row.split())) for row in tum(CURVE).splitlines()]
    rows[3][1] = rows[7][5] = math.nan
    for files in ((lines(rows), tum(CURVE)), (tum(CURVE), lines(rows))):
        values, _, said = scored(*files)
        assert values["matched"] == len(CURVE) - 2
        assert "2 of 40 poses have a NaN and are left out" in said


@pytest.mark.parametrize("unknown", [math.nan, 0.0, -1.0])
def test_a_covariance_of_nan_zeros_or_minus_one_is_unknown(unknown, scored):
    rows, truth = drawn()
    full = wide(rows, SIGMA**2)
    full[4] = (*full[4][:8], unknown, *([0.0 if unknown == -1.0 else unknown] * 20))
    values, _, said = scored(lines(full), lines(truth))
    assert values["matched"] == len(CURVE)
    assert 2.0 < values["nees_pose"] < 4.0
    assert "1 of 40 poses state no covariance" in said


@pytest.mark.parametrize("unknown", [math.nan, -1.0, 1e6, 99999.0])
def test_an_axis_of_unknown_variance_leaves_the_others_scored(unknown, scored):
    rows, truth = drawn()
    C = SIGMA**2
    right, _, _ = scored(lines(wide(rows, C)), lines(truth), "--cov-frame", "world")
    C = C.copy()
    C[5, 5] = unknown
    values, asked, said = scored(lines(wide(rows, C)), lines(truth), "--cov-frame", "world")
    assert values["nees_position"] == pytest.approx(right["nees_position"])
    assert "nees_pose" not in values
    assert "nees_3d_rotation" not in values
    assert "an axis of unknown variance" in said
    assert not asked
    planar = f"t,x,y,theta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0,1,1,0,1,0,0,1,0,{unknown}\n1,1,1,0,1,0,0,1,0,{unknown}\n"
    values, _, _ = scored(planar, "t,x,y,theta\n0,0,0,0\n1,0,0,0\n")
    assert values["nees_position"] == pytest.approx(2.0)
    assert "nees_heading" not in values


def test_names_of_planar_covariances_and_split_stamps_are_understood(scored):
    names = "t,x,y,yaw,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yaw_y,cov_yaw_yaw"
    rows = [(k, x + 0.1, y, 0.2, 0.01, 0, 0, 0.04, 0, 0.04) for k, (x, y) in enumerate(CURVE)]
    values, _, _ = scored(commas(rows, names), tum(CURVE))
    assert (values["nees_position"], values["nees_heading"]) == pytest.approx((1.0, 1.0))
    for numbered in ("P00,P01,P02,P11,P12,P22", "P_1,c,b,P_2,a,P_3", "P_0_0,a,b,P_1_1,c,P_5_5"):
        values, _, said = scored(commas(rows, f"t,x,y,yaw,{numbered}"), tum(CURVE))
        assert values["nees_position"] == pytest.approx(1.0)
        assert ("nees_heading" in values, "inferred: its covariance" in said) == ("5" not in numbered, True)
    names = "t,ekf_x,ekf_y,ekf_yaw,ekf_std_x [cm],ekf_sigma_y,ekf_std_yaw_deg"
    rows = [(k, x + 0.1, y, 0.2, 10.0, 0.2, math.degrees(0.2)) for k, (x, y) in enumerate(CURVE)]
    for header, right in ((names, {"nees_position": 1.0, "nees_heading": 1.0}), (names.replace("ekf_s", "gps_s"), {})):
        values, _, said = scored(commas(rows, header), tum(CURVE))
        assert {q: v for q, v in values.items() if q in ("nees_position", "nees_heading")} == pytest.approx(right)
        assert ("without correlation" in said, "no covariance is read of" in said) == (bool(right), not right)
    rows = [(k // 4, 250_000_000 * (k % 4), x, y, 0.0) for k, (x, y) in enumerate(CURVE)]
    values, _, _ = scored(commas(rows, "sec,nanosec,x,y,yaw"), tum(CURVE, step=0.25))
    assert (values["matched"], values["rmse_position_m"]) == (len(CURVE), pytest.approx(0.0, abs=1e-9))


def square(rows, C):
    return lines((*row, *np.asarray(C).ravel()) for row in rows)


def test_one_triangle_of_a_covariance_is_mirrored_and_said(scored):
    root = np.random.default_rng(0).normal(size=(6, 6)) * 0.1
    C = root @ root.T
    rows, truth = drawn()
    right, _, _ = scored(square(rows, C), lines(truth))
    for half in (np.triu(C), np.tril(C)):
        values, _, said = scored(square(rows, half), lines(truth))
        assert values["nees_pose"] == pytest.approx(right["nees_pose"])
        assert values["nees_3d_decoupled"] == pytest.approx(right["nees_3d_decoupled"])
        assert "which is mirrored" in said
    bent = C.copy()
    bent[0, 1] += 0.3 * C[0, 0]
    assert "covariance is not symmetric: entries (1, 2)" in scored(square(rows, bent), lines(truth), status=2)


def test_openvins_states_blocks_of_rotation_and_position(scored):
    rows, truth = drawn()
    P = SIGMA**2
    upper = np.triu_indices(3)
    text = lines((*row, *P[3:, 3:][upper], *P[:3, :3][upper]) for row in rows)
    plain, asked, said = scored(text, lines(truth))
    assert not asked
    assert "OpenVINS" in said
    right, _, _ = scored(lines(wide(rows, P)), lines(truth), "--cov-frame", "world")
    names = "Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 Pt11 Pt12 Pt13 Pt22 Pt23 Pt33"
    named, _, _ = scored(f"# timestamp(s) tx ty tz qx qy qz qw {names}\n{text}", lines(truth))
    for values in (plain, named):
        for name in ("nees_pose", "nees_3d_position", "nees_3d_rotation", "nees_3d_decoupled"):
            assert values[name] == pytest.approx(right[name], rel=1e-4)


WAY = world(0).truth[::2]
AWAY = np.array([3.0, 4.0, 68.0 * DEG])


def posed(rows):
    return commas(rows, "t,x,y,theta")


OTHERWISE = {
    "an offset of 0.3 s": (WAY + [0.3, 0, 0, 0], "--time-offset estimate=-0.3"),
    "an offset of -2 s": (WAY - [2.0, 0, 0, 0], "--time-offset estimate=2"),
    "another frame": (np.column_stack([WAY[:, 0], compose(AWAY, WAY[:, 1:])]), "--align se2"),
    "headings clockwise": (WAY * [1, 1, 1, -1], "Negate them"),
    "a compass": (WAY * [1, 1, 1, -1] + [0, 0, 0, 0.5 * math.pi], "90 deg minus them"),
    "another axis": (WAY + [0, 0, 0, 0.5 * math.pi], "turned by -90 deg"),
    "another scale": (WAY * [1, 1.4, 1.4, 1], "--align sim3"),
    "an eighth": (WAY * [1, 1.125, 1.125, 1], "--align sim3"),
    "an antenna": (
        WAY + 0.5 * np.stack([0 * WAY[:, 3], np.cos(WAY[:, 3]), np.sin(WAY[:, 3]), 0 * WAY[:, 3]], 1),
        "0.5",
    ),
    "feet": (WAY / [1, 0.3048, 0.3048, 1], "--unit estimate=ft"),
    "nothing": (WAY, None),
}
ALONE = ("an offset of 0.3 s", "an offset of -2 s", "another frame", "another scale", "nothing")


@pytest.mark.parametrize(("kind", "columns"), [*((k, 4) for k in OTHERWISE), *((k, 3) for k in ALONE)])
def test_what_one_file_has_otherwise_is_said_with_its_flag_which_mends_it(kind, columns, scored):
    """With headings, and of positions alone."""
    noise = np.random.default_rng(0).normal(0.0, [0.0, 0.01, 0.01, 0.005], WAY.shape)
    estimate, flag = OTHERWISE[kind]
    files = commas((estimate + noise)[:, :columns], "t,x,y,theta"[: 2 * columns - 1 + 4 * (columns == 4)]), posed(WAY)
    _, asked, _ = scored(*files)
    assert len(asked) == (flag is not None)
    assert flag is None or flag in asked[0]
    if flag is not None and flag.startswith("--"):
        values, asked, _ = scored(*files, *flag.split())
        assert values["rmse_position_m"] < 0.03
        assert not asked


def test_places_tell_a_clock_where_speeds_repeat_and_that_only_headings_are_wrong(scored):
    """Seen: an offset of laps that drift was that of another lap; headings on straight ways, a mirror."""
    t, rng = np.arange(0.0, 100.0, 0.5), np.random.default_rng(0)
    laps = np.exp(2j * np.pi * t / 12.5)
    drift = np.column_stack([t, 2.0 * laps.real + 0.1 * t, 2.0 * laps.imag, np.angle(0.1 + 0.32j * np.pi * laps)])
    late = drift + rng.normal(0.0, [0.0, 0.03, 0.03, 0.02], drift.shape)
    _, (asked,), _ = scored(posed(late + [0.4, 0, 0, 0]), posed(drift))
    assert float(re.search(r"--time-offset estimate=(-[\d.]+)", asked)[1]) == pytest.approx(-0.4, abs=0.05)
    legs = 0.5 * np.pi * (np.arange(44) // 11)
    way = np.cumsum(np.exp(1j * legs))
    square = np.column_stack([np.arange(44.0), way.real, way.imag, legs])
    rough = square + rng.normal(0.0, [0.0, 0.03, 0.03, 0.02], square.shape)
    for theirs, words in ((-legs, "Negate them"), (0.5 * np.pi - legs, "90 deg minus them")):
        _, (asked,), _ = scored(posed(np.column_stack([rough[:, :3], theirs + rough[:, 3] - legs])), posed(square))
        assert "headings of" in asked
        assert words in asked


@pytest.mark.parametrize(("count", "columns", "every"), [(3, 4, 1), (60, 4, 1), (8, 3, 1), (8, 4, 10)])
def test_true_poses_that_leap_away_and_back_are_named_with_the_flag_that_leaves_them_out(count, columns, every, scored):
    """Each elsewhere; beside headings and of positions alone, and an estimate at a tenth of the truth's rate."""
    noise = np.random.default_rng(0).normal(0.0, [0.0, 0.01, 0.01, 0.005], WAY.shape)
    bad = WAY.copy()
    bad[300 : 300 + count, 1:3] += 2.0 * np.column_stack([f(2.0 * np.arange(count)) for f in (np.cos, np.sin)])
    truth = commas(bad[:, :columns], "t,x,y,theta"[: 2 * columns - 1 + 4 * (columns == 4)])
    estimate = posed((WAY + noise)[::every])
    _, (asked,), _ = scored(estimate, truth)
    assert f"poses 300 to {299 + count} of" in asked
    values, asked, _ = scored(estimate, truth, *re.search(r"--exclude-truth [\d.:]+", asked)[0].split())
    assert values["rmse_position_m"] < 0.03
    assert not asked
    _, asked, said = scored(truth, estimate)
    assert not asked  # an estimate may leap
    assert f"poses 300 to {299 + count} of" in said


def test_it_is_said_how_much_of_the_truth_is_covered_and_of_the_estimate_in_gaps_of_the_truth(scored):
    part = np.delete(WAY, np.s_[100:200], axis=0)
    for *files, lacking in ((part, WAY, ["mine"]), (WAY, part, ["true"]), (WAY, WAY, [])):
        assert re.findall(r"(\w+).txt covers .*: it has 1 gap ", scored(*map(posed, files))[2]) == lacking


def test_it_is_said_where_a_track_is_lost_and_not_of_drift(scored):
    noisy, k = WAY + np.random.default_rng(0).normal(0.0, [0.0, 0.01, 0.01, 0.005], WAY.shape), np.arange(len(WAY))
    lost = 2.0 * (k >= 400) + 0.1 * np.maximum(k - 400, 0)
    for off, pose in ((lost, ["400"]), (0.01 * k, []), (2.0 * (k > 598), [])):
        said = scored(posed(noisy + np.outer(off, [0.0, 1.0, 0.0, 0.0])), posed(WAY))[2]
        assert re.findall(r"from pose (\d+) of .* the track is lost", said) == pose


@pytest.mark.parametrize(("first", "count"), [(0, 5), (0, 100), (-5, 5), (-100, 100), (-1, 1)])
def test_true_poses_that_leap_and_stay_to_an_end_are_named(first, count, scored):
    bad, first = WAY.copy(), first % len(WAY)
    bad[first : first + count, 1:] = [38.0, 0.0, 0.0]
    files = posed(WAY + np.random.default_rng(0).normal(0.0, [0.0, 0.01, 0.01, 0.005], WAY.shape)), posed(bad)
    _, (asked,), _ = scored(*files)
    assert f"poses {first} to {first + count - 1} of" in asked
    values, asked, _ = scored(*files, *re.search(r"--exclude-truth [-\d.:]+", asked)[0].split())
    assert (values["matched"], asked) == (len(WAY) - count, [])


def test_a_path_that_drifts_from_where_both_begin_is_in_no_other_frame_and_headings_of_zero_on_a_bend_are_none(scored):
    drift = WAY.copy()
    drift[9:, 1:] = compose(AWAY, WAY[9:, 1:])
    _, asked, said = scored(posed(drift), posed(WAY))
    assert ("the first poses coincide (to 0 m and 0 deg)" in said, asked) == (True, [])
    values, asked, _ = scored(posed(WAY * [1, 1, 1, 0]), posed(WAY))
    assert ("rmse_heading_deg" in values, asked) == (False, [])


def test_rows_of_both_have_covariances_of_the_estimate_and_one_clock(scored, tmp_path):
    late = np.column_stack([np.interp(WAY[:, 0] - 0.3, WAY[:, 0], column) for column in np.unwrap(WAY.T[1:])])
    rows, axes = np.column_stack([WAY, late, late, np.full((len(WAY), 3), 1e-2)]), ("x", "y", "theta")
    names = ["t", *(f"{of}_{a}" for of in ("gt", "ekf", "odom") for a in axes), "P_xx", "P_yy", "P_thetatheta"]
    (tmp_path / "rows.csv").write_text(commas(rows, ",".join(names)))
    for of in ("ekf", "odom"):
        pairs = ",".join(f"{path}.{a}={word}_{a}" for path, word in (("estimate", of), ("truth", "gt")) for a in axes)
        values, asked, _ = scored(*[(tmp_path / "rows.csv",)] * 2, "--columns", pairs)
        assert ("nees_position" in values, asked) == (of == "ekf", [])


@pytest.mark.parametrize("which", ["estimate", "truth", "both"])
def test_quaternions_with_w_first_are_told_in_either_file(which, scored):
    """Seen: `--axes estimate=camera`, and of both files alike a heading error of 0."""
    half = 0.5 * WAY[:, 3]
    right = np.column_stack([WAY[:, :3], 0 * half, 0 * half, 0 * half, np.sin(half), np.cos(half)])
    wrong = right[:, [0, 1, 2, 3, 7, 4, 5, 6]]
    files = [wrong if which in (name, "both") else right for name in ("estimate", "truth")]
    values, asked, said = scored(*(lines(rows) for rows in files))
    assert len(asked) == {"estimate": 0, "truth": 0, "both": 2}[which]
    assert which == "both" or (values["rmse_rotation_3d_deg"] < 1e-6 and "inferred: quaternions of" in said)
    assert all("begin with w" in text for text in asked)
    known = np.column_stack([files[0], np.tile(np.eye(6)[np.tril_indices(6)], (len(half), 1))])
    scored(lines(known), lines(files[1]), "--cov-frame", "mixed")  # seen: "has no covariance"


def test_flat_poses_of_a_robot_as_matrices_are_told_in_either_file(scored):
    """Seen: "do quaternions begin with w?", which such a file does not have."""
    half = WAY[::5]
    rows = [(np.cos(a), -np.sin(a), 0, x, np.sin(a), np.cos(a), 0, y, 0, 0, 1, 0) for _, x, y, a in half]
    other = [(*row[:3], row[3] + 0.1, *row[4:]) for row in rows]
    _, asked, _ = scored(lines(other), lines(rows))
    flags = sorted(re.search(r"--axes \w+=robot", text)[0] for text in asked)
    assert flags == ["--axes estimate=robot", "--axes truth=robot"]
    values, asked, _ = scored(lines(other), lines(rows), *" ".join(flags).split())
    assert values["rmse_position_m"] == pytest.approx(0.1)
    assert not asked


def test_a_path_in_another_frame_is_aligned_first(scored):
    """The names keep their meaning: only their order tells."""
    t, x, y, _ = WAY.T
    space = np.column_stack([t, x, y, 0.2 * np.sin(t), 0 * t, 0 * t, 0 * t, 1 + 0 * t])
    turned = space.copy()
    turned[:, 1:4] = 0.5 * space[:, [2, 3, 1]] + [30.0, 0.0, -4.0]
    files, plane = (lines(turned), lines(space)), (posed(WAY + [0.0, 30.0, 5.0, 0.0]), posed(WAY))
    assert scored(*files)[0]["rmse_position_3d_sim3_m"] < 1e-6
    for given, first in ((files, "3d_sim3_m"), (files[1:] * 2, "m"), ((*files, "--align", "none"), "m")):
        assert scored(*given)[2].startswith(f"rmse_position_{first} ")
    assert scored(*plane)[2].startswith("rmse_aligned_m ")


def test_latitudes_are_metres_about_one_origin_and_beside_another_frame_aligned(scored):
    """Metres and heights of the ellipsoid, of both files about the truth's first place."""
    t, x, y, _ = WAY.T
    radii = np.array([6367381.8, 6388838.3]) + 200.0  # m, of the meridian and across it at 45 deg, 200 m up
    place = np.column_stack([t, 45.0 + np.degrees(y / radii[0]), 7.0 + np.degrees(x / radii[1] / math.sqrt(0.5))])
    high, moved = np.column_stack([place, 200.0 + 0 * t]), place + [0.0, np.degrees(3.0 / radii[0]), 0.0]
    named, radian = commas(high, "t,gps_lat (deg),gps_lon (deg),alt (m)"), np.radians(moved[:, 1:])
    turned = commas(np.column_stack([t, radian]), "t,lat_rad,lon_rad")
    assert scored(turned, named)[0]["rmse_position_m"] == pytest.approx(3.0, abs=1e-3)
    lost = high * np.where((t == t[5])[:, None], [1.0, 0.0, 0.0, 0.0], 1.0)
    values, _, text = scored(turned, commas(lost, "t,lat,lon,alt"))
    assert ("1 place of truth at 0, 0" in text, values["rmse_position_m"]) == (True, pytest.approx(3.0, abs=1e-3))
    bare = lines(high[:, :3]), lines(high)
    for truth in bare:
        values, _, text = scored(posed(WAY * [1, -1, -1, 1] + [0.0, 5.0, 5.0, 0.0]), truth)
        assert text.startswith(("rmse_aligned_m", "rmse_position_3d_se3_m"))
        assert values["rmse_aligned_m"] < 1e-2
        assert "inferred: --columns t=1,lat=2,lon=3" in text
    assert "t=1,lat=2,lon=3" in scored(lines(np.column_stack([high, radian])), named, status=2)
    assert "ddmm.mmmm, are needed" in scored(commas([[1, 95, 7]], "t,lat,lon"), named, status=2)


def test_a_place_and_a_quaternion_are_read_behind_any_stamp(scored):
    """Rows of twelve are poses of KITTI only with rotations in them."""
    t, x, y, yaw = WAY.T
    q = np.column_stack([0 * t, 0 * t, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])
    for rows in (np.column_stack([t, x, y, q, np.ones((len(t), 5))]), np.column_stack([t, x, y, 0 * t, q, t])):
        values, asked, text = scored(lines(rows), posed(WAY))
        assert values["rmse_position_m"] == pytest.approx(0.0, abs=1e-9)
        assert values["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-6)
        assert "inferred: --columns t=1,x=2,y=3" in text
        assert not asked

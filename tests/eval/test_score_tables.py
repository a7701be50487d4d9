"""`slamref score` on tables: without names, with the estimate and the truth in one row, messages as YAML."""

import math
import re
from datetime import datetime, timedelta

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from data.formats.results.path import Manner
from data.formats.results.reading import only_reading, read_path
from data.se3 import exp_rotation
from eval.score import main as score

T = 0.2 * np.arange(60)
TURN = 0.1 * np.arange(60)
TRUE = np.column_stack([3.0 * np.sin(TURN), 3.0 - 3.0 * np.cos(TURN), TURN])
MINE = TRUE + [0.1, 0.0, 0.0]
WHOLE = {"t": T, "x": MINE[:, 0], "y": MINE[:, 1], "theta": MINE[:, 2]}


def table(columns, header=True, separator=","):
    head = [separator.join(columns)] * header
    return "\n".join([*head, *(separator.join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True))])


@pytest.fixture
def scored(tmp_path, capsys, refused):
    """`scored(text, ..., *flags)`: names and values of files of these texts; with `wrong` the message."""

    def run(*texts, flags=(), wrong=False):
        files = [tmp_path / f"{k}.csv" for k in range(len(texts))]
        for file, text in zip(files, texts, strict=True):
            file.write_text(text + "\n")
        given = [*map(str, files), *flags]
        return refused(score, given) if wrong else of(given)

    def of(given):
        assert score(given) == 0
        lines = (line.split() for line in capsys.readouterr().out.splitlines())
        return {line[0]: float(line[1]) for line in lines if len(line) == 2}

    run.of = of
    return run


@pytest.mark.parametrize("names", ["xy", ["x", "y", "theta"], "txy", ["t", "x", "y", "theta"]])
@pytest.mark.parametrize("separator", [" ", ","])
def test_columns_without_names_are_told_by_their_numbers(scored, names, separator):
    truth = WHOLE | {"x": TRUE[:, 0]}
    texts = (table({n: of[n] for n in names}, False, separator) for of in (WHOLE, truth))
    values = scored(*texts)
    assert values["rmse_position_m"] == pytest.approx(0.1)
    assert values["matched"] == 60
    assert ("rmse_heading_deg" in values) == ("theta" in names)


def test_uneven_stamps_and_positions_of_millimetres_leave_one_reading_and_straight_ways_none():
    rng, n = np.random.default_rng(0), 1500
    t = np.cumsum(rng.uniform(0.005, 0.025, n))
    turn, noise = 0.5 * np.sin(0.5 * t), rng.normal(0, 0.003, (2, n))
    x, y = noise + np.cumsum(0.1 * np.diff(t, prepend=0.0) * np.array([np.cos(turn), np.sin(turn)]), axis=1)
    readings = [((t, x, y, turn), 4), ((t, 0.1 * t, 0.0 * t, 0.2 + noise[0]), 0), ((t, 0.1 * t, np.sin(t)), 0)]
    for columns, read in readings:
        assert len(only_reading([[f"{v:.6f}" for v in row] for row in zip(*columns, strict=True)])) == read


def test_columns_that_may_be_anything_are_to_be_named(scored):
    text = table({"x": MINE[:, 0], "y": MINE[:, 1], "z": 0 * T}, False, " ")
    assert "--columns truth.x=1,truth.y=2" in scored(text, text, wrong=True)
    places = table({"lat": 1e-4 * MINE[:, 0] + 12.9, "lon": 1e-4 * MINE[:, 1] + 77.6}, False, " ")
    moved = table({"lat": 1e-4 * MINE[:, 0] + 12.90001, "lon": 1e-4 * MINE[:, 1] + 77.6}, False, " ")
    assert scored(places, moved)["rmse_position_m"] == pytest.approx(1.106, abs=1e-3)  # degrees
    assert scored(places, moved, flags=("--columns", "x=1,y=2"))["rmse_position_m"] == pytest.approx(1e-5)
    values = scored(text, table({"y": TRUE[:, 1], "x": TRUE[:, 0]}), flags=("--columns", "estimate.x=1,estimate.y=2"))
    assert values["rmse_position_m"] == pytest.approx(0.1)
    turns = exp_rotation(np.outer(0.5 + TURN, [0.0, 0.0, 1.0])).reshape(-1, 9)
    for more in ((), (T, 0 * T, 0 * T, PLANE, 0 * T)):  # a matrix alone, or a position and more beside it
        assert "columns 1 to 9 are a rotation matrix" in scored(*[lines_of(turns, *more)] * 2, wrong=True)


@pytest.mark.parametrize(("own", "true"), [
    (("x_est", "y_est"), ("x_gt", "y_gt")), (("ekf_x", "ekf_y"), ("true_x", "true_y")),
    (("x", "y"), ("xTrue", "yTrue")), (("xest", "yest"), ("xgt", "ygt")),
])  # fmt: skip
def test_an_estimate_and_its_truth_in_one_row(scored, own, true):
    """The only heading, of the estimate, is not the truth's."""
    text = table(dict(zip(("t", *own, "theta", *true), (*WHOLE.values(), TRUE[:, 0], TRUE[:, 1]), strict=True)))
    values = scored(text)
    assert values["rmse_position_m"] == pytest.approx(0.1)
    assert "rmse_heading_deg" not in values
    assert scored(text, text) == values
    assert "no poses; compose them" in scored(text, f"image_next,{text}", wrong=True)


@pytest.mark.parametrize("sides", ["Predicted Actual measured", "real desired", "vo ground_truth noisy"])
def test_words_tell_the_truer_of_two_paths(scored, sides):
    each = zip(sides.split(), (MINE, TRUE, 0 * TRUE), strict=False)
    text = table({"t": T} | {f"{axis} {word}": pose[:, k] for word, pose in each for k, axis in enumerate("XY")})
    assert scored(text)["rmse_position_m"] == pytest.approx(0.1)


def test_two_estimates_beside_a_truth_are_to_be_chosen_and_one_without_is_refused(scored):
    columns = dict(zip(("x_ekf", "x_odom", "y_ekf", "x_gt", "y_gt"), (*MINE.T[[0, 1, 1]], *TRUE.T[:2]), strict=True))
    text = table(columns)
    assert "'x_ekf' and 'x_odom' both name x; one of them is needed, as in --columns x=1" in scored(text, wrong=True)
    for named in ("estimate.x=x_ekf", "x=x_ekf", "x=1"):
        assert scored(text, flags=("--columns", named))["rmse_position_m"] == pytest.approx(0.1)
    assert "'x_ekv' (did you mean x_ekf?)" in scored(text, flags=("--columns", "estimate.x=x_ekv"), wrong=True)
    assert "did you mean" in scored(text, text, flags=("--columns", "estimte.x=x_ekf"), wrong=True)
    assert "1 file without --truth" in scored(table(WHOLE), wrong=True)
    columns = dict(zip(("x_raw", "y_raw", "x_filtered", "y_filtered"), (*TRUE.T[:2], *MINE.T[:2]), strict=True))
    flags = "--columns truth.x=1,truth.y=2,estimate.x=3,estimate.y=4"
    assert flags in scored(table(columns), wrong=True)
    assert scored(table(columns), flags=flags.split())["rmse_position_m"] == pytest.approx(0.1)


def test_of_stamps_those_count_that_tell_rows_apart_others_are_numbers_of_rows_or_headings(scored):
    text = table({"stamp": 0 * T, "time": T, "x": TRUE[:, 0], "y": TRUE[:, 1]})
    assert scored(text, table(WHOLE))["matched"] == 60
    truth = re.sub("(?m)^([\\d.]+)", r"\1 sec", table(WHOLE | {"t": 1000.0 + T, "x": TRUE[:, 0]}))
    values = scored(table(WHOLE | {"t": np.arange(60.0), "x": MINE[:, 0] + 0.01 * (T[-1] == T)}), truth)
    assert values["rmse_position_m"] == pytest.approx(np.sqrt((59 * 0.01 + 0.0121) / 60), rel=1e-5)  # of rows
    assert values["end_position_m"] == pytest.approx(0.11)
    both = {"time": np.floor(T), "x": MINE[:, 0], "y": MINE[:, 1], "gt_x": TRUE[:, 0], "gt_y": TRUE[:, 1]}
    values = scored(table(both))  # those that repeat: rows are compared one by one
    assert (values["rmse_position_m"], values["matched"]) == (pytest.approx(0.1), 60)
    both = [table({"x": pose[:, 0], "y": pose[:, 1], "t": np.sin(TURN)}) for pose in (MINE, TRUE)]  # t: the heading
    assert scored(*both)["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-6)
    turn = np.cumsum(np.random.default_rng(0).normal(0.0, 0.2, 150))  # by a stated number, not by an inferred one, too
    path = np.column_stack([np.cumsum(np.cos(turn)), np.cumsum(np.sin(turn)), turn])
    texts = (table(dict(zip(("x", "y", "theta"), rows.T, strict=True))) for rows in (path[2:-1], path))
    assert scored(*texts, flags=["--time-offset", "2"])["rmse_position_m"] == pytest.approx(0.0, abs=1e-6)


def test_units_of_flags_have_factors_and_signs_count_more_than_names_and_a_coordinate_may_be_one_number(scored):
    """Seen: a header of cm above metres; a phone on a stage whose x is reversed, in 0.01 mm."""
    mine = {"T(min)": T / 0.2, "x(cm):": -1e5 * MINE[:, 0], "y": MINE[:, 1], "psi_deg": 90.0 - np.degrees(TURN)}
    units = "--columns estimate.t=1 --unit estimate.t=0.2s,estimate.x=-0.01mm,estimate.theta=compass"
    values = scored(table(mine), table(WHOLE | {"x": TRUE[:, 0]}), flags=units.split())
    assert (values["rmse_position_m"], values["rmse_heading_deg"]) == pytest.approx((0.1, 0.0), abs=1e-6)
    assert "given twice" in scored(table(WHOLE), table(WHOLE), flags=("--unit", "mm,cm"), wrong=True)
    stage = {"t": T, "x": TRUE[:, 0]}
    texts = table(stage), table(stage | {"x": 3.0 + TRUE[:, 0], "y": 2.0 + 0.0 * T, "z": 0.1 * np.sin(T)})
    assert "type --columns y=NAME, or y=0 of a straight way" in scored(*texts, wrong=True)
    values = scored(*texts, flags=["--columns", "estimate.y=0,estimate.z=0", "--align", "shift"])
    assert values["rmse_position_3d_m"] == pytest.approx(np.sqrt(np.mean(0.01 * np.sin(T) ** 2)))


def message(k, listed):
    x, y, turn = MINE[k]
    covariance = [0.01 * (i % 7 == 0) for i in range(36)]
    lines = [f"- {v}" for v in covariance] if listed else []
    return "\n".join([
        "header:", "  stamp:", f"    secs: {int(T[k])}", f"    nsecs: {round(T[k] % 1 * 1e9)}", "  frame_id: 'odom'",
        "pose:", "  pose:", "    position:", f"      x: {x:.9g}", f"      y: {y:.9g}", "      z: 0.0",
        "    orientation:", "      x: 0.0", "      y: 0.0", f"      z: {math.sin(turn / 2):.9g}",
        f"      w: {math.cos(turn / 2):.9g}",
        *(["  covariance:", *(f"  {line}" for line in lines)] if listed else [f"  covariance: {covariance}"]),
        "twist:", "  linear:", "    x: 7.0", "---",
    ])  # fmt: skip


@pytest.mark.parametrize("listed", [False, True])
def test_messages_as_yaml(scored, listed):
    """As rostopic and ros2 print them: lists in a line, or an element a line."""
    values = scored("\n".join(message(k, listed) for k in range(60)), table(WHOLE | {"x": TRUE[:, 0]}))
    assert values["rmse_position_m"] == pytest.approx(0.1, rel=1e-6)
    assert values["rmse_heading_deg"] < 1e-4
    assert values["nees_position"] == pytest.approx(1.0, rel=1e-5)
    assert values["matched"] == 60


@pytest.mark.parametrize("suffix", ["mat", "npz", "npy"])
def test_paths_of_a_file_of_arrays(tmp_path, capsys, suffix):
    arrays = {"ekf": MINE, "odom": TRUE} if suffix != "npy" else np.column_stack([MINE, TRUE])
    file = tmp_path / f"a.{suffix}"
    {"mat": savemat, "npz": lambda f, v: np.savez(f, **v), "npy": np.save}[suffix](file, arrays)
    names = ["ekf_1", "ekf_2", "odom_1", "odom_2"] if suffix != "npy" else ["a_1", "2", "4", "a_5"]
    keys = ["estimate.x", "estimate.y", "truth.x", "truth.y"]
    assert score([str(file), "--columns", ",".join(f"{k}={n}" for k, n in zip(keys, names, strict=True))]) == 0
    assert "rmse_position_m 0.1\n" in capsys.readouterr().out
    np.savez(tmp_path / "path.npz", poses=MINE, time_stamps=T)
    assert read_path(str(tmp_path / "path.npz")).time == pytest.approx(T)


def test_rows_are_told_apart_by_a_word_binary_ones_by_their_number_and_several_files_are_side_by_side(scored, tmp_path):
    each = [("odom", T, MINE), ("gt", T, TRUE)]
    rows = [f"{t:.9g},{who},{x:.9g},{y:.9g}" for who, *of in each for t, (x, y, _) in zip(*of)]
    text = "\n".join(["time,source,x [mm],y [mm]", *rows])
    assert "rows hold odom (60), gt (60): name those of one kind, as in" in scored(text, text, wrong=True)
    assert score([*[f"{tmp_path}/0.csv:{who}" for who in ("odom", "gt")], "--columns", "x=3,y=y [mm]"]) == 0
    assert "of rows of K doubles type" in scored(table(WHOLE), "\0", wrong=True)
    np.column_stack([T, *MINE.T]).astype("<f4").tofile(tmp_path / "0.bin")
    assert scored.of([f"{tmp_path}/0.bin:floats=4", f"{tmp_path}/0.csv"])["rmse_position_m"] < 1e-6
    turn = exp_rotation(TRUE[:, 2:] * [0.0, 0.0, 1.0]).reshape(-1, 9) * (T[:, None] > 0.0)  # the first is none
    for name, columns in {"t": T, "pos": TRUE * [1.0, 1.0, 0.0], "att": turn}.items():
        (tmp_path / f"{name}.csv").write_text(lines_of(columns, separator=","))
    (tmp_path / "0.csv").write_text(table({name: WHOLE[name] for name in ("x", "y", "theta")}))
    values = scored.of([f"{tmp_path}/0.csv", f"{tmp_path}/t.csv+pos.csv+att.csv"])
    assert (values["rmse_position_m"], values["matched"]) == (pytest.approx(0.1), 59)


@pytest.mark.parametrize("form", ["column", "header", "blank", "bare", "places", "preamble"])
def test_of_several_runs_in_a_file_one_is_named(scored, tmp_path, form):
    first, again = ({"run": 0 * T + k, **WHOLE, "x": MINE[:, 0] + 0.5 * k} for k in (4, 5))
    keys = {"column": ["run", *WHOLE], "header": list(WHOLE), "places": "xy"}.get(form, list(WHOLE))
    texts = [table({key: of[key] for key in keys}, form in ("column", "header")) for of in (first, again)]
    texts[1] = texts[1].partition("\n")[2] if form == "column" else texts[1]
    between = {"blank": "\n\n\n", "places": "\n\n\n", "preamble": "\nRun:,2\n"}.get(form, "\n")
    if form == "preamble":
        texts[0] = f"Method:,New (2020)\nPeriod (ms):,50\n\n{','.join(WHOLE)}\n+,+,+\nRun:,1\n{texts[0]}"
    truth = table({key: (WHOLE | {"x": TRUE[:, 0]})[key] for key in keys if key != "run"}, form != "places")
    assert "2 runs begin, in lines" in scored(between.join(texts), truth, wrong=True)
    for name, run in ((1, 4), (2, 5), *[(5, 5)] * (form == "column")):
        values = scored.of([f"{tmp_path}/0.csv:run={name}", f"{tmp_path}/1.csv"])
        assert values["rmse_position_m"] == pytest.approx(0.1 + 0.5 * run)


@pytest.mark.parametrize("apart", [5.0, 0.01])
def test_paths_whose_rows_alternate_are_told_apart(scored, tmp_path, apart):
    each = [(t + 0.01 * k * (apart > 1.0), k, x + k * apart, y) for t, (x, y, _) in zip(T, MINE) for k in (0, 1)]
    rows = [row for j, row in enumerate(each) if apart > 1.0 or j % 4 < 3]
    assert "rows are of id 0" in scored(table(dict(zip(["t", "id", "x", "y"], zip(*rows)))), table(WHOLE), wrong=True)
    values = scored.of([f"{tmp_path}/0.csv:id=1", f"{tmp_path}/1.csv"])
    assert values["rmse_position_m"] == pytest.approx(apart, rel=0.1)


def test_quaternions_by_name_are_scaled_and_numbers_of_rows_are_no_stamps(scored, tmp_path):
    q = {"qz": (0.05 + T) * np.sin(0.5 * TURN), "qw": (0.05 + T) * np.cos(0.5 * TURN), "qx": 0 * T, "qy": 0 * T}
    text = table({"t": np.arange(60.0), "x": MINE[:, 0], "y": MINE[:, 1], **q})
    assert scored(text, table(WHOLE | {"t": 1000.0 + T}))["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-6)
    flipped = [np.cos(0.5 * TURN) * (T > 0.0), 1.0 * (T == 0.0), 0 * T, np.sin(0.5 * TURN)]
    first = table(dict(zip(["t", "x", "y", "q_1", "q_2", "q_3", "q_4"], [T, *MINE.T[:2], *flipped], strict=True)))
    assert scored(first, table(WHOLE))["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-6)
    bare = {"sec": T, "pos_x": MINE[:, 0], "pos_y": MINE[:, 1], "w": q["qw"], "x": 0 * T, "y": 0 * T, "z": q["qz"]}
    assert scored(table(bare), table(WHOLE))["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-6)
    rows = zip(*(column.tolist() for column in bare.values()), strict=True)
    form = "timestamp: {}\nposition:\n- {}\n- {}\n- 0.0\nq:\n- {}\n- {}\n- {}\n- {}\n---"  # as of px4
    echoed = "\n".join(form.format(round(1e6 * t), *row) for t, *row in rows)
    assert scored(echoed, table(WHOLE))["rmse_heading_deg"] == pytest.approx(0.0, abs=1e-6)
    kinds = "\n".join(f"{kind} {row}" for row in table(WHOLE, False, " ").splitlines() for kind in ("L", "R:Q"))
    assert "rows hold L (60), R:Q (60): name those of one kind" in scored(kinds, table(WHOLE), wrong=True)
    given = [f"{tmp_path}/0.csv:R:Q", f"{tmp_path}/1.csv", "--columns", "estimate.t=2,estimate.x=3,estimate.y=4"]
    assert scored.of(given)["rmse_position_m"] < 1e-9


def test_names_that_repeat_are_of_the_blank_column_before_them(scored):
    head = "header,stamp,secs,nsecs,pose,position,x,y,z,orientation,x,y,z,w,covariance,twist,linear,x,y,z"
    at = zip(T.tolist(), MINE.tolist(), strict=True)
    turned = ((int(t), round(t % 1 * 1e9), x, y, math.sin(a / 2), math.cos(a / 2)) for t, (x, y, a) in at)
    rows = [f',,{s},{ns},,,{x!r},{y!r},0,,0,0,{z!r},{w!r},"[0.0, 1.0]",,,7,8,9' for s, ns, x, y, z, w in turned]
    values = scored("\n".join([head, *rows]), table(WHOLE | {"x": TRUE[:, 0]}))
    assert values["rmse_position_m"] == pytest.approx(0.1, rel=1e-6)
    assert values["rmse_heading_deg"] < 1e-4


def test_a_last_row_that_is_cut_off_is_left_out_and_rows_may_end_before_the_header(scored, tmp_path):
    bare = table(WHOLE, False)
    for text in (bare, table(WHOLE), bare.replace(",", " ")):
        separator = " " if " " in text else ","
        rows = text.splitlines()
        ends = rows[-1].rpartition(separator)[0], rows[-1].rpartition(separator)[0] + separator + "-"
        for end in ends:
            assert scored("\n".join([*rows[:-1], end]), text)["matched"] == 59
            said = read_path(str(tmp_path / "0.csv")).notes
            assert f"line {len(rows)}, the last one, is cut off and left out: '11.8," in said[-1]
        cut = "\n".join([*rows[:-2], ends[0], rows[-1]])
        assert f":{len(rows) - 1}: " in scored(cut, text, wrong=True)
    rows = [f"{t:.9g},{x:.9g},{y:.9g},1" + ",2" * (k % 4 == 0) for k, (t, (x, y, _)) in enumerate(zip(T, TRUE))]
    text = "\n".join(["time,ins_x,ins_y,mode,more", *rows])
    names = ("--columns", "truth.x=ins_x,truth.y=ins_y")
    assert scored(table(WHOLE), text, flags=names)["rmse_position_m"] == pytest.approx(0.1)
    path = read_path(str(tmp_path / "1.csv"), Manner(columns={"x": "ins_x", "y": "ins_y"}))
    assert any("45 of 60 rows end before the header" in note for note in path.notes)
    assert "ins_x may be x; type --columns truth.x=ins_x" in scored(table(WHOLE), text, wrong=True)
    whole = [f"{row},2" if row.endswith(",1") else row for row in text.splitlines()]
    lost = "\n".join([*whole[:5], whole[5].rpartition(",")[0], *whole[6:]])
    assert "4 fields" in scored(table(WHOLE), lost, flags=names, wrong=True)  # one may lack any field


@pytest.mark.parametrize("dated", [False, True])
def test_solutions_of_rtklib_are_places_by_their_comment(scored, tmp_path, dated):
    """Two fields of a stamp; a truth without a height is not scored in space; `FILE:5=1` by the number of a column."""
    names = "%  GPST                latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)"
    stamp = [f"2023/07/11 06:04:{k:02d}.000" if dated else f"2270 {100 + k}.000" for k in range(40)]
    rows = [f"{t} {48 + 1e-5 * k:.9f} {11 + 2e-5 * k:.9f} 520.0 {1 + k % 2} 9 0.1" for k, t in enumerate(stamp)]
    time = [t if dated else 100 + k for k, t in enumerate(stamp)]
    title = "time" if dated else "GPS TOW (s)"
    true = "\n".join([f"{title},Latitude (deg),Longitude (deg),Roll (deg),Pitch (deg),Heading (deg)", *(
        f"{t},{48 + 1e-5 * k + 9e-6:.9f},{11 + 2e-5 * k:.9f},1,2,60" for k, t in enumerate(time))])  # fmt: skip
    (tmp_path / "a.pos").write_text("\n".join(["% program : RTKLIB", "% (Q=1:fix,2:float)", names, *rows]) + "\n")
    (tmp_path / "b.csv").write_text(true + "\n")
    for file, count in (("a.pos", 40), ("a.pos:Q=1", 20)):
        found = scored(flags=(f"{tmp_path}/{file}", f"{tmp_path}/b.csv"))
        assert found["matched"] == count
        assert found["rmse_position_m"] == pytest.approx(1.0, abs=0.01)
        assert "rmse_position_3d_m" not in found
    (tmp_path / "c.csv").write_text("\n".join(f"{k},{k},{k % 3},0,{k % 2}" for k in range(40)) + "\n")
    columns = ("--columns", "t=1,x=2,y=3,theta=4")
    assert scored(flags=(f"{tmp_path}/c.csv:5=1", f"{tmp_path}/c.csv", *columns))["matched"] == 20


def test_topics_as_columns_of_sparse_rows(scored, tmp_path):
    """A recorder's table of several topics: a row for each message, at the table's stamps."""
    names = ["__time", *(f"/ekf/pose/position/{q}" for q in "xy"), "/mocap/data/x", "/mocap/data/y", "/imu/angular/x"]
    rows = [f"{t + 0.01},{x:.9g},{y:.9g},,," for t, (x, y, _) in zip(T, MINE, strict=True)]
    rows += [f"{t},,,{x:.9g},{y:.9g}," for t, (x, y, _) in zip(T, TRUE, strict=True)]
    rows += [f"{t + 0.02},,,,,0.5" for t in T]
    text = "\n".join([",".join(names), *sorted(rows, key=lambda row: float(row.split(",")[0]))])
    assert "topics /ekf, /mocap/data: type which" in scored(text, wrong=True)
    assert "no rows of /odom" in scored(text, flags=(f"{tmp_path / '0.csv'}:/odom",), wrong=True)
    file = tmp_path / "0.csv"
    keys = ("estimate.x", "estimate.y", "truth.x", "truth.y")
    stated = ("--columns", ",".join(f"{k}={n}" for k, n in zip(keys, names[1:], strict=False)))
    expected = scored(table(WHOLE | {"t": T + 0.01}), table(WHOLE | {"x": TRUE[:, 0]}))["rmse_position_m"]
    assert scored(text, flags=stated)["rmse_position_m"] == pytest.approx(expected)
    file.write_text(text + "\n")
    assert scored(flags=(f"{file}:/ekf", f"{file}:mocap/data"))["rmse_position_m"] == pytest.approx(expected)


@pytest.mark.parametrize(
    "form", ["%Y-%m-%d %H:%M:%S.%f", "%Y/%m/%dT%H:%M:%S.%fZ", "%d-%b-%Y %H:%M:%S.%f", "%H:%M:%S.%f"]
)
def test_dates_are_stamps(scored, form):
    at = [(datetime(2021, 7, 16, 15) + timedelta(seconds=t)).strftime(form) for t in T]
    rows = "\n".join(["stamp,x,y", *(f"{t},{x:.9g},{y:.9g}" for t, (x, y, _) in zip(at, MINE, strict=True))])
    truth = "\n".join(["stamp,x,y", *(f"{t},{x:.9g},{y:.9g}" for t, (x, y, _) in zip(at[:31], TRUE, strict=False))])
    values = scored(rows, truth)
    assert (values["rmse_position_m"], values["matched"]) == (pytest.approx(0.1), 31)
    assert scored(rows, truth, flags=("--unit", "t=iso")) == values
    assert "has no dates" in scored(rows, table(WHOLE), flags=("--unit", "iso"), wrong=True)
    assert "is no date" in scored(rows.replace(at[3], "now"), truth, wrong=True)


STEPS = 0.1 * np.arange(240)
R = exp_rotation(np.column_stack([0.2 * np.sin(STEPS), 0.1 * np.cos(2.0 * STEPS), 2.0 * np.sin(0.7 * STEPS)]))
P = np.cumsum(R @ [1.0, 0.0, 0.0] * (0.2 + 0.1 * np.sin(3.0 * STEPS[:, None])), axis=0)
NOISE = np.random.default_rng(1).normal(0.0, 0.01, P.shape)


def kitti(R, p):
    return "\n".join(" ".join(f"{v:.9g}" for v in row) for row in np.dstack([R, p]).reshape(-1, 12))


def tum(R, p):
    rows = np.column_stack([STEPS, p, Rotation.from_matrix(R).as_quat()])
    return "\n".join(" ".join(f"{v:.9g}" for v in row) for row in rows)


@pytest.mark.parametrize("k", [0, 1])
@pytest.mark.parametrize("axes", ["inverse", "inverse-rotations"])
@pytest.mark.parametrize("written", [kitti, tum])
def test_poses_of_the_world_in_the_body_are_inverted(scored, k, axes, written):
    poses, back = [(R, P + NOISE), (R, P)], R.transpose(0, 2, 1)
    sound = scored(*(written(*pose) for pose in poses))
    assert sound["rmse_position_3d_m"] == pytest.approx(0.017, abs=1e-3)
    p = poses[k][1]
    poses[k] = back, p if axes == "inverse-rotations" else -np.einsum("nij,nj->ni", back, p)
    texts = [written(*pose) for pose in poses]
    flags = ("--axes", f"{('estimate', 'truth')[k]}={axes}")
    assert scored(*texts) == scored(*texts, flags=flags) == pytest.approx(sound, rel=1e-4, abs=1e-6)
    assert scored(*texts, flags=("--axes", "robot"))["rmse_rotation_3d_deg"] > 60.0


def test_words_before_poses_are_left_out_and_rows_are_shifted_to_fit(scored):
    """Twelve numbers; one row fewer at the start."""
    rows, true = kitti(R, P + NOISE).splitlines(), kitti(R, P)
    plain = scored("\n".join(rows), true)
    words = "".join(f"{('key:', 'other:')[k % 3 > 0]} {row}\n" for k, row in enumerate(rows))
    assert scored(words, true) == plain
    fewer = words.partition("\n")[2]
    assert scored(fewer, true)["rmse_position_3d_m"] == pytest.approx(plain["rmse_position_3d_m"], rel=0.02)
    assert "or --times estimate=FILE" in scored(kitti(R[9:], P[9:]), true, wrong=True)
    lost = np.r_[:80, 120 : len(R)]
    assert "--time-offset estimate=0 where both begin" in scored(kitti(R[lost], P[lost]), true, wrong=True)
    assert scored(kitti(R[lost], P[lost]), true, flags=("--time-offset", "0"))["matched"] == len(lost)


def octave(name, rows):
    head = f"# name: {name}\n# type: matrix\n# rows: {len(rows)}\n# columns: {len(rows[0])}\n"
    return head + "".join(" ".join(map(repr, row)) + "\n" for row in rows) + "\n\n"


@pytest.mark.parametrize("text", [False, True])
def test_columns_that_nobody_names_are_no_orientations(tmp_path, capsys, text):
    file, odd = tmp_path / "both.mat", np.ones((70, 1))
    savemat(file, {"est": MINE, "other": {"rot_err": odd}, "gt": TRUE, "n": 1.0})
    if text:
        other = "# name: other\n# type: scalar struct\n# ndims: 2\n 1 1\n# length: 1\n" + octave("err", odd.tolist())
        both = (octave("est", MINE.tolist()), other, octave("gt", TRUE.tolist()), "# name: n\n# type: scalar\n1\n")
        file.write_text("# Created by Octave 9.2.0\n" + "".join(both))
    columns = "estimate.x=est_1,estimate.y=est_2,truth.x=gt_1,truth.y=gt_2"
    assert score([str(file), "--columns", columns]) == 0
    assert "rmse_position_m 0.1\n" in capsys.readouterr().out


def test_of_three_paths_in_a_table_the_named_one_takes_nothing_of_another(tmp_path, capsys):
    """The estimate's own z is of another length of name; that of the third path is not taken for it."""
    rows = [f"{k},{0.5 * k},0,{0.5 * k},{0.1 * (k % 2)},{0.5 * k},0.3,{0.7 * k}" for k in range(9)]
    table = tmp_path / "three.csv"
    table.write_text("\n".join(["t,cam_x,cam_y,wheel_x,wheel_y,vo_x,vo_y,vo_z", *rows]) + "\n")
    columns = "estimate.x=wheel_x,estimate.y=wheel_y,truth.x=cam_x,truth.y=cam_y"
    assert score([str(table), "--columns", columns, "--align", "none"]) == 0
    said = capsys.readouterr().out
    assert "rmse_position_3d_m" not in said
    assert f"rmse_position_m {(4 / 9) ** 0.5 * 0.1:.6g}" in said


def lines_of(*columns, separator=" "):
    return "\n".join(separator.join(map(str, row)) for row in np.column_stack(columns).tolist())


PLANE = np.column_stack([np.sin(0.5 * TURN), np.cos(0.5 * TURN)])
POSES = {
    "m00 to m33": lambda M: "t," + ",".join(f"m{i}{j}" for i in range(4) for j in range(4)) + "\n"
    + lines_of(T, M.reshape(-1, 16), separator=","),
    "rotation, position": lambda M: lines_of(T, M[:, :3, :3].reshape(-1, 9), M[:, :3, 3]),
    "by columns": lambda M: lines_of(T, np.swapaxes(M, 1, 2).reshape(-1, 16)),
    "Open3D": lambda M: "\n".join(f"{k} {k} {k + 1}\n{lines_of(m)}" for k, m in enumerate(M)),
    "three rows": lambda M: "\n\n".join(lines_of(m[:3]) for m in M),
    "lists, w first": lambda M: "t,position,rotation\n" + "\n".join(
        f'{t},"{p.tolist()}",{[w, 0, 0, z]}' for t, p, (z, w) in zip(T, M[:, :3, 3], PLANE.tolist(), strict=True)),
    "scaled": lambda M: lines_of(T, M[:, :3, 3], 0 * T, 0 * T, 100.0 * PLANE),
    "about z": lambda M: "t x y z qz qw\n" + lines_of(T, M[:, :3, 3], PLANE),
    "angles": lambda M: lines_of(T, M[:, :3, 3], 0 * T, 0 * T, TURN),
    "a topic": lambda M: "__time," + ",".join(
        f"/odom/pose/pose/{q}" for q in ("position/x", "position/y", "position/z", "orientation/z", "orientation/w"))
    + "\n" + lines_of(T, M[:, :3, 3], PLANE, separator=","),
    "COLMAP": lambda M: "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n" + "\n".join(
        f"{k} {w} 0 0 {-z} {' '.join(map(str, -m[:3, :3].T @ m[:3, 3]))} 1 {k:03d}.png\n1.5 2.5 -1"
        for k, (m, (z, w)) in enumerate(zip(M, PLANE.tolist(), strict=True))),
    "Motive": lambda M: "Format Version,1.23,Length Units,Millimeters\n\n,Type" + ",Rigid Body" * 7 + ",Marker\n,Name"
    + ",a" * 7 + ",a:1\n," + ",Rotation" * 4 + ",Position" * 4 + "\nFrame,Time,X,Y,Z,W,X,Y,Z,X\n"
    + lines_of(T, T, 0 * T, PLANE[:, 0], 0 * T, PLANE[:, 1], 1e3 * M[:, [1, 2, 0], 3], T, separator=","),
}  # fmt: skip


@pytest.mark.parametrize("form", POSES)
def test_matrices_lists_and_a_single_topic_are_poses(scored, form):
    M = np.tile(np.eye(4), (2, len(T), 1, 1))
    M[..., :3, :3] = exp_rotation(TRUE[:, 2:] * [0.0, 0.0, 1.0])
    M[..., :2, 3], M[..., 2, 3] = [MINE[:, :2], TRUE[:, :2]], 0.01 * T
    values = scored(*map(POSES[form], M))
    assert (values["rmse_position_3d_m"], values["rmse_rotation_3d_deg"]) == pytest.approx((0.1, 0.0), abs=1e-5)

"""Parts and quantities that the names of columns tell, and files that are no plain tables of text."""

import gzip
import io
import json
import pickle
import re
import sys
import zipfile

import numpy as np
import pytest
from scipy.io import savemat

from data import se2
from data.convert.__main__ import main

COUNT, STEP, V, OMEGA, START = 40, 0.5, 0.6, 0.2, 1_700_000_000.0
TIME = STEP * np.arange(COUNT)
ARC = se2.along_arcs(np.array([V * STEP]), np.array([OMEGA * STEP]))[0]
POSE = se2.dead_reckoned(np.zeros(3), ARC * (np.arange(COUNT) > 0)[:, None])
MAP = np.array([[3.0, 1.0], [-1.0, 5.0], [4.0, 5.0]])
POLAR = [[(np.hypot(*p), np.arctan2(*p[::-1])) for p in se2.transform_points(se2.inverse(x)[None], MAP)] for x in POSE]
PERIOD = ("--period", "0.5s")
TRACK = [(START + t, 48.0 + y / 111e3, 11.0 + x / 74e3) for t, (x, y, _) in zip(TIME, POSE, strict=True)]
FIXES = [f"{x:.6f},{y:.6f}" if k % 4 == 0 else "," for k, (x, y, _) in enumerate(POSE)]


def csv(names, rows):
    return "\n".join([names, *(",".join(map(str, row)) for row in rows)]) + "\n"


MOTION = csv("time,speed,yaw_rate", ((t, V, OMEGA) for t in TIME))
SEEN = csv("time,tag,dist,phi", ((TIME[k], f"A{j}", *z) for k in range(COUNT) for j, z in enumerate(POLAR[k])))
KNOWN = csv("tag,x,y", ((f"A{j}", *p) for j, p in enumerate(MAP)))
LABELLED = ("--observations", "seen.csv", "--columns", "label=tag,map.id=tag")


@pytest.fixture
def made(convert):
    """`made(files, *words)`: the log of these texts or bytes, the first of odometry, and what is printed."""
    return lambda files, *words: convert(files, "table", next(iter(files)), "out", *words)


def drives(log):
    return log.recorded.increments.mean[1, 2] == pytest.approx(OMEGA * (log.recorded.time[1] - log.recorded.time[0]))


@pytest.mark.parametrize("names", [
    "Time (s),Speed (m/s),Yaw rate (rad/s),GPS x (m),GPS y (m),True X (m),True Y (m),True Heading (rad)",
    "t,cmd_vel.linear.x,cmd_vel.angular.z,uwb_x,uwb_y,gt_x,gt_y,gt_yaw",
    "stamp,wheel_speed,wz,fix.x,fix.y,vicon_x,vicon_y,vicon_theta", "millis,v,w,gps_x,gps_y,true_x,true_y,phi_true",
])  # fmt: skip
def test_fixes_and_truth_of_one_table_are_told_by_their_names(made, names):
    stamp = TIME * (1000.0 if names.startswith("millis") else 1.0)
    rows = ((t, V, OMEGA, f, *p) for t, f, p in zip(stamp, FIXES, POSE, strict=True))
    log, said = made({"robot.csv": csv(names, rows)})
    assert (len(log.recorded.fixes), len(log.recorded.observations.z)) == (COUNT // 4, 0)
    assert log.recorded.fixes.z[1, :2] == pytest.approx(POSE[4, :2], abs=1e-6)
    assert log.truth.pose[1] == pytest.approx(POSE[int(log.recorded.time[1] / STEP)])
    assert "inferred: --truth robot.csv" in said
    assert "inferred: --fixes robot.csv" in said
    assert drives(log)


def test_a_part_that_columns_state_is_in_the_file_of_the_odometry(made):
    rows = ((V, OMEGA, f, *p) for f, p in zip(FIXES, POSE, strict=True))
    names = "fixes.x=e,fixes.y=n,truth.x=a,truth.y=b,truth.theta=c"
    log, _ = made({"robot.csv": csv("v,omega,e,n,a,b,c", rows)}, "--columns", names, *PERIOD, "--fix-sigma", "0.2")
    assert len(log.recorded.fixes) == COUNT // 4
    assert log.recorded.fixes.covariance[0, 1, 1] == pytest.approx(0.04)
    assert log.truth.pose[0] == pytest.approx(POSE[0])


@pytest.mark.parametrize("apart", [False, True])
def test_places_without_headings_are_steps_in_axes_of_their_own(made, apart):
    """Seen: refused, as they had no column theta, and fixes in a file of their own, row by row, as they had no t."""
    own = POSE[:, :2] @ [[0.6, -0.8], [0.8, 0.6]]
    files = {"o.csv": csv("x,y,e,n,a,b", np.hstack([own, POSE[:, [0, 1, 0, 1]]])), "gps.csv": csv("e,n", POSE[:, :2])}
    names = "odometry.x=x,odometry.y=y,fixes.x=e,fixes.y=n,truth.x=a,truth.y=b"
    log, said = made(files, "--columns", names, *PERIOD, *("--fixes", "gps.csv")[: 2 * apart], "--fix-sigma", "0.1")
    assert ("no heading: places are steps" in said, "in order, 40 of 40" in said) == (True, apart)
    assert log.recorded.increments.mean[1:, :2] == pytest.approx(np.diff(own, axis=0))
    assert log.recorded.fixes.frame.tolist() == list(range(COUNT))
    assert log.recorded.prior.mean == pytest.approx([0.0, 0.0, np.arctan2(0.8, 0.6)], abs=1e-6)


def test_speeds_of_wheels_need_their_distance_alone(made, refused, tmp_path):
    rows = ((t, V - 0.2 * OMEGA, V + 0.2 * OMEGA, f) for t, f in zip(TIME, FIXES, strict=True))
    words = ("--track-width", "0.4", "--fix-sigma", "0.1")
    log, said = made({"robot.csv": csv("t,v_left,v_right,gps_x,gps_y", rows)}, *words)
    assert "--ticks rate --metres-per-tick 1" in said
    assert drives(log)
    slow = ((t, 100.0 * (V - 0.2 * OMEGA), 100.0 * (V + 0.2 * OMEGA), f) for t, f in zip(TIME, FIXES, strict=True))
    text = csv("t,v_left (cm/s),v_right (cm/s),gps_x,gps_y", slow)
    assert drives(made({"robot.csv": text}, *words)[0])
    (tmp_path / "turns.csv").write_text(text.replace("cm/s", "rad/s"))
    assert "wheel's radius" in refused(main, ["table", str(tmp_path / "turns.csv"), "out2", *words])
    text = csv("time,esc", ((t, 7, 7, -k * V, k * V, POSE[k, 2]) for k, t in enumerate(TIME)))  # and a heading
    words = ("--columns", "left=esc_3,right=esc_4,theta=esc_5", "--metres-per-tick=-0.5,0.5", "--frames", "odometry")
    log, said = made({"esc.csv": text}, *words)
    assert se2.dead_reckoned(np.zeros(3), log.recorded.increments.mean) == pytest.approx(POSE)
    assert ("esc stands for 5 columns" in said, log.source["wheels"]["track_width"]) == (True, 0.0)


@pytest.mark.parametrize("names", ["wheel_left_pos,wheel_right_pos", "message.encoders.left,wr", "v,w,enc_l,enc_r"])
def test_angles_of_wheels_and_a_gyro_that_turns_by_another_factor(made, names):
    wheels, omega = ("--track-width", "0.4", "--metres-per-tick", "0.1", "--ticks", "total"), OMEGA * np.sin(0.2 * TIME)
    heading = STEP * np.append(0.0, np.cumsum(omega)[:-1])
    ways = [10.0 * (V * TIME + a * 0.2 * heading) for a in (-1, 1)]
    ways = [np.full(COUNT, V), omega, *ways] if names[0] == "v" else ways
    text = csv(f"t,{names},gyro_z (deg/s),gps_x,gps_y", zip(TIME, *ways, np.rad2deg(1.35 * omega), FIXES, strict=True))
    log, said = made({"robot.csv": text}, *wheels[: 6 * (names[0] != "v")], "--prior", "0,0,0")
    assert log.recorded.increments.mean[1:, 2].sum() == pytest.approx(np.interp(log.recorded.time[-1], TIME, heading))
    times, flag = re.search(r"gyro_z .* is ([\d.]+) times .* right\? (--\S+)", said).groups()
    assert (float(times), flag) == (pytest.approx(1.35, rel=0.03), "--unit" if names[0] == "v" else "--track-width")


def test_landmarks_named_by_words_and_the_start_that_takes_them_to_the_map(made):
    log, said = made({"odo.csv": MOTION, "seen.csv": SEEN, "map.csv": KNOWN}, *LABELLED, "--map", "map.csv")
    assert log.label[:3].tolist() == [0, 1, 2]
    assert log.recorded.map.xy == pytest.approx(MAP)
    assert log.recorded.prior.mean == pytest.approx(np.zeros(3), abs=1e-3)
    assert "which takes observations to the map" in said
    words = {"A0": "043B", "A1": "12E4", "A2": "C0DE"}
    hexadecimal = {"seen.csv": SEEN, "map.csv": KNOWN}
    for word, other in words.items():
        hexadecimal = {name: text.replace(word, other) for name, text in hexadecimal.items()}
    log, _ = made({"odo.csv": MOTION, **hexadecimal}, *LABELLED, "--map", "map.csv")
    assert len(np.unique(log.label)) == 3
    assert log.recorded.prior.mean == pytest.approx(np.zeros(3), abs=1e-3)


def test_places_along_which_the_odometry_leads_are_fixes(made):
    """Not observations of a landmark, which would stand still, nor the odometry's own path, which would count twice."""
    rng, points = np.random.default_rng(4), se2.transform_points(np.stack([se2.inverse(p) for p in POSE]), [5.0, 2.0])
    far = 6e5 + POSE[:, :2] + 0.1 * rng.standard_normal((COUNT, 2))
    for names, places, count in (("Easting,Northing", far, COUNT), ("x,y", points, 0), ("x,y", 1.0 + POSE[:, :2], 0)):
        rows = ((t, V, OMEGA, *p) for t, p in zip(TIME, places, strict=True))
        words = ("--fix-sigma", "0.1") if count else ()
        log, said = made({"robot.csv": csv(f"t,v,omega,{names}", rows)}, *words)
        assert len(log.recorded.observations.z) == COUNT - count
        assert ("--fixes robot.csv, as its x and y are places" in said) == bool(count)
        if count:
            assert log.recorded.prior.mean[:2] == pytest.approx([6e5, 6e5], abs=0.2)
            assert float(said.split("--prior=")[1].split(",")[0]) == pytest.approx(log.recorded.prior.mean[0], abs=0.01)


def test_an_odometry_that_turns_the_other_way_than_the_fixes_is_named(convert):
    """Headings named in deg are still of a compass where the odometry turns so only."""
    files = {"robot.csv": csv("t,v,omega,lat,lon,heading (deg)", (
        (t, V, -OMEGA, 48.0 + p[1] / 111e3, 11.0 + p[0] / 74e3, 90.0 - np.degrees(p[2]))
        for t, p in ((0.25 * k, se2.along_arcs(np.array([V * 0.25 * k]), np.array([OMEGA * 0.25 * k]))[0])
                     for k in range(80))))}  # fmt: skip
    words = ("table", "robot.csv", "out", "--fix-sigma", "0.2,0.2,3deg")
    assert "turns the other way (--unit omega=-rad/s" in convert(files, *words, status=2)
    log, said = convert(files, *words, "--unit", "omega=-rad/s")
    assert "headings of fixes are clockwise from north" in said
    assert log.recorded.prior.mean[2] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("names", ["lm{j}_range,lm{j}_bearing", "z_range_{j},z_bearing_{j}"])
def test_numbers_of_landmarks_stand_anywhere_in_the_names_of_columns(made, names):
    rows = ((t, V, OMEGA, *(v for z in zs for v in z)) for t, zs in zip(TIME, POLAR, strict=True))
    title = ",".join(names.format(j=j) for j in range(1, 4))
    log, said = made({"robot.csv": csv(f"t,v,omega,{title}", rows)})
    assert log.recorded.observations.z[:3] == pytest.approx(np.array(POLAR[0]))
    assert "inferred: --columns range=" in said


def test_a_turn_a_way_and_a_turn_are_a_step(made):
    turn = np.degrees(0.5 * OMEGA * STEP)
    rows = ((turn, ARC[0] / np.cos(np.radians(turn)), turn, f) for f in FIXES)
    text = csv("delta_rot1 (deg),delta_trans,delta_rot2 (deg),gps_x,gps_y", rows)
    log, said = made({"a.csv": text}, "--frames", "odometry", "--fix-sigma", "0.1")
    assert "are a turn, a way and a turn" in said
    assert log.recorded.increments.mean[1] == pytest.approx(ARC, abs=1e-9)


def test_no_fix_yet_and_a_held_one_are_no_fixes(made):
    """Seen: 325 fixes where 195 were measured, as a position at 0, 0 and those that stood between rows were read."""
    place = np.round(5.0 + POSE[:, :2] * [1.0, 0.01], 3)
    held = [(0.0, 0.0)] * 2 + [tuple(place[4 * (k // 4)]) for k in range(COUNT - 2)]
    rows = ((t, V * (k % 4 < 2), OMEGA, *p) for k, (t, p) in enumerate(zip(TIME, held, strict=True)))
    words = ("--prior", "5,5,0", "--fix-sigma", "0.1")
    log, said = made({"robot.csv": csv("t,v,omega,gps_x,gps_y", rows)}, *words)
    assert len(log.recorded.fixes) == len({*held}) - 1
    assert "2 places of fixes at 0, 0" in said


def test_a_pose_beside_speeds_is_neither_an_observation_nor_a_fix(convert):
    rows = ((t, V, OMEGA, *p) for t, p in zip(TIME, POSE + 0.01 * np.sin(TIME)[:, None], strict=True))
    said = convert({"a.csv": csv("t,v,omega,x,y,theta", rows)}, "table", "a.csv", "out", status=2)
    assert "no observations" in said


def test_a_speed_to_the_left_beside_a_heading(made):
    rows = ((t, 0.5, 0.2, 0.3, *p[:2]) for t, p in zip(TIME, POSE, strict=True))
    words = ("--columns", "v=a,vy=b,theta=c,truth.x=x,truth.y=y", "--prior", "0,0,0.3", "--prior-sigma", "0,0,0")
    log, _ = made({"a.csv": csv("t,a,b,c,x,y", rows)}, *words)
    assert log.recorded.increments.mean[1] == pytest.approx([0.5 * STEP, 0.2 * STEP, 0.0], abs=1e-9)


@pytest.mark.parametrize("form", ["a file of stamps and a folder", "files with the same stamps"])
def test_files_row_by_row(convert, tmp_path, form):
    if form.startswith("a file"):
        (tmp_path / "data").mkdir()
        files = {f"data/{k:03d}.txt": f"{p[0]} {p[1]} {V} {OMEGA}\n" for k, p in enumerate(POSE)}
        files["times.txt"], source = "\n".join(map(str, TIME)), "times.txt+data"
        names = "t=times,v=data3,omega=data4,fixes.x=data1,fixes.y=data2"
    else:
        rows = ((10 + t, t, OMEGA, f) for t, f in zip(TIME, FIXES, strict=True))
        files = {"odo.csv": csv("%time,header.stamp,v", ((9 + t, t, V) for t in TIME)),
                 "imu.csv": csv("%time,header.stamp,wz,gps_x,gps_y", rows)}  # fmt: skip
        source, names = "odo.csv+imu.csv", "v=v"
    log, _ = convert(files, "table", source, "out", "--columns", names, "--fix-sigma", "0.1")
    assert drives(log)
    assert log.recorded.time[-1] == TIME[-1]


def test_an_odometry_that_is_set_to_zero_ends_there(made):
    rows = [(t, *p, *p[:2]) for t, p in zip(TIME, POSE, strict=True)]
    rows += [(TIME[-1] + 0.5, *POSE[0], *POSE[-1, :2]), (TIME[-1] + 1.0, *ARC, *POSE[-1, :2])]
    log, said = made({"a.csv": csv("t,x,y,theta,gt_x,gt_y", rows)}, "--frames", "odometry")
    assert log.recorded.time[-1] == TIME[-1]
    assert "it was reset, so the odometry ends there" in said


def test_stamps_that_are_times_of_day_are_seconds(made):
    day = np.array([95950 + k if k < 10 else 100000 + k - 10 for k in range(COUNT)])
    rows = ((t, V, OMEGA, f) for t, f in zip(day, FIXES, strict=True))
    log, said = made({"a.csv": csv("utc_time,v,omega,gps_x,gps_y", rows)}, "--prior", "0,0,0", "--fix-sigma", "0.1")
    assert np.ptp(log.recorded.time) == COUNT - 1
    assert "times of day hhmmss, as 95950" in said


@pytest.mark.parametrize("speed", [False, True])
def test_fixes_without_an_odometry_move_as_fast_as_they_do(made, speed):
    """The motion is unknown within nine tenths of their speeds; beside a speed alone the turn rate is."""
    noise = 0.05 * np.random.default_rng(3).standard_normal((COUNT, 2))
    rows = ((t, *[V] * speed, *p) for t, p in zip(TIME, POSE[:, :2] + noise, strict=True))
    names = "time,speed,gps_x,gps_y" if speed else "time,gps_x,gps_y"
    log, said = made({"a.csv": csv(names, rows)}, "--fix-sigma", "0.05")
    step, P = log.recorded.increments.mean[1:], log.recorded.increments.covariance[1:]
    assert len(log.recorded.fixes) == COUNT
    assert step[:, 0] == pytest.approx(STEP * V * speed)
    assert not step[:, 1:].any()
    if speed:
        assert np.sqrt(P[:, 2, 2]) == pytest.approx(np.radians(45.0) * np.sqrt(STEP), rel=0.01)
        assert log.recorded.prior.covariance[2, 2] == pytest.approx(np.radians(45.0) ** 2)
    else:
        assert V * STEP < np.sqrt(P[0, 0, 0]) < 1.5 * V * STEP
        assert "no odometry: the motion is unknown" in said
        assert not re.search("--odometry-sigma|--unit time", said)
    assert "inferred: --prior at the first fix" in said


def test_velocities_east_and_north_and_a_turn_rate_alone_beside_fixes(made, refused):
    rows = np.column_stack([TIME, V * np.cos(POSE[:, 2]), V * np.sin(POSE[:, 2]), OMEGA + 0 * TIME, POSE[:, :2]])
    text = csv("time,e,n,spin,gps_x,gps_y", np.vstack([rows[:30], rows[29] - [0.2, *5 * [0]], rows[30:]]))
    log, said = made({"a.csv": text}, "--columns", "v=e,vy=n", "--fix-sigma", "0.1")
    assert ("velocities are in axes of their own" in said, "1 odometry row with stamps before" in said) == (True, True)
    assert "a turn rate or a heading" in refused(main, ["table", "a.csv", "out2", "--columns", "v=n,vy=e"])
    log, said = made({"a.csv": text}, "--columns", "omega=spin")
    assert log.recorded.increments.mean[1] == pytest.approx([0.0, 0.0, OMEGA * STEP])
    assert "no speed: unknown, within --odometry-sigma 0.6,2deg" in said


def test_labels_are_the_column_that_holds_the_names_of_the_map(made):
    seen, known = SEEN.replace("tag", "node"), KNOWN.replace("tag", "name")
    log, said = made({"odo.csv": MOTION, "seen.csv": seen, "map.csv": known}, *LABELLED[:2], "--map", "map.csv")
    assert "label=node,map.id=name" in said
    assert log.label[:3].tolist() == [0, 1, 2]


def test_a_matrix_of_a_row_of_x_and_one_of_y_is_the_map(made):
    held = io.BytesIO()
    z = np.array(POLAR)[:, [0, 1, 2, 0, 1]]  # two of the five landmarks stand where others do
    np.savez(held, t=TIME, v=V + 0 * TIME, turn=OMEGA + 0 * TIME, landmarks=MAP[[0, 1, 2, 0, 1]].T,
             z_range=z[:, :, 0], z_bearing=z[:, :, 1])  # fmt: skip
    log, said = made({"a.npz": held.getvalue()}, "--columns", "yaw_rate=turn")
    assert log.recorded.map.xy[:3] == pytest.approx(MAP)
    assert "--map" in said
    assert drives(log)


@pytest.mark.parametrize("suffix", ["npz", "mat", "pkl"])
def test_matrices_are_the_parts_that_their_names_tell(made, suffix):
    """Commands, a truth and a map; an instant in each column, without stamps; of lists of objects each observation in
    the row of its element.
    """
    held, listed = io.BytesIO(), [[(j, *z) for j, z in enumerate(zs) if (k + j) % 4] for k, zs in enumerate(POLAR)]
    parts = {"controls": np.tile([V, OMEGA], (COUNT, 1)), "gt_pose": POSE, "landmarks": MAP, "t": TIME}
    if suffix == "npz":
        np.savez(held, **parts, z_range=np.array(POLAR)[:, :, 0], z_bearing=np.array(POLAR)[:, :, 1])
    elif suffix == "mat":
        seen = {"z_range": np.array(POLAR)[:, :, 0].T, "z_bearing": np.array(POLAR)[:, :, 1].T}
        savemat(held, {"u": parts["controls"].T, "x_true": POSE.T, "map": MAP, **seen})
    else:
        pickle.dump(parts | {"seen": listed}, held)
    log, _ = made({f"a.{suffix}": held.getvalue()}, *("--period", f"{STEP}s") * (suffix == "mat"))
    count = 3 * COUNT if suffix != "pkl" else sum(map(len, listed))
    assert drives(log)
    assert (len(log.recorded.observations.z), len(np.unique(log.label))) == (count, 3)
    assert log.recorded.map.xy == pytest.approx(MAP)
    assert log.truth.pose[:, :2] == pytest.approx(POSE[:, :2])


@pytest.mark.parametrize("form", ["kinds of rows", "lists in fields", "counted"])
def test_observations_of_every_instant_in_forms_of_programs(made, form):
    """Lines of kinds that their first words tell, lists of ids, ranges and bearings, a number of groups that follow."""
    seen = [[(j, *z) for j, z in enumerate(zs) if (k + j) % 4 and (k % 5 or j)] for k, zs in enumerate(POLAR)]
    files = {"a.txt": csv("t,v,omega", ((t, V, OMEGA) for t in TIME)), "b.txt": ""}
    if form == "kinds of rows":
        rows = [
            f"odom,{t},{V},{OMEGA}\n" + "".join(f"lm,{t},{j},{r},{b}\n" for j, r, b in zs) for t, zs in zip(TIME, seen)
        ]
        files = {"a.txt": "".join(rows)}
    elif form == "counted":
        rows = [f"{t} {len(zs)} " + " ".join(f"{j} {r} {b}" for j, r, b in zs) for t, zs in zip(TIME, seen)]
        files["b.txt"] = "\n".join(rows)
    else:
        each = ([[*c] for c in zip(*zs)] for zs in seen)
        rows = (f'{t},"{c[0]}","{[float(v) for v in c[1]]}","{[float(v) for v in c[2]]}"' for t, c in zip(TIME, each))
        files["b.txt"] = "time,ids,ranges,bearings\n" + "\n".join(rows)
    log, _ = made(files, *("--observations", "b.txt") * (len(files) > 1))
    assert log.recorded.observations.z == pytest.approx(np.array([z[1:] for zs in seen for z in zs]))
    assert log.label.tolist() == [z[0] for zs in seen for z in zs]
    assert log.recorded.time[log.recorded.observations.frame] == pytest.approx(np.repeat(TIME, list(map(len, seen))))


def test_objects_by_number_may_be_one(made):
    rows = [{"t": t, "v": V, "w": OMEGA, "seen": {j: list(z) for j, z in enumerate(zs[: 1 + k % 3])}}
            for k, (t, zs) in enumerate(zip(TIME, POLAR, strict=True))]  # fmt: skip
    names = "label=seen.key,range=seen.value_1,bearing=seen.value_2,frame=element"
    log, _ = made({"a.json": json.dumps(rows)}, "--columns", names)
    assert len(log.recorded.observations.z) == sum(1 + k % 3 for k in range(COUNT))


def test_places_of_anchors_beside_their_ranges_are_the_map(made):
    rows = ((TIME[k], z[0], *MAP[j]) for k in range(COUNT) for j, z in enumerate(POLAR[k]))
    log, said = made({"odo.csv": MOTION, "uwb.csv": csv("t,range,anchor_x,anchor_y", rows)},
                     "--observations", "uwb.csv", "--prior", "0,0,0")  # fmt: skip
    assert log.recorded.map.xy == pytest.approx(MAP)
    assert log.label[:4].tolist() == [0, 1, 2, 0]
    assert "are places of 3 landmarks" in said


def test_objects_of_json_and_yaml_have_parts_by_their_names(made):
    steps = [
        {"timestamp": t, "control": {"v": V, "w": OMEGA}, "pose_gt": {"x": p[0], "y": p[1], "theta": p[2]},
         "observations": [{"id": j, "range": z[0], "bearing": z[1]} for j, z in enumerate(zs)]}
        for t, p, zs in zip(TIME, POSE.tolist(), POLAR, strict=True)
    ]  # fmt: skip
    lines = "\n".join(map(json.dumps, steps)) + "\n"
    yaml = "landmarks:\n" + "".join(f"  {j}: [{x}, {y}]\n" for j, (x, y) in enumerate(MAP))
    log, _ = made({"log.jsonl": lines, "map.yaml": yaml}, "--map", "map.yaml")
    assert log.recorded.observations.z[:3] == pytest.approx(np.array(POLAR[0]))
    assert log.label[:3].tolist() == [0, 1, 2]
    assert log.recorded.map.xy == pytest.approx(MAP)
    assert log.truth.pose[-1, :2] == pytest.approx(POSE[-1, :2])
    assert drives(log)


def test_files_with_stamps_of_their_own_are_joined_by_them(convert):
    wheel = csv("timestamp,wheel_speed", ((int(1e9 * (START + t)), V) for t in TIME))
    imu = csv("timestamp,gyro_z", ((int(1e9 * (START + 0.1 * k)), OMEGA) for k in range(5 * COUNT)))
    fixes = csv("time,latitude,longitude", TRACK)
    files = {"wheel.csv": wheel, "imu.csv": imu, "gps.csv": fixes}
    log, said = convert(files, "table", "wheel.csv+imu.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "0.1")
    assert "nearest in time" in said
    assert drives(log)
    files["imu.csv"] = csv("timestamp,gyro_z", ((int(1e9 * (START + t - 0.1)), OMEGA) for t in TIME))  # as many rows
    log, said = convert(files, "table", "wheel.csv+imu.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "0.1")
    assert ("nearest in time" in said, drives(log)) == (True, True)


def test_units_of_stated_names_and_digits_of_microseconds(made):
    rows = ((int(t), int(t % 1 * 1e6), 3.6 * V, OMEGA, f) for t, f in zip(TIME, FIXES, strict=True))
    names = ("--columns", "odometry.t=tv_sec+tv_usec,odometry.v=wheels,odometry.omega=w", "--fix-sigma", "0.1")
    log, said = made({"robot.csv": csv("tv_sec,tv_usec,Wheels (km/h),w,gps_x,gps_y", rows)}, *names)
    assert log.recorded.time[-1] == pytest.approx(TIME[-1])
    assert log.recorded.increments.mean[1, 0] == pytest.approx(V * log.recorded.time[1], rel=0.05)
    assert "v of odometry is read from Wheels (km/h), in km/h" in said


def nmea(stamp, lat, lon):
    clock = stamp % 86400
    text = f"{int(clock // 3600):02d}{int(clock // 60 % 60):02d}{clock % 60:05.2f}"
    place = [f"{int(v) * 100 + (v % 1) * 60:.6f},{side}" for v, side in ((lat, "N"), (lon, "E"))]
    return f"{stamp:.2f},$GPGGA,{text},{place[0]},{place[1]},4,12,0.8,500.0,M,47.0,M,,*5A"


def gpx(stamp, lat, lon):
    time = np.datetime64(int(1000 * stamp), "ms")
    return f'<trkpt lat="{lat}" lon="{lon}"><ele>5</ele><time>{time}Z</time></trkpt>'


@pytest.mark.parametrize(("name", "content"), [
    ("a.nmea", "\n".join(f"{nmea(*row)}\n$GPGSA,A,3,,,1.0*30" for row in TRACK)),
    ("b.nmea", "\n".join(f"{5 * k} {nmea(*row).partition(',')[2]}" for k, row in enumerate(TRACK))),
    ("a.gpx", '<?xml version="1.0"?><gpx version="1.1"><trk>' + "\n".join(gpx(*row) for row in TRACK) + "</trk></gpx>"),
    ("a.csv.gz", gzip.compress(csv("t,lat,lon", TRACK).encode())),
    ("fix.csv", "".join(f"{int(t)},{int(t % 1 * 1e9)},gps,0,1,{a},{b},500.0{',0.1' * 9},2\n" for t, a, b in TRACK)),
])  # fmt: skip
def test_tracks_of_receivers_and_packed_tables_are_fixes(made, name, content):
    begin = START % 86400.0 if name == "b.nmea" else START  # whose lines are numbered, which is no stamp
    odometry = csv("time,v,omega", ((begin + t, V, OMEGA) for t in TIME))
    log, _ = made({"odo.csv": odometry, name: content}, "--fixes", name, "--fix-sigma", "0.1")
    z = log.recorded.fixes.z[:, :2]
    assert len(z) == COUNT
    assert np.hypot(*(z[-1] - z[0])) == pytest.approx(np.hypot(*(POSE[-1] - POSE[0])[:2]), rel=0.02)


def test_a_spreadsheet_is_its_first_sheet_or_the_named_one(made, refused, tmp_path, monkeypatch):
    openpyxl = pytest.importorskip("openpyxl")
    book, held = openpyxl.Workbook(), io.BytesIO()
    for row in csv("time,v,omega,gps_x,gps_y", ((t, V, OMEGA, f) for t, f in zip(TIME, FIXES, strict=True))).split():
        book.active.append([float(f) if f[:1].isdigit() or f[:1] == "-" else f or None for f in row.split(",")])
    book.save(held)
    log, _ = made({"log.xlsx": held.getvalue()}, "--fix-sigma", "0.1")
    assert len(log.recorded.fixes) == COUNT // 4
    assert drives(log)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    assert "pip install openpyxl" in refused(main, ["table", str(tmp_path / "log.xlsx"), "out2"])
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("a.csv", "x"), archive.writestr("b.csv", "y")
    (tmp_path / "two.zip").write_bytes(packed.getvalue())
    assert "2 files (a.csv, b.csv)" in refused(main, ["table", str(tmp_path / "two.zip"), "out2"])


def test_a_receiver_that_starts_cold_does_not_tell_the_start(made):
    off = [(8.0, -6.0) if k < 6 else (0.0, 0.0) for k in range(COUNT)]
    rows = ((t, V, OMEGA, x + a, y + b) for t, (x, y, _), (a, b) in zip(TIME, POSE, off, strict=True))
    log, _ = made({"robot.csv": csv("t,v,omega,gps_x,gps_y", rows)}, "--fix-sigma", "0.1")
    assert log.recorded.prior.mean == pytest.approx(np.zeros(3), abs=1e-3)


def test_units_below_names_and_names_without_their_units(made):
    text = MOTION.replace("time,speed,yaw_rate\n", "Time,Speed (m/s),turn\n(s),,(rad/s)\n")
    log, _ = made({"odo.csv": text, "seen.csv": SEEN}, *LABELLED[:3], "label=tag,v=speed,omega=Turn")
    assert drives(log)

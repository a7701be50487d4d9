"""What only one reading of the data explains is read so, and said: units, several observations in a row, the start."""

import numpy as np
import pytest

from data.origin import Origin
from data.se2 import between, dead_reckoned, wrap_angle

BASE = 0.5  # m, between the axles
T = np.arange(300) * 0.1
V, STEERING = 1.0 + 0.2 * np.sin(0.2 * T), 0.2 * np.cos(0.05 * T)
OMEGA = V * np.tan(STEERING) / BASE
THETA = np.concatenate([[0.0], np.cumsum(0.1 * OMEGA[:-1])])
WAY = 0.1 * V[:-1] * np.sinc(0.05 * OMEGA[:-1] / np.pi)
XY = [np.concatenate([[0.0], np.cumsum(WAY * f(THETA[:-1] + 0.05 * OMEGA[:-1]))]) for f in (np.cos, np.sin)]
POSE = np.column_stack([*XY, THETA])
PLACES = np.array([[3.0, 4.0], [-2.0, 5.0], [6.0, 1.0], [1.0, -3.0]])


def text(names, *columns):
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in np.column_stack(columns))
    return f"{names}\n{rows}\n"


def observed():
    """Two landmarks in each row, the nearest, with their ids."""
    rows = []
    for t, (x, y, theta) in zip(T[::10], POSE[::10], strict=True):
        off = PLACES - [x, y]
        seen = np.column_stack([range(4), np.hypot(*off.T), wrap_angle(np.arctan2(off[:, 1], off[:, 0]) - theta)])
        rows.append([t, *seen[np.argsort(seen[:, 1])[:2]].ravel()])
    return text("time,id_1,range_1,bearing_1,id_2,range_2,bearing_2", rows)


@pytest.fixture
def converted(convert):
    """`converted(odometry, *flags)`: the log beside a truth in degrees, and what is said."""
    files = {"seen.csv": observed(), "truth.csv": text("time,x,y,yaw", T, POSE * [1.0, 1.0, np.rad2deg(1.0)])}
    named = ("table", "o.csv", "out", "--observations", "seen.csv", "--truth", "truth.csv")
    return lambda odometry, *flags, **status: convert(files | {"o.csv": odometry}, *named, *flags, **status)


def test_speed_and_steering_of_a_car(converted):
    odometry = text("time,velocity_mps,steer_rad,steer_deg", T, V, STEERING, np.rad2deg(STEERING))
    assert "--wheel-base" in converted(odometry, status=2)
    log, said = converted(odometry, "--wheel-base", "50cm")
    assert "warning" not in said
    np.testing.assert_allclose(log.truth.pose[:30, 2], wrap_angle(POSE[::10, 2]), atol=1e-6)
    np.testing.assert_allclose(log.recorded.increments.mean[1:30, 2], np.diff(POSE[::10, 2]), atol=1e-6)
    assert (log.origins["units"], "inferred: --unit truth.theta=deg" in said) == (Origin.INFERRED, True)
    o = log.recorded.observations  # each row holds two, whose ids name the landmarks
    assert np.hypot(*(PLACES[log.label] - POSE[10 * o.frame, :2]).T) == pytest.approx(o.z[:, 0], abs=1e-6)
    assert len(o.z) == 60
    asked, said = converted(odometry, "--wheel-base", "0.5", "--unit", "truth.theta=rad")
    assert "heading unit" in said
    assert asked.origins["units"] is Origin.GIVEN


def test_a_robot_that_moves_sideways_or_along_a_heading_that_is_read(converted):
    """Each row's velocities hold along an arc until the next row; finely stepped they lead to the same poses."""
    v, vy, omega, fine = np.full(300, 0.5), np.linspace(-0.3, 0.4, 300), np.full(300, 0.2), 2000
    heading = np.repeat(0.2 * T, fine) + np.tile((np.arange(fine) + 0.5) / fine * 0.02, 300)
    turn = np.exp(1j * heading) * np.repeat(v + 1j * vy, fine) * 0.1 / fine
    place = np.append(0.0, turn.cumsum()[fine - 1 : -1 : fine])
    log, _ = converted(text("time,vx,vy,wz", T, v, vy, omega), "--columns", "v=vx,vy=vy,omega=wz")
    course, _ = converted(text("time,s,yaw", T, V, THETA), "--columns", "v=s")
    for same, way in ((log, place), (course, XY[0] + 1j * XY[1])):
        moved = dead_reckoned(np.zeros(3), same.recorded.increments.mean)
        assert moved[:30, 0] + 1j * moved[:30, 1] == pytest.approx(way[::10], abs=1e-6)
    assert "vy" in converted(text("time,vx,vy,wz", T, v, vy, omega), "--columns", "v=vx,omega=wz")[1], "not used: said"


@pytest.mark.parametrize("turned", [False, True])
def test_poses_without_names_are_read_as_headings_follow_the_motion(converted, turned):
    rows = np.column_stack([T, POSE * [1.0, 1.0, np.rad2deg(1.0)]])
    log, said = converted(text("", rows.T if turned else rows).lstrip())
    assert ("its 4 rows are columns of 300 rows" in said) == turned
    assert "inferred: --columns odometry.t=1,odometry.x=2,odometry.y=3,odometry.theta=4" in said
    assert "inferred: --unit odometry.theta=deg" in said
    np.testing.assert_allclose(log.recorded.increments.mean[1:30, 2], np.diff(POSE[::10, 2]), atol=1e-6)


@pytest.mark.parametrize("order", [["label", "range", "bearing"], ["bearing", "label", "range"], ["label", "y", "x"]])
def test_observations_without_names_are_read_as_landmarks_stand_still(convert, order):
    at = np.repeat(np.arange(0, 300, 10), 4)
    off = np.tile(PLACES, (30, 1)) - POSE[at, :2]
    distance, bearing = np.hypot(*off.T), wrap_angle(np.arctan2(off[:, 1], off[:, 0]) - POSE[at, 2])
    of = {"label": np.tile(range(4), 30), "range": distance, "bearing": bearing}
    of |= {"x": distance * np.cos(bearing), "y": -distance * np.sin(bearing)}
    seen = np.column_stack([T[at], *(of[q] for q in order)])
    files = {"o.csv": np.column_stack([T, V, OMEGA]), "z.csv": seen, "wide.csv": np.hstack([seen[::4], seen[1::4, 1:]])}
    files = {name: text("", values).lstrip() for name, values in files.items()}
    log, said = convert(files, "table", "o.csv", "out", "--observations", "z.csv")
    assert f"inferred: its columns are t, {', '.join(order)}" in said
    assert "inferred: --columns odometry.t=1,odometry.v=2,odometry.omega=3" in said
    assert "warning" not in said
    right = np.column_stack([of["x"], -of["y"]] if "x" in order else [distance, bearing])
    assert log.recorded.observations.z == pytest.approx(right, abs=1e-6)
    if "range" in order:
        log, said = convert(files, "table", "o.csv", "out", "--observations", "wide.csv")
        assert (len(log.recorded.observations.z), log.label.tolist()) == (60, [0, 1] * 30)
    files = {"o.csv": text("", POSE).lstrip(), "z.csv": text("", at, seen[:, 1:]).lstrip()}  # by the row of a pose
    log, _ = convert(files, "table", "o.csv", "out", "--observations", "z.csv")
    assert (log.recorded.observations.frame == at).all()


@pytest.mark.parametrize(("names", "flags"), [
    ("t,v,omega,d1,d2,d3,d4", ()), ("t,d1,d2,d3,d4", ()), ("", ()), ("t,x,y,d1,d2,d3,d4", ("--odometry-kind", "none")),
])  # fmt: skip
def test_ranges_in_columns_to_a_map_tell_the_start_also_without_odometry(convert, names, flags):
    """Ranges of two tags, the columns of each by turns, where no names tell them; places in whole millimetres."""
    far = np.hypot(*(PLACES - POSE[:, None, :2]).T).T + np.random.default_rng(0).normal(0.0, 0.02, (300, 4))
    beside = {"v": [V, OMEGA], "x": [*XY], "d": []}[names[2:3] or "d"]
    each = [*far.T] if names else [c for k in range(4) for c in (0 * T - 80, far[:, k])]
    files = {"uwb.csv": text(names, T, *beside, *each).lstrip(), "map.csv": text("", 1e3 * PLACES, 0 * PLACES[:, :1])}
    files["map.csv"] = files["map.csv"].lstrip()
    words = ("table", "uwb.csv", "out", "--map", "map.csv", "--unit", "map.x=mm,map.y=mm", "--observation-sigma", "5cm")
    assert "--odometry-kind none" in convert(files, *words, status=2) if flags else True
    log, said = convert(files, *words, *flags)
    o, prior = log.recorded.observations, log.recorded.prior
    assert (o.z[:, 0] == pytest.approx(far.ravel(), abs=1e-6), log.label[:4].tolist()) == (True, [1, 2, 3, 4])
    assert ("no odometry" in said, ": triangles" in said) == ("v" not in names, True)
    assert np.abs(prior.mean[:2]).max() < 0.2
    assert prior.mean[2] == pytest.approx(0.0, abs=np.pi if "v" not in names else 0.05)
    assert np.sqrt(np.diag(prior.covariance))[:2].max() < 0.3


@pytest.mark.parametrize("places", [PLACES[:3].T, np.column_stack([PLACES, 0 * PLACES[:, 0]]).T])
def test_arrays_of_ranges_and_of_places_a_row_for_each_coordinate(convert, tmp_path, places):
    far = np.hypot(*(places.T[:, :2] - POSE[:, None, :2]).T).T
    np.savez(tmp_path / "log.npz", t=T, u=np.column_stack([V, OMEGA]), z=far, balises=places)
    log, _ = convert({}, "table", "log.npz", "out")
    assert log.recorded.observations.z[:, 0] == pytest.approx(far.ravel())
    assert log.recorded.map.xy.T.tolist() == places[:2].tolist()
    assert log.recorded.prior.mean == pytest.approx(np.zeros(3), abs=0.1)


def test_observations_of_a_robot_that_stands_still_are_not_read(convert):
    which = np.arange(300) % 4
    seen = np.column_stack([T, which, 3.0 + which, np.array([0.1, -0.2, 0.3, 0.4])[which]])
    files = {"o.csv": text("t,v,omega", T, 0 * T, 0 * T), "z.csv": text("", seen).lstrip()}
    said = convert(files, "table", "o.csv", "out", "--observations", "z.csv", status=2)
    assert "no observations: columns 1 to 4" in said


def test_steps_without_a_sideways_motion(converted):
    way = np.hypot(*np.diff(POSE[:, :2], axis=0, prepend=POSE[:1, :2]).T)
    log, said = converted(text("time,d,delta_theta", T, way, np.diff(THETA, prepend=0.0)))
    assert "assumed: steps have no dy" in said
    assert "warning" not in said
    np.testing.assert_allclose(log.recorded.increments.mean[1:30, 2], np.diff(POSE[::10, 2]), atol=1e-6)


def test_fixes_tell_the_start_and_files_side_by_side_are_one_table(convert):
    c, s = np.cos(0.7), np.sin(0.7)
    gps = text("t,x,y", T[::10], (POSE[:, :2] @ [[c, s], [-s, c]] + [5.0, -3.0])[::10])
    files = {f"{n}.txt": text("", v).lstrip() for n, v in (("clock", T), ("speed", V), ("turn", OMEGA))}
    words = ("--fixes", "gps.csv", "--columns", "odometry.t=clock,v=speed,omega=turn")
    table = (files | {"gps.csv": gps}, "table", "clock.txt+speed.txt+turn.txt", "out", *words)
    assert "unknown start" in convert(*table, "--fix-sigma", "4,4", status=2)  # the way is too short
    log, said = convert(*table, "--fix-sigma", "5cm,5cm")
    assert log.recorded.prior.mean == pytest.approx([5.0, -3.0, 0.7], abs=0.05)
    unsure, _ = convert(*table, "--fix-sigma", "5cm,5cm", "--odometry-sigma", "5cm,20deg")
    assert log.recorded.prior.covariance[2, 2] < 0.04 < unsure.recorded.prior.covariance[2, 2]  # as odometry drifts
    assert (log.origins["prior"], "inferred: --prior=" in said) == (Origin.INFERRED, True)
    for places, status in ((POSE[::10, :2], 0), (-5.0 * POSE[::10, :2], 2)):
        files = {"o.csv": text("t,x,y,theta", T, POSE), "gps.csv": text("t,x,y", T[::10], places)}
        made = convert(files, "table", "o.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "4,4", status=status)
        assert "unknown start" in made if status else "takes odometry as it is written to the fixes" in made[1]


def test_a_row_of_zeros_an_odometry_to_the_other_side_and_fixes_of_a_gps_receiver(convert):
    """x north, y east, headings clockwise, behind a row of zeros; latitudes of the south as ddmm.mmmm."""
    turned = np.column_stack([T, POSE[:, [1, 0]], 0.5 * np.pi - THETA])
    rows = np.vstack([np.zeros(4), turned + [5e4, 0.0, 0.0, 0.0]])
    at = zip(T[::3], POSE[::3], strict=True)
    places = [f"{5e4 + t},{4830.0 - y / 1853.51:.7f},S,{212.0 + x / 1231.2:.7f},E" for t, (x, y, _) in at]
    files = {"o.csv": text("t,x,y,theta", rows), "gps.csv": "\n".join(["t,lat,ns,lon,ew", *places])}
    words = ("table", "o.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "0.1,0.1")
    log, said = convert(files, *words)
    assert "o.csv: lines 2 and 3 are 50000 s apart, others 0.1 s; line 2 is left out" in said
    assert log.recorded.time[0] == 5e4
    assert log.recorded.fixes.z[:, :2] == pytest.approx(POSE[::3, :2], abs=0.1)
    assert "`--unit odometry.y=-m,odometry.theta=-rad` of `slamref convert table`) (contradiction)" in said
    assert "warning" not in convert(files, *words, "--unit", "odometry.y=-m,odometry.theta=-rad")[1]
    turned[150:, 0] += 5e3
    said = convert(files | {"o.csv": text("t,x,y,theta", turned)}, *words, "--time-offset", "fixes=-5e4")[1]
    assert "lines 151 and 152 are 5000.1 s apart, others 0.1 s" in said
    assert "time unit" not in said


def test_a_folder_of_observations_a_file_for_each_row_or_of_points_which_are_no_beams(convert, tmp_path):
    """Rows without stamps at a stated period; observations are points in the sensor's frame."""
    (tmp_path / "seen").mkdir()
    for k in range(300):
        (tmp_path / "seen" / f"{k:05d}.txt").write_text("".join(f"2 {j}\n" for j in range(1 + k % 3)))
    names = "odometry.v=1,odometry.omega=2,observations.x=1,observations.y=2"
    words = ("--observations", tmp_path / "seen", "--columns", names, "--period", "0.1s")
    log, _ = convert({"o.csv": text("", V, OMEGA).lstrip()}, "table", "o.csv", "out", *words)
    assert np.bincount(log.recorded.observations.frame).tolist() == [1 + k % 3 for k in range(300)]
    assert log.recorded.time[-1] == pytest.approx(29.9)
    (tmp_path / "scans").mkdir()
    for k in range(3):
        (tmp_path / "scans" / f"{k}.txt").write_text("1.0 2.0 0.3\n1.1 2.0 0.3\n1.2 2.0 0.3\n")
    flags = ("--scans", str(tmp_path / "scans"), "--scanner", "-1,0.1,8")
    odometry = text("t,v,omega", T[:9], V[:9], OMEGA[:9])
    said = convert({"o.csv": odometry}, "table", "o.csv", "out", *flags, status=2)
    assert "no scans: columns frame, 1, 2, 3; columns such as range0, range1 are needed" in said


def test_a_compass_and_dates(convert):
    """Headings clockwise from north or east, dates without a unit; the robot stays within 4 m of its start."""
    turn = 0.25 * T
    circle = np.column_stack([4.0 * np.sin(turn), 4.0 - 4.0 * np.cos(turn), wrap_angle(turn)])
    dates = [f"2024-05-01 12:00:{t:09.6f}" for t in T]
    files = {"o.csv": "\n".join(["time,v,omega", *(f"{d},1,0.25" for d in dates)])}
    for east, unit, since in ((0.0, 1.0, "clockwise from east"), (0.5 * np.pi, 57.29578, "clockwise from north")):
        rows = (f"{d},{unit * wrap_angle(east - h)},{x},{y}" for d, (x, y, h) in zip(dates, circle, strict=True))
        files["gps.csv"] = "\n".join(["time,heading,x,y", *rows])
        log, said = convert(files, "table", "o.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "0.5,0.5,2deg")
        assert f"{since}, as the odometry turns so only" in said
        assert log.recorded.prior.mean == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
        np.testing.assert_allclose(log.recorded.fixes.z[:, 2], circle[log.recorded.fixes.frame, 2], atol=0.03)
    rows = (f"{d},{wrap_angle(3.0 + h)},{x},{y}" for d, (x, y, h) in zip(dates, circle, strict=True))
    files["gps.csv"] = "\n".join(["time,heading,x,y", *rows])
    assert "unknown start" in convert(files, "table", "o.csv", "out", "--fixes", "gps.csv", status=2)  # they disagree


@pytest.mark.parametrize("names", ["from_id,to_id,dx,dy,dtheta", "a,b,dx,dy,dtheta"])
def test_steps_between_poses(convert, names):
    """Named ends, or a true pose more than steps, say that the first step leads from the first pose to the second."""
    step = between(POSE[:-1], POSE[1:])
    files = {"o.csv": text(names, np.arange(299), np.arange(1, 300), step), "truth.csv": text("x,y,theta", POSE)}
    files["seen.csv"] = text("pose_id,range,bearing,landmark_id", [[0, 5, 0, 1], [299, 5, 0, 1]])
    parts = ("--observations", "seen.csv", "--truth", "truth.csv", "--prior", "truth", "--prior-sigma", "0,0,0")
    log, said = convert(files, "table", "o.csv", "out", *parts)
    assert "its 299 steps are between 300 poses" in said
    assert log.recorded.observations.frame.tolist() == [0, 299]
    np.testing.assert_allclose(log.recorded.increments.mean[1:], step, atol=1e-9)
    files["truth.csv"] = text("t,x,y,theta", T[:200], POSE[:200])
    if "from" in names:
        assert "200 true poses, 300 frames: which" in convert(files, "table", "o.csv", "out", *parts, status=2)


@pytest.mark.parametrize(("count", "poses"), [(200, 300), (299, 299), (300, 300), (140, 0)])
def test_fixes_without_stamps_are_of_the_first_poses_that_steps_lead_to(convert, count, poses):
    files = {"o.csv": text("dx,dy,dtheta", between(POSE[:-1], POSE[1:]))}
    files["gps.csv"] = text("x,y,z", POSE[:count, :2], np.zeros(count))
    words = ("table", "o.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "5cm", "--prior", "0,0,0")
    assert "so no instant" in convert(files, *words, "--columns", "fixes.frame=z", status=2)
    made = convert(files, *words, status=0 if poses else 2)
    if poses:
        assert (made[0].recorded.fixes.frame.tolist(), len(made[0].recorded.time)) == ([*range(count)], poses)
    assert f"in order, {count} of {poses}" in made[1] if poses else "name it as in --columns fixes.frame" in made


def test_an_array_of_scans_beside_stamps_and_headings_of_the_names_time_and_t(convert, tmp_path):
    scans = np.full((300, 40), 3.0)
    np.savez(tmp_path / "log.npz", laser=scans, time=T, t=-THETA, v=V, w=OMEGA)
    flags = ("table", str(tmp_path / "log.npz"), "out", "--scans", str(tmp_path / "log.npz"))
    assert "--scanner LOW,STEP,MAX" in convert({}, *flags, status=2)
    log, said = convert({}, *flags, "--scanner", "-90deg,4deg,8m")
    assert all(f"inferred: --columns {flag}" in said for flag in ("t=time", "scans.range=laser_1"))
    assert "pass a full turn" in convert({}, *flags, "--scanner", "-90deg,10deg,8m", status=2)
    assert log.recorded.scans.ranges.shape == (300, 40)


def test_latitudes_in_rad_and_a_column_for_two_quantities(convert):
    """Seen: no unit was known of lat and lon, angle=rad did not reach them; a column was read as stamp and range."""
    place = np.radians(np.column_stack([48.0 + POSE[:, 1] / 111194.0, 11.0 + POSE[:, 0] / 74625.0]))
    files = {"o.csv": text("t,v,omega", T, V, OMEGA), "gps.csv": text("t,lat,lon", T, place)}
    words = ("table", "o.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "0.1,0.1")
    for unit, many in (("lat=rad,lon=rad", 1.0), ("angle=rad", 1.0), ("lat=1e-7deg,lon=1e-7deg", np.degrees(1e7))):
        files["gps.csv"] = text("t,lat,lon", T, np.round(place * many, 0 if many > 1.0 else 12))
        z = convert(files, *words, "--unit", unit)[0].recorded.fixes.z
        assert z[:, :2] == pytest.approx(POSE[:, :2], rel=5e-3, abs=0.03)
    assert "`--unit lat=1e-7deg,lon=1e-7deg`" in convert(files, *words, status=2)
    assert "column t is named for t and x" in convert(files, *words, "--columns", "fixes.x=t,fixes.y=lat", status=2)


def test_observations_without_stamps_are_in_the_order_of_the_steps(convert, monkeypatch):
    """Seen: as many rows a step as landmarks, or rows of several points, were refused, as they had no t or frame."""
    off = PLACES - POSE[1:, None, :2]
    seen = np.stack([np.hypot(*off.T), wrap_angle(np.arctan2(*off.T[::-1]) - POSE[1:, 2])], axis=-1).transpose(1, 0, 2)
    files = {"o.csv": text("dx,dy,dtheta", between(POSE[:-1], POSE[1:])), "truth.csv": text("x,y,theta", POSE)}
    files |= {"map.csv": text("x,y", PLACES), "z.csv": text("range,bearing", seen.reshape(-1, 2))}
    words = ("table", "o.csv", "out", "--observations", "z.csv", "--truth", "truth.csv")
    for more in (("--map", "map.csv"), ()):
        log, said = convert(files, *words, *more, "--period", "0.1s")
        assert log.recorded.observations.frame.tolist() == np.repeat(np.arange(1, 300), 4).tolist()
        assert (log.label.tolist(), "landmark i" in said, "warning" in said) == ([0, 1, 2, 3] * 299, True, False)
    monkeypatch.setattr("data.questions.asked.ask", lambda _: ())  # takes half a second
    mixed = np.random.default_rng(0).permuted(seen, axis=1).reshape(-1, 2)
    assert convert(files | {"z.csv": text("range,bearing", mixed)}, *words, "--map", "map.csv")[0].label is None
    few = files | {"z.csv": text("range,bearing", seen.reshape(-1, 2)[1:])}
    assert "no column 'frame'" in convert(few, *words, status=2)
    points = np.stack([seen[..., 0] * f(seen[..., 1]) for f in (np.cos, np.sin)], axis=-1)
    rows = [",".join(map(str, points[k, : (0 if k == 7 else 1 + k % 4)].ravel().tolist())) for k in range(299)]
    o = convert(files | {"z.csv": "\n".join(rows) + "\n"}, *words)[0].recorded.observations
    assert np.bincount(o.frame)[6:12].tolist() == [2, 3, 0, 1, 2, 3]
    assert o.z[:3] == pytest.approx(np.concatenate([points[0, :1], points[1, :2]]), abs=1e-9)
    named = files | {"z.csv": "bearing\n" + "1\n2\n1\n" * 100}
    assert "is named for" in convert(named, *words, "--columns", "observations.range=bearing", status=2)


@pytest.mark.parametrize(("size", "wanted"), [(1.0, "lat=rad,lon=rad"), (1e3, "fixes.x=mm,fixes.y=mm")])
def test_places_in_another_unit_contradict_the_odometry(convert, size, wanted):
    """Seen: latitudes in rad were read as degrees without a word, and a start inferred from them."""
    place = 5.0 * POSE[:, :2] * size
    degrees = np.column_stack([48.0 + place[:, 1] / 111194.0, 11.0 + place[:, 0] / 74625.0])
    fixes = text("t,lat,lon", T, np.radians(degrees)) if size == 1.0 else text("t,x,y", T, place)
    files = {"o.csv": text("t,v,omega", T, 5.0 * V, OMEGA), "gps.csv": fixes}
    words = ("table", "o.csv", "out", "--fixes", "gps.csv", "--fix-sigma", "0.1,0.1")
    log, said = convert(files, *words)
    assert (f"`--unit {wanted}`" in said, "which takes odometry" in said) == (True, False)
    assert log.origins["prior"] is Origin.ASSUMED
    log, said = convert(files, *words, "--unit", wanted)
    assert ("contradict" in said, log.recorded.prior.mean[2]) == (False, pytest.approx(0.0, abs=0.05))

"""Files with rows of several kinds, columns of one name, and scans."""

import json
import math

import numpy as np
import pytest
from scipy.io import savemat

from data.convert.__main__ import main
from data.formats.results.reading import read_path

NOISE = ("--odometry-sigma", "0.05,2deg", "--observation-sigma", "0.1")
MIXED = "\n".join(line for k in range(9) for line in (f"odom2 {k} 0.5 0.1 0 0", f"range2 {k}.5 {9 - k} 7")) + "\n"


@pytest.fixture
def read(convert):
    """`read(files, *words)`: the log of these texts, the first of odometry, and what is printed."""
    return lambda files, *words: convert(files, "table", next(iter(files)), "out", *words)


@pytest.fixture
def unread(refused, tmp_path, monkeypatch):
    """`unread(files, *words)`: the line that refuses files of these texts."""

    def run(files, *words):
        monkeypatch.chdir(tmp_path)
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        return refused(main, ["table", next(iter(files)), "out2", *words])

    return run


def test_rows_of_one_kind_are_named_behind_the_file_and_columns_of_one_name_by_numbers(convert, read, unread):
    words = ("--observations", "in.txt:range2", "--columns", "v=3,omega=4,t=2,range=3,label=4", *NOISE)
    log, said = convert({"in.txt": MIXED}, "table", "in.txt:odom2", "out", *words)
    assert "in.txt:odom2: columns not used: 5, 6\n" in said
    assert log.recorded.observations.z[:, 0] == pytest.approx(9.0 - np.arange(9))
    assert log.recorded.increments.mean[2, 2] == pytest.approx(0.1)
    told = "".join(f"ODOM {k} {k} 0 0\nGPS {k}.5 {k}.4 0\n" for k in range(60))
    assert read({"g.txt": told})[0].recorded.fixes.z[:, 0] == pytest.approx(0.4 + np.arange(59))
    assert "in.txt:odom2: no odometry: columns 1 to 6" in unread({"in.txt": MIXED})
    assert "rows hold pose (9), range2 (9): name those" in unread({"in.txt": MIXED.replace("odom2", "pose")})
    text = "time,v,omega,time\n" + "".join(f"{10 * k},0.5,0,{k}\n" for k in range(9))
    seen = "t,range,bearing\n" + "".join(f"{k},{9 - k},0.1\n" for k in range(9))
    sigma = ("--observations", "seen.csv", "--odometry-sigma", "0.05,2deg", "--observation-sigma", "0.1,1deg")
    log, _ = read({"o.csv": text, "seen.csv": seen}, *sigma, "--columns", "odometry.t=4")
    assert np.diff(log.recorded.time) == pytest.approx(1.0)


BEAMS, STEP = 36, np.radians(10.0)


def scans(named):
    rows = []
    for k in range(20):
        far = np.full(BEAMS, 5.0)
        far[18] = 6.0 - 0.2 * k  # ahead, each scan 0.2 m further on
        about = [1700000000_000000000 + 500000000 * k, *([-np.pi, np.pi - STEP, STEP, 0.1, 20.0] if named else [])]
        numbers = ",".join(map(repr, map(float, [*about[1:], *far])))
        rows.append(f"{about[0]},{numbers}" if named else f"{numbers},{about[0]}")
    names = ["stamp", "angle_min", "angle_max", "angle_increment", "range_min", "range_max"]
    header = [",".join(f"field.header.{n}" for n in (*names, *(f"ranges{b}" for b in range(BEAMS))))]
    return "\n".join([*(header if named else []), *rows]) + "\n"


ODOMETRY = "%time,field.header.stamp,field.x,field.y,field.theta\n" + "".join(
    f"{1700000009_000000000 + k},{1700000000_000000000 + 250000000 * k},{0.1 * k},0,0\n" for k in range(41)
)


@pytest.mark.parametrize("named", [True, False])
def test_scans_of_a_table_are_those_of_a_laser_log(read, named):
    """As rostopic echo -p writes them, or without names; a tiny range that comes often stands for no return."""
    words = ("--scanner=-180deg,10deg,20", "--columns=scans.t=37,scans.range=1", "--unit=scans.t=ns") * (not named)
    log, _ = read({"odo.csv": ODOMETRY, "scan.csv": scans(named)}, "--scans", "scan.csv", *words)
    r = log.recorded
    assert r.scans.ranges.shape == (20, BEAMS)
    assert np.diff(r.time[r.scans.frame]) == pytest.approx(0.5)
    assert np.diff(r.scans.ranges[:, 18]) == pytest.approx(-0.2)
    assert r.increments.mean[r.scans.frame[1:], 0] == pytest.approx(0.2, abs=1e-6)
    assert (r.scans.scanner.max_range, r.scans.scanner.angle_step) == pytest.approx((20.0, STEP))
    for often in (True, False):  # also where the file states that the least range is 0 m
        far = scans(named=named).replace(",0.1,20.0", ",0.0,20.0").replace("5.0,", "0.01,", 40 if often else 1)
        log, said = read({"odo.csv": ODOMETRY, "scan.csv": far}, "--scans", "scan.csv", *words)
        assert ("0.01 m, 40 times, stands for no return" in said) == often
        assert (log.recorded.scans.ranges == 0.01).sum() == (not often)


@pytest.mark.parametrize(("names", "numbers"), [
    (("min_angle", "laserAngleMax", "max_range [cm]"), (-np.pi, np.pi - STEP, 2000)),
    (("scan.angle_start", "angular_resolution", "range_max"), (-180, 10, 20)),
    (("angle_min_deg", "angle_inc_deg", "rangeMax"), (-180, 10, 20)),
    (("angle_min", "angle_increment"), (np.pi, -STEP)),
])  # fmt: skip
def test_names_units_and_keys_of_a_scanner(read, names, numbers):
    """Of JSON, whatever its name; a reach that it does not state is that of the farthest reading."""
    path, stated = "scan.json" if "rangeMax" in names else "scan.txt", len(names) > 2
    expected = (-np.pi, STEP, 20.0) if stated else (np.pi, -STEP, 1.001 * (1.4 + 35 / 9))
    keys = dict(zip(names, numbers)) | {"t": [1.7e9 + k / 2 for k in range(9)]}
    keys["ranges"] = (1.0 + np.arange(9)[:, None] / 20 + np.arange(BEAMS) / 9).tolist()
    log, said = read({"odo.csv": ODOMETRY, path: json.dumps(keys)}, "--scans", path)
    scanner = log.recorded.scans.scanner
    assert log.recorded.scans.ranges.shape == (9, BEAMS)
    assert (scanner.angle_min, scanner.angle_step, scanner.max_range) == pytest.approx(expected)
    assert ("inferred: reach 5.29418 m, the farthest reading" in said) != stated
    assert ("inferred: angles of beams in deg" in said) == ("scan.angle_start" in names)


def test_scans_without_names_alone_or_behind_row_numbers_or_stamps_are_known(read, unread):
    far = [line.rsplit(",", 1)[0] for line in scans(named=False).splitlines()]
    files = {"odo.csv": "\n".join(ODOMETRY.splitlines()[:21])}
    ahead = np.abs(np.diff([list(map(float, line.split(","))) for line in far])).mean(axis=0).max()
    oblique = [f"{float(line.partition(',')[0]) + 1.5 * ahead},{line.partition(',')[2]}" for line in far]
    said = read(files | {"scan.csv": "\n".join(oblique)}, "--scans", "scan.csv", "--scanner=-180deg,10deg,20")[1]
    assert "inferred: --columns scans.range=1" in said, "a wall that the outer beams meet"
    for told, before in (("range=1", ""), ("range=2", "{},"), ("t=1,scans.range=2", "17000000{:02d}.25,")):
        files["scan.csv"] = "\n".join(before.format(k) + line for k, line in enumerate(far))
        log, said = read(files, "--scans", "scan.csv", "--scanner=-180deg,10deg,20")
        assert f"inferred: --columns scans.{told}" in said
        assert (
            log.recorded.scans.ranges.tolist()
            == [list(map(float, r.split(","))) for r in far][: len(log.recorded.scans.frame)]
        )
    log, said = read({"scan.csv": files["scan.csv"]}, "--scanner=-180deg,10deg,20")
    assert ("scan matching alone tells the motion" in said, len(log.recorded.scans.frame)) == (True, len(far))
    for refused in (scans(named=False), "\n".join(far[1:])):  # stamps behind, or other rows than the odometry
        assert "or --columns scans.range=N" in unread(files | {"scan.csv": refused}, "--scans", "scan.csv")


@pytest.mark.parametrize("lying", [False, True])
def test_scans_of_an_array_beside_the_odometry_have_the_angles_of_another(convert, tmp_path, lying):
    """An instant in each column, as MATLAB's programs have them, too; without odometry scans alone tell the motion."""
    far, pose = np.random.default_rng(0).uniform(1.0, 7.0, (300, 41)), np.zeros((300, 3))
    pose[:, [0, 2]] = np.arange(300)[:, None] * [0.01, 0.005]
    parts = {
        "scans": far.T if lying else far,
        "poses": pose.T if lying else pose,
        "angles": np.arange(-80.0, 81.0, 4.0),
    }
    path = tmp_path / "log.npz"
    np.savez(path, **parts)
    log, said = convert({}, "table", str(path), "out", "--period", "0.2s")
    assert log.recorded.scans.ranges == pytest.approx(far)
    scanner = log.recorded.scans.scanner
    assert (scanner.angle_min, scanner.angle_step) == pytest.approx((-np.pi / 2.25, np.pi / 45.0))
    assert "inferred: --scans" in said
    assert log.recorded.increments.mean[1] == pytest.approx([0.01, 0.0, 0.005])
    np.savez(path, time=0.2 * np.arange(300), scans=parts["scans"], angles=parts["angles"])
    log, said = convert({}, "table", str(path), "out")
    assert "scan matching alone tells the motion" in said
    assert not log.recorded.increments.mean.any()
    assert log.recorded.increments.covariance[1, 0, 0] > 0.001


@pytest.mark.parametrize(("stamp", "title"), [("{k}", "time"), ("{k}.{i:03d}", "time"), ("{k}", "scan"), ("{k}", "")])
def test_a_row_for_each_beam_is_folded_into_scans(read, stamp, title):
    """Of a stamp or number for each scan or beam; or without names, clockwise, some without return or out of order."""
    far, there = 1.0 + np.arange(800.0).reshape(20, 40) / 200.0, (np.arange(40) + np.arange(20)[:, None]) % 7 > 0
    each = [(k, i) for k in range(20) for i in range(40) if there[k, i] or not title]
    rows = [f"{stamp.format(k=k, i=i)},{9 * i},{1000 * far[k, i] * there[k, i]}" for k, i in each]
    header, words = f"{title},angle_deg,distance_mm\n", ("--unit", "scans.range=mm")
    if not title:
        rows[119], rows[120] = (f"{k},{row.partition(',')[2]}" for k, row in ((2.5, rows[120]), (2.7, rows[119])))
        words = ("--unit", "scans.range=mm,angle=-deg", "--columns", "scans.t=1,scans.angle=2,scans.range=3")
        header, far, there = "", far[:, ::-1], there[:, ::-1]
    log, said = read({"beams.csv": header + "\n".join(rows)}, *words)
    found = log.recorded.scans
    assert found.ranges.shape == (20, 40)
    assert found.ranges[found.ranges > 0.0] == pytest.approx(far[there])
    assert np.degrees([found.scanner.angle_min, found.scanner.angle_step]) == pytest.approx([-351.0 * (not title), 9.0])
    lost = 0 if title else 114
    assert f"20 scans, a row for each beam, in steps of 9 deg; 686 echoes, {lost} rows without one" in said
    assert ("angles count anticlockwise" in said) == bool(title)


def test_rows_below_heads_are_a_scan_or_a_pose_each_and_a_heading_may_be_0(read, unread):
    scans = (f"{k},40\n" + "".join(f"{9 * i},{40 * k + i + 9}\n" for i in range(40)) for k in range(20))
    files = {"a.csv": "".join(f"{k},1\n{0.5 * k},0.25\n" for k in range(20)), "s.csv": "".join(scans)}
    words = ("--scans", "s.csv", "--unit=angle=deg,range=cm", "--columns", "scans.bearing=1,scans.range=2,x=1,y=2")
    log, said = read(files, *words, "--columns", "theta=0")
    assert log.recorded.scans.ranges == pytest.approx(np.arange(9.0, 809.0).reshape(20, 40) / 100.0)
    assert log.recorded.increments.mean[1:] == pytest.approx(np.tile([0.5, 0.0, 0.0], (19, 1)))
    assert read_path("a.csv").pose[:, 0] == pytest.approx(0.5 * np.arange(20))
    told = "for places without headings of a robot that does not turn type --columns odometry.theta=0"
    assert ("a.csv: inferred: 20 rows as 0,1 are heads" in said, told in unread(files, *words)) == (True, True)


def telegram(k, far):
    """Ranges (B,) in mm of SICK's telegram of a scan, from -45 deg in steps of 9, 1 s after the last."""
    head = f"1 1 89A27F 0 0 {k:X} {k:X} {10**6 * k:X} 0 0 0 7 0 0 1388 168 0 1 DIST1 3F800000 00000000 FFF92230 15F90"
    return f"\x02sSN LMDscandata {head} {len(far):X} {' '.join(f'{v:X}' for v in far)} 0 0 0\x03"


def beams(form, head=""):
    """Rows of all angles [deg] and ranges [mm] in a form, those of each scan below a head."""
    return lambda scans: "".join(head + "".join(form.format(a, r) for a, r in scan) for scan in scans)


GRABBED = beams("{:.4f} {:.1f} 47\n", "#RPLIDAR SCAN DATA\n#COUNT=40\n#Angule\tDistance\tQuality\n")


def points(scans):
    """The beams as x, y [m]."""
    return [[(r * math.cos(math.radians(a)) / 1e3, r * math.sin(math.radians(a)) / 1e3) for a, r in s] for s in scans]


@pytest.mark.parametrize(("name", "text", "first"), [
    ("a.txt", beams("{} {}\n"), 0.0), ("a.json", json.dumps, 0.0),
    ("a.json", lambda scans: json.dumps([scan[k % 2 :] for k, scan in enumerate(scans)]), 0.0),
    ("a.json", lambda scans: json.dumps([dict(scan) for scan in scans]), 0.0),
    ("a.json", lambda scans: json.dumps([dict(zip("ar", zip(*s, strict=True), strict=True)) for s in scans])
     .replace('"a"', '"angles"').replace('"r"', '"ranges"'), 0.0),
    ("a.log", lambda scans: "\n".join(str([(15, a, r) for a, r in scan]) for scan in scans), 0.0),
    ("a.txt", beams("  theta: {:.2f} Dist: {:08.2f} Q: 47\n"), -351.0),
    ("a.txt", beams("{},{},9\n", "AngleInDegrees,DistInMM,Intensity\n"), 0.0), ("a", GRABBED, 0.0),
    ("a.json", lambda scans: json.dumps(points(scans)), -171.0),
    ("a", lambda scans: "\n".join(f"{x},{y}" for x, y in points(scans)[0]), -171.0),
    ("a.csv", lambda scans: "angle,distance\n" + beams("{},{}\n")([s[:: (-1) ** k] for k, s in enumerate(scans)]), 0.0),
    ("a.csv", lambda scans: "t,x,y,theta,angle,distance\n" + "".join(
        f"{k},{0.1 * k},0,0,{a},{r}\n" for k, scan in enumerate(scans) for a, r in scan), 0.0),
    ("a.txt", lambda scans: "\n".join(telegram(k, [r for _, r in scan]) for k, scan in enumerate(scans)), -135.0),
])  # fmt: skip
def test_beams_without_names_and_of_well_known_scanners_are_read(convert, tmp_path, name, text, first):
    far = np.random.default_rng(0).integers(1000, 4000, (20, 40))
    scans = [[(9 * i, int(r)) for i, r in enumerate(row)] for row in far]
    files = {name: text(scans)} if "." in name else {f"a/{k}.txt": text([scan]) for k, scan in enumerate(scans)}
    tmp_path.joinpath("a").mkdir()
    log, said = convert(files, "table", name, "out")
    found = log.recorded.scans
    right = {-351.0: far[:, ::-1], -171.0: np.roll(far, 19, axis=1)}.get(first, far) / 1000.0
    assert found.ranges == pytest.approx(np.where(found.ranges > 0.0, right, 0.0))
    assert (found.ranges > 0.0).mean() > 0.98
    assert np.degrees([found.scanner.angle_min, found.scanner.angle_step]) == pytest.approx([first, 9.0])
    assert any(word in said for word in ("inferred: --unit scans.range=mm", "DistInMM", "points", "telegrams of SICK"))
    assert log.recorded.increments.mean[1:, 0] == pytest.approx(0.1 * ("no odometry in it" not in said))


def test_poses_beside_a_distance_are_no_beams(read):
    rows = "".join(f"{k},{np.sin(k / 30)},{-np.cos(k / 30)},{k / 30 % 6.28},{k / 30}\n" for k in range(999))
    assert read({"a.csv": "t,x,y,theta,distance\n" + rows})[0].recorded.scans is None
    places = "t,x,y\n" + "\n".join(",".join(row.split(",")[:3]) for row in rows.split())
    assert read({"a.csv": places, "b.csv": places}, "--fixes", "b.csv", "--prior", "0,0,0")[0].recorded.scans is None


def test_scans_beyond_the_odometry_are_left_out_and_said_and_their_stamps_are_used(read):
    text = "t,range0,range1,range2\n" + "".join(f"{0.5 * k},1,2,3\n" for k in range(-2, 9))
    files = {"odo.csv": "t,x,y,theta\n0,0,0,0\n1,1,0,0\n2,2,0,0\n", "scans.csv": text}
    log, said = read(files, "--scans", "scans.csv", "--scanner=-1deg,1deg,8m")
    assert "6 of 11 scans before or after all odometry, 0 to 2 s, dropped" in said
    assert "not used" not in said
    assert log.recorded.time[log.recorded.scans.frame].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_bars_titles_and_words_for_nothing_are_read(read):
    rows = "".join(f"{k} | {0.5 * k} | -1.5 | 0.25 | 9 | \n" for k in range(5))
    names = " time | px | py | yaw |\tcov[1,1]\n"
    more = f"{names}{rows}{names}9 | None | - | N/A | - | \nTotal | | | | | "
    words = ("--truth", "o.txt", "--columns", "t=time,x=px,y=py,theta=yaw")
    for text, far in ((names + rows, 2.0), (more, 2.0)):
        log, said = read({"o.txt": f"Poses & places, as driven\n{text}"}, *words)
        assert "o.txt: line 1 is a title above the names: Poses & places, as driven" in said
        assert np.hypot(*log.recorded.increments.mean[:, :2].T).sum() == pytest.approx(far)
    prose = "Poses, as driven\nby hand on a Monday: 5 rows\n" + "".join(f"{k} {0.5 * k} 0 0\n" for k in range(5))
    log, said = read({"o.txt": prose}, "--truth", "o.txt", "--columns", "t=1,x=2,y=3,theta=4")
    assert (len(log.recorded), "line 2 is a title above rows without names: by hand on a Monday" in said) == (5, True)


@pytest.mark.parametrize(("text", "words", "wanted"), [
    ("t,a,b\n0,1,2\n1,1,2\n", (), "columns such as range0, range1 are needed"),
    ("t,range0,range1\n0,1,two\n1,1,2\n", ("--scanner", "0,1deg,9"), "'two' is not a number"),
])  # fmt: skip
def test_what_is_no_scan_is_refused(unread, text, words, wanted):
    files = {"odo.csv": "t,x,y,theta\n0,0,0,0\n1,1,0,0\n", "scan.csv": text}
    assert wanted in unread(files, "--scans", "scan.csv", *words)


WHEELS = "time,v,w\n" + "".join(f"{0.1 * k:.1f},1,0\n" for k in range(60))


def test_a_column_for_each_landmark_is_named_with_a_star(read, unread):
    wide = "time,beacon_4,beacon_7\n" + "".join(f"{k},{9 - k},{-1.0 if k % 2 else 5}\n" for k in range(5))
    files, words = {"o.csv": WHEELS, "seen.csv": wide}, ("--observations", "seen.csv", *NOISE)
    log, said = read(files, *words, "--columns", "range=beacon_*")
    seen = log.recorded.observations
    assert log.label.tolist() == [4, 7, 4, 4, 7, 4, 4, 7]
    assert "seen.csv: 2 of 10 observations are at 0 m or less, where nothing was seen: left out" in said
    assert seen.z[log.label == 4, 0] == pytest.approx(9.0 - np.arange(5))
    bare = {"o.csv": "v,w\n" + "1,0\n" * 5, "seen.csv": "\n".join(row.partition(",")[2] for row in wide.splitlines())}
    log, said = read(bare, *words, "--columns", "range=beacon_*", "--period", "0.1s")
    assert log.recorded.observations.frame.tolist() == [0, 0, 1, 2, 2, 3, 4, 4]
    assert (log.label[:3].tolist(), "inferred: each of its 5 rows is one of the odometry" in said) == ([4, 7, 4], True)
    assert read(files, *words, "--columns", "range=2,3")[0].label.tolist() == [1, 2, 1, 1, 2, 1, 1, 2]
    assert "as in --columns range=beacon_*" in unread(files, *words)
    assert "no column b_*" in unread(files, *words, "--columns", "range=b_*")


def test_a_truth_of_places_tells_the_heading_at_the_start(read):
    way = 0.5 * np.maximum(np.arange(60) - 10, 0) * 0.1  # it stands at first
    drive = "t,v,omega\n" + "".join(f"{0.1 * k:.1f},{0.5 * (k >= 10)},0\n" for k in range(60))
    truth = "t,x,y\n" + "".join(f"{0.1 * k:.1f},{-0.6 * s},{0.8 * s}\n" for k, s in enumerate(way))
    fixes = "t,gps_x,gps_y\n" + "".join(f"{k},0,{0.1 * k}\n" for k in range(6))
    files = {"o.csv": drive, "truth.csv": truth, "fixes.csv": fixes}
    log, said = read(files, "--truth", "truth.csv", "--fixes", "fixes.csv", "--fix-sigma", "1,1")
    assert log.recorded.prior.mean == pytest.approx([0, 0, np.arctan2(0.8, -0.6)], abs=1e-6)
    assert log.recorded.prior.covariance[2, 2] == pytest.approx(np.radians(10.0) ** 2)
    assert "the truth has no heading" in said
    places = zip(-0.6 * way + 0.5 * (way > 0.0), 0.8 * way + 0.4 * (way > 0.0), strict=True)  # leap by 0.6 m
    files["truth.csv"] = "t,x,y\n" + "".join(f"{0.1 * k:.1f},{x},{y}\n" for k, (x, y) in enumerate(places))
    prior = read(files, "--truth", "truth.csv")[0].recorded.prior
    off = abs(prior.mean[2] - np.arctan2(0.8, -0.6))
    assert np.radians(10.0) < off < 2.0 * np.sqrt(prior.covariance[2, 2])


def test_ranges_in_one_column_are_as_many_for_each_pose_and_the_scanner_has_a_place(convert, read, unread, tmp_path):
    """Seen: a vector of all ranges was read as scans of one beam, and the place of the scanner was dropped."""
    far = 1.0 + np.arange(60.0).reshape(10, 6)
    words = ("--columns", "x=X_1,y=X_2,theta=X_3,scans.range=Z", "--scanner=-25deg,10deg,70", "--scans", "a.npz")
    for count in (59, 10, 60):
        np.savez(tmp_path / "a.npz", X=np.column_stack([np.arange(10.0), np.zeros((10, 2))]), Z=far.ravel()[:count])
        made = convert({}, "table", "a.npz", "out", *words, "--sensor-pose", "0.5,0,0", status=0 if count == 60 else 2)
        assert count == 60 or f"{count} ranges in one column and 10 poses: how many are a scan?" in made
    seen = made[0].recorded.scans
    assert (seen.ranges.tolist(), seen.scanner.translation) == (far.tolist(), (-0.5, 0.0))
    rows = [f"{k},{r}\n" for k, scan in enumerate(far) for r in scan]
    files = {"o.csv": "t,x,y,theta\n0,0,0,0\n4,1,0,0\n9,2,0,0\n", "s.csv": "t,range\n" + "".join(rows)}
    log, _ = read(files, "--scans", "s.csv", "--scanner", "0,0.1,70")
    assert log.recorded.scans.ranges.tolist() == far.tolist()
    files["s.csv"] = "t,range\n" + "".join([*rows[:5], "1,9\n", *rows[6:]])
    assert "how many are a scan?" in unread(files, "--scans", "s.csv", "--scanner", "0,0.1,70")
    assert "--view -1,1: no observations" in unread(files, "--scans", "s.csv", "--view", "-1,1")


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 0, 1)])
def test_arrays_of_landmarks_their_numbers_and_rows(convert, tmp_path, order):
    z = np.stack([np.full((3, 40), 0.1), np.arange(3.0)[:, None] + np.full((3, 40), 4.0)], axis=1)
    z[1:, :, ::2], z[0, :, 5] = 0.0, np.nan
    savemat(tmp_path / "z.mat", {"z": z.transpose(order), "sigmas": np.ones(3)})
    sigmas = ("--odometry-sigma", "0.05,2deg", "--observation-sigma", "0.1,1deg")
    words = ("table", "o.csv", "out", "--observations", "z.mat", *sigmas)
    log, said = convert({"o.csv": WHEELS}, *words, "--columns", "bearing=z_1,range=z_2")
    assert "in 40 rows; the odometry has 60" in said
    o = log.recorded.observations
    assert log.label[:5].tolist() == [1, 1, 2, 3, 1]
    assert o.z[:5].tolist() == [[far, 0.1] for far in (4.0, 4.0, 5.0, 6.0, 4.0)]
    rows = np.round(10 * log.recorded.time[o.frame])
    assert np.unique(rows, return_counts=True)[1].tolist()[:6] == [1, 3, 1, 3, 1, 2]
    savemat(tmp_path / "z.mat", {"z": np.ones((40, 2, 40))})
    assert "z (40, 2, 40), as in --columns range=z_1,bearing=z_2" in convert({}, *words, status=2)
    assert "which dimension" in convert({}, *words, "--columns", "bearing=z_1,range=z_2", status=2)


def test_arrays_of_one_file_may_end_at_different_rows(convert, tmp_path):
    t = 0.1 * np.arange(200)
    np.savez(tmp_path / "a.npz", to=t, xo=t, yo=0 * t, po=0 * t, tg=t[::20], xg=t[::20], yg=0 * t[::20])
    names = "odometry.t=to,odometry.x=xo,odometry.y=yo,odometry.theta=po,fixes.t=tg,fixes.x=xg,fixes.y=yg"
    log, _ = convert({}, "table", "a.npz", "out", "--fixes", "a.npz", "--prior", "0,0,0", "--prior-sigma", "1,1,1",
                     "--columns", names)  # fmt: skip
    assert log.recorded.fixes.z[:, 0].tolist() == pytest.approx(t[::20])


@pytest.mark.parametrize("seen", [150, 250])
def test_series_of_arrays_have_the_stamps_that_are_as_long(convert, tmp_path, seen):
    l_time, far, vel = np.linspace(0.05, 19.0, seen), np.full((2, seen), 4.0), np.ones((2, 200))
    arrays = {"odom_t": 0.1 * np.arange(200), "vel": vel, "l_time": l_time, "l_dist": far, "l_angle": 0.1 * far}
    savemat(tmp_path / "a.mat", arrays | {"l_dist_var": 0.1, "l_angle_var": 0.1})  # the star is no word beside numbers
    said = convert({}, "table", "a.mat", "out", status=2)
    assert f"odom_t, vel_1, vel_2 (200 rows); l_time, l_dist_1, l_dist_2, l_angle_1, l_angle_2 ({seen} rows)" in said
    for first in ("", "t=odom_t,"):
        names = f"{first}v=vel_1,omega=vel_2,range=l_dist_*,bearing=l_angle_*"
        log, said = convert({}, "table", "a.mat", "out", "--columns", names)
        assert log.recorded.time[log.recorded.observations.frame] == pytest.approx(np.repeat(l_time, 2))
        assert f"--columns observations.t=l_time, the stamps of its {seen} rows" in said
        assert "not used: l_dist_var" in said


def test_observations_within_objects_of_json_also_as_lists_side_by_side(read):
    seen = [[{"id": j, "r": 2.0 + j, "phi": 0.1 * k} for j in range(k % 3)] for k in range(9)]
    rows = [{"t": k, "v": 0.5, "omega": 0.1, "seen": some} for k, some in enumerate(seen)]
    names = "label=seen.id,range=seen.r,bearing=seen.phi,observations.frame=element"
    log, _ = read({"a.json": json.dumps(rows)}, "--columns", names)
    assert log.recorded.observations.z[:, 0] == pytest.approx([2.0, 2.0, 3.0] * 3)
    assert log.label == pytest.approx([0, 0, 1] * 3)
    around = json.dumps({"steps": rows, "made": [{"by": 1}, {"by": 2}]})
    log, _ = read({"b.json": around}, "--columns", names.replace("seen", "steps.seen").replace("=el", "=steps.el"))
    assert (len(log.recorded.observations.z), log.recorded.increments.mean[1, 2]) == (9, pytest.approx(0.1))
    each = ((k, k % 4) for k in range(40))
    seen = [{"t": k, "data": {"ids": [*range(n)], "r": [5.0] * n, "b": [0.1 * k] * n}} for k, n in each]
    text = json.dumps({"odom": [[0.1 * k, 0.5, 0.1] for k in range(500)], "obs": seen})
    log, _ = read({"a.json": text}, "--columns", "range=data.r,bearing=data.b")
    assert log.label[:4].tolist() == [0, 0, 1, 0]
    assert log.recorded.observations.z[:4, 1] == pytest.approx([0.1, 0.2, 0.2, 0.3])


SEEN = [[(j, 2.0 + j, 0.1 * k) for j in range(k % 3)] for k in range(30)]
INSIDE = {
    "tuples": lambda some: str(some), "brackets of numpy": lambda some: str([np.array(one) for one in some]),
    "colons": lambda some: ";".join(f"{j}:{r}:{b}" for j, r, b in some),
}  # fmt: skip


@pytest.mark.parametrize("form", INSIDE)
def test_observations_within_a_field(read, form):
    rows = "".join(f'{k},0.5,0.1,"{INSIDE[form](some)}"\n' for k, some in enumerate(SEEN))
    log, _ = read({"a.csv": f"t,v,w,seen\n{rows}"}, "--columns", "omega=w,label=seen_1,range=seen_2,bearing=seen_3")
    assert log.recorded.observations.z[:, 0] == pytest.approx([2.0, 2.0, 3.0] * 10)
    assert log.recorded.observations.frame == pytest.approx(np.repeat(range(30), [0, 1, 2] * 10))


def test_scans_within_a_field_and_a_list_of_ranges_beside_a_list_of_bearings(read):
    far = np.linspace(1.0, 5.0, 40 * 36).reshape(40, 36)
    rows = [f'{0.1 * k},{0.05 * k},0,0,"{z.tolist()}"\n' for k, z in enumerate(far)]
    log, _ = read({"a.csv": "".join(["t,x,y,theta,ranges\n", *rows])}, "--scans", "a.csv", "--scanner=-180deg,10deg,8m")
    assert log.recorded.scans.ranges == pytest.approx(far)
    rows = [f'{k},0.5,0,"{[2.0, 3.0][: k % 3]}","{[0.1 * k] * (k % 3)}"' for k in range(9)]
    log, _ = read({"a.csv": "t,v,w,r,phi\n" + "\n".join(rows)}, "--columns", "omega=w,range=r,bearing=phi")
    o = log.recorded.observations
    assert o.z[:, 1] == pytest.approx(0.1 * np.repeat(range(9), [0, 1, 2] * 3))
    assert o.frame.tolist() == np.repeat(range(9), [0, 1, 2] * 3).tolist()


def test_a_field_in_quotes_has_several_lines_and_a_stamp_two_columns(read):
    rows = [f'{7 + k // 4},{k % 4 * 250000000},{k},0,0,"[1. 2.\n 3. 4.]"' for k in range(9)]
    text = "time_sec,time_nanosec,x,y,yaw,ranges\n" + "\n".join(rows)
    log, _ = read({"a.csv": text}, "--scans", "a.csv", "--scanner=0deg,90deg,8m", "--columns", "t=time_sec")
    assert log.recorded.time == pytest.approx(7.0 + 0.25 * np.arange(9))
    text = text.replace("time_sec", "whole").replace("time_nanosec", "part")
    columns = ("--columns", "t=whole+part")
    same, _ = read({"a.csv": text}, "--scans", "a.csv", "--scanner=0deg,90deg,8m", *columns)
    assert same.recorded.time == pytest.approx(log.recorded.time)
    assert log.recorded.scans.ranges == pytest.approx(np.tile([1.0, 2.0, 3.0, 4.0], (9, 1)))


def test_beams_at_unequal_angles_and_columns_in_another_order(convert, tmp_path):
    savemat(tmp_path / "a.mat", {"X": np.zeros((9, 3)), **{f"s_{k}": np.full(9, float(k)) for k in (3, 1, 4, 2)}})
    words = ("--columns", "x=X_1,y=X_2,theta=X_3,scans.range=s_1", "--scanner=-90deg,-50deg,-30deg,10deg,5m")
    scans = convert({}, "table", "a.mat", "out", "--scans", "a.mat", *words)[0].recorded.scans
    turn = scans.scanner.angle_min + scans.scanner.angle_step * np.flatnonzero(scans.ranges[0])
    assert np.rad2deg(turn) == pytest.approx([-90.0, -50.0, -30.0, 10.0])
    assert scans.ranges[0, scans.ranges[0] > 0.0].tolist() == [1.0, 2.0, 3.0, 4.0]


def test_cells_of_an_array_made_too_long_and_lists_behind_tabs(convert, tmp_path):
    savemat(tmp_path / "a.mat", {"u": cell(*([[0.5], [0.1]] for _ in range(9)), [], []), "dt": np.full(9, 0.2)})
    log, _ = convert({}, "table", "a.mat", "out", "--truth", "a.mat", "--columns", "v=u_1,omega=u_2,x=dt,y=dt,theta=dt")
    assert log.recorded.increments.mean[:, 2].sum() == pytest.approx(0.16)
    text = "pose,ir\n" + "".join(f"[ 0.5  0.0  0.1],\t[ {k}.5  1.5  2.5 3.5]\n" for k in range(9))
    words = ("--scans", "b.csv", "--scanner=0deg,90deg,90deg,-90deg,9m", "--columns")
    names = "dx=pose_1,dy=pose_2,dtheta=pose_3,scans.range=ir_1"
    log, _ = convert({"b.csv": text}, "table", "b.csv", "out", *words, names)
    assert log.recorded.scans.ranges[2] == pytest.approx([3.5, 2.5, 1.5]), "of two beams at one angle the first"


def test_true_poses_name_their_row_of_the_odometry_and_rates_hold_backward(read):
    odometry = "t,left,right\n" + "".join(f"{k},{k},{k}\n" for k in range(9))
    truth = "pose_id,x,y,theta\n" + "".join(f"{k},{k * (k + 1) / 2},0,0\n" for k in (8, 6, 4, 2, 0))
    wheels = ("--ticks", "rate", "--hold", "backward", "--track-width", "1", "--metres-per-tick", "1")
    seen = ("--observations", "z.csv", "--truth", "b.csv")
    log, _ = read({"a.csv": odometry, "b.csv": truth, "z.csv": "t,range,bearing\n1,1,0\n"}, *wheels, *seen)
    assert log.truth.pose[::2, 0] == pytest.approx([0.0, 3.0, 10.0, 21.0, 36.0])
    assert np.cumsum(log.recorded.increments.mean[:, 0])[::2] == pytest.approx(log.truth.pose[::2, 0])


def test_without_ids_landmarks_of_a_map_count_from_1_if_the_last_label_is_their_number(read):
    odometry = "t,v,omega,range,bearing,label\n" + "".join(f"{k},0,0,2,0,{1 + k % 3}\n" for k in range(9))
    start = ("--map", "m.csv", "--prior", "0,0,0", "--prior-sigma", "1,1,1")
    log, said = read({"a.csv": odometry, "m.csv": "x,y\n2,0\n4,1\n5,5\n"}, *start)
    assert log.recorded.map.id.tolist() == [1, 2, 3]
    assert "inferred: landmarks of the map count from 1, as 3 is the last label" in said
    assert "not used" not in said


@pytest.mark.parametrize("of", ["header.stamp.", ""])
def test_seconds_and_nanoseconds_beside_ranges_in_one_field(read, of):
    """Seen: without words before them, nanoseconds were also behind the point of other columns of whole numbers."""
    names = f"{'time' if of else 'day'},{of}secs,{of}nsecs"
    stamps = [f"2020/01/01,{k // 10},{k % 10}00000000" for k in range(12)]
    rows = "".join(f"{t},{0.1 * k},0,0\n" for k, t in enumerate(stamps))
    odometry = f"{names},position.x,position.y,pose.theta\n{rows}"
    seen = f"{names},angle_min,angle_max,angle_increment,range_min,range_max,ranges\n"
    seen += "".join(f'{t},0,2,1,0.1,9,"({4 - 0.1 * k}, inf, 3.0)"\n' for k, t in enumerate(stamps))
    words = ("--columns", f"theta=pose.theta,t={of[:-1] or 'secs'}")
    log, _ = read({"o.csv": odometry, "s.csv": seen}, "--scans", "s.csv", *words)
    assert log.recorded.time == pytest.approx(0.1 * np.arange(12))
    assert not log.recorded.increments.mean[:, 1:].any()
    ranges = pytest.approx(np.array([4 - 0.1 * np.arange(12), [0.0] * 12, [3.0] * 12]))
    assert ranges == log.recorded.scans.ranges.T
    counts = "t,x,y,theta\n" + "".join(f"{1000 * k},{0.1 * k},0,0\n" for k in range(12))
    seen = "t,r1,r2,r3\n" + "".join(f"{1000 * k},{400 - 10 * k},inf,300\n" for k in range(12))
    words = ("--columns", "scans.range=r1", "--scanner", "0,1,9", "--unit", "time=0.1ms,range=cm")
    log, _ = read({"o.csv": counts, "s.csv": seen}, "--scans", "s.csv", *words)
    assert (log.recorded.time[-1], ranges) == (pytest.approx(1.1), log.recorded.scans.ranges.T)


def test_speeds_of_wheels_and_ranges_alone(read):
    drive = "t,l,r\n" + "".join(f"{0.5 * k},{2 + k % 2},{4 + k % 2}\n" for k in range(9))
    seen = "t,range,landmark_id\n" + "".join(f"{k},3,8\n" for k in range(5))
    words = ("--columns", "left=l,right=r", "--ticks", "rate", "--metres-per-tick", "0.1", "--track-width", "0.5")
    log, said = read({"o.csv": drive, "s.csv": seen}, "--observations", "s.csv", *words)
    assert log.recorded.increments.mean[1:, 2] == pytest.approx(0.4)
    assert np.hypot(*log.recorded.increments.mean[1:, :2].T) == pytest.approx(0.35, rel=0.01)
    assert "- assumed: --observation-sigma 10cm\n" in said
    assert log.label.tolist() == [8] * 5


def test_odometry_and_truth_in_one_row_of_several_runs(convert, unread):
    rows = [f"{r},{k},{0.5 * r * k},0,0,{0.5 * r},0,{9 - k},0.2" for r in (1, 2) for k in range(9)]
    text = "\n".join(["run,t,x,y,theta,v,omega,range,bearing", *rows]) + "\n"
    runs = "stamps begin anew; 2 runs begin, in lines 2, 11: name one, as in a.csv:run=1"
    assert runs in unread({"a.csv": text})
    log, _ = convert({"a.csv": text}, "table", "a.csv:run=2", "out", "--truth", "a.csv:run=2")
    assert (len(log.recorded.observations.z), log.recorded.increments.mean[1, 0]) == (9, pytest.approx(1.0))
    assert log.truth.pose[:, 0] == pytest.approx(np.arange(9))
    bare = text.replace(",range,bearing", ",distance_m,way")  # names that nobody states are no observations
    log, said = convert({"b.csv": bare}, "table", "b.csv:run=1", "out", "--truth", "b.csv:run=1")
    assert (len(log.recorded), len(log.recorded.observations.z)) == (9, 0), "a frame for each row"
    assert "without observations; if it has some, name them as in --columns range=DIST" in said
    assert "odometry is v and omega" in convert({"a.csv": text}, "table", "a.csv:run=1", "out")[1]
    alone = {"c.csv": WHEELS, "d.csv": WHEELS.replace(",1,", ",1,8,").replace("v,", "v,hall,")}
    assert "--frames odometry" in unread({"d.csv": alone["d.csv"]})
    for name, words in (("c.csv", ()), ("d.csv", ("--frames", "odometry"))):
        assert len(convert(alone, "table", name, "out", *words)[0].recorded) == 60


def cell(*items):
    made = np.empty((len(items), 1), object)
    made[:, 0] = items
    return made


def test_structs_matrices_and_cells_within_arrays_are_rows(convert, tmp_path):
    """As many landmarks as a step has; a field named time holds the time between steps, as it does not ascend. Steps
    between poses; numbers of poses count from 1.
    """
    seen = [np.array([[40.0 - k, 2.0][: 1 + k % 2], [0.5, 0.1][: 1 + k % 2], [7, 9][: 1 + k % 2]]) for k in range(30)]
    steps = [{"speed": [[0.5], [0.1]], "marks": z, "time": 0.1 + 0.02 * (k % 2)} for k, z in enumerate(seen)]
    savemat(tmp_path / "a.mat", {"d": steps})
    named = "v=speed_1,omega=speed_2,x=marks_1,y=marks_2,label=marks_3"
    log, said = convert({}, "table", "a.mat", "out", "--columns", named)
    o = log.recorded.observations
    assert log.recorded.time[:4] == pytest.approx([0.0, 0.1, 0.22, 0.32])
    assert (o.frame[:6].tolist(), log.label[:6].tolist()) == ([0, 1, 1, 2, 3, 3], [7, 7, 9, 7, 7, 9])
    assert o.z[[0, 2]] == pytest.approx(np.array([[40.0, 0.5], [2.0, 0.1]]))
    assert "inferred: --columns odometry.dt=time, as time does not ascend" in said
    odometry, truth = np.array([[0.5], [0.0], [0.1]]).repeat(40, axis=1), np.zeros((3, 41))
    z = cell(*([[5.0, 4.0][: k % 3], [0.1, 0.2][: k % 3]] for k in range(40)))
    savemat(tmp_path / "b.mat", {"odo": odometry, "gt": truth, "z": z})
    steps = "dx=odo_1,dy=odo_2,dtheta=odo_3"
    true = ("--truth", "b.mat", "--columns", "truth.x=gt_1,truth.y=gt_2,truth.theta=gt_3")
    log, _ = convert({}, "table", "b.mat", "out", "--columns", f"{steps},range=z_1,bearing=z_2", *true)
    assert (len(log.recorded), len(log.recorded.observations.z)) == (41, 39)
    assert log.recorded.observations.frame[:4].tolist() == [1, 2, 2, 4]
    seen = [{"pose_id": k, "seen": [{"id": 8 + j, "p": [[4.0], [j]]} for j in range(1 + k % 2)]} for k in range(2, 42)]
    moves = [{"from_id": k, "to_id": k + 1, "v": [[0.5], [0.0], [0.1]]} for k in range(1, 41)]
    savemat(tmp_path / "b.mat", {"d": {"gt": truth, "obs": seen, "moves": moves}})
    named = steps.replace("odo", "moves.v") + ",x=obs.seen.p_1,y=obs.seen.p_2,label=obs.seen.id"
    log, said = convert({}, "table", "b.mat", "out", "--columns", named, *true)
    o = log.recorded.observations
    assert (len(log.recorded), o.frame[:4].tolist(), log.label[:4].tolist()) == (41, [1, 2, 2, 3], [8, 8, 9, 8])
    assert "inferred: frame counts from 1, as 41 is its last" in said
    one = "dx=v_1,dy=v_2,dtheta=v_3,x=seen.p_1,y=seen.p_2,label=seen.id"  # by the structs' own names
    same, _ = convert({}, "table", "b.mat:moves", "out", "--observations", "b.mat:obs", "--columns", one, *true)
    assert same.recorded.observations.frame.tolist() == o.frame.tolist()


def test_true_poses_at_one_stamp_are_one_where_they_are_alike(read, unread):
    odometry = "t,v,omega,range,bearing\n" + "".join(f"{k},0.5,0,{9 - k},0.2\n" for k in range(9))
    true = ["time,px,py,yaw", *(f"{k},{0.5 * k},0,0" for k in range(9))]
    files = {"o.csv": odometry, "gt.csv": "\n".join([*true[:2], "0,1e-7,0,0", *true[2:]]) + "\n"}
    names = ("--truth", "gt.csv", "--columns", "truth.x=px,truth.y=py")
    log, said = read(files, *names)
    assert log.truth.pose[:, 0] == pytest.approx(0.5 * np.arange(9), abs=1e-6)
    assert "gt.csv: 1 of 10 true poses share their stamp with the next one, which is used" in said
    told = unread(files | {"gt.csv": "\n".join([*true[:2], "0,7,0,0", *true[2:]]) + "\n"}, *names)
    assert "gt.csv:3: column time (truth.t): the stamp of the row before, whose true place is 7 m off" in told
    back = unread(files | {"gt.csv": "\n".join([*true[:4], "1.5,1,0,0", *true[4:]]) + "\n"}, *names)
    assert "gt.csv:5: column time (truth.t): 1.5 follows 2.0; t must not decrease" in back


def test_topics_as_columns_of_sparse_rows_with_dates(convert, unread):
    """Each part takes the rows that have it; some rows end before the header."""
    head = "stamp,/odom/v,/odom/omega,/odom/pose/x,/scan/range,/scan/bearing,/mocap/pose/x,/mocap/pose/y"
    rows = [(10 * k, f"0.5,0,{k}") for k in range(9)] + [(10 * k + 2, f",,,{9 - 0.5 * k},0.2,,") for k in range(8)]
    rows += [(5 * k + 1, f",,,,,{0.025 * k},0") for k in range(17)]
    lines = [f"2024-05-01T12:00:{k / 10:04.1f}Z,{row}" for k, row in sorted(rows)]
    files = {"rec.csv": "\n".join([head, *lines]) + "\n"}
    assert "topics /odom, /mocap, as in rec.csv:/odom" in unread(files)
    words = ("--observations", "rec.csv:/scan", "--truth", "rec.csv:/mocap")
    log, said = convert(files, "table", "rec.csv:/odom", "out", *words, "--prior", "0,0,0", "--prior-sigma", "0,0,0")
    assert log.recorded.observations.z[:, 0] == pytest.approx(9.0 - 0.5 * np.arange(8))
    seen = np.unique(log.recorded.observations.frame)
    assert log.truth.pose[seen, 0] == pytest.approx(0.005 + 0.05 * np.arange(8), abs=1e-6)
    assert log.recorded.increments.mean[1:, 0].sum() == pytest.approx(0.5 * np.ptp(log.recorded.time))
    assert "is a date" in said


def test_rows_that_end_before_the_header_are_blank_there(read, unread):
    rows = [f"{k},0.5,0,{9 - k},0.2" + ",7,8" * (k % 3 == 0) for k in range(9)]
    log, said = read({"o.csv": "\n".join(["t,v,omega,range,bearing,mode,more", *rows]) + "\n"})
    assert len(log.recorded.observations.z) == 9
    assert "o.csv: 6 of 9 rows end before the header does: their last columns are blank" in said
    one = [row if k == 4 else row.removesuffix(",7,8") + ",7,8" for k, row in enumerate(rows)]
    assert "5 fields where 7 are needed" in unread({"o.csv": "\n".join(["t,v,omega,range,bearing,mode,more", *one])})


def test_lines_of_keys_are_rows_by_their_order(convert, read):
    """Observations are of the odometry above them; one more key begins a row, the first key a block."""
    lines = [f"odom: {0.5 * k} 0 0\n" + "".join(f"seen: {9 - k} {j}\n" for j in range(k % 3)) for k in range(9)]
    columns = "odometry.x=1,odometry.y=2,odometry.theta=3,observations.x=1,observations.y=2"
    words = ("--observations", "in.txt:seen", "--columns", columns)
    for name in ("in.txt:odom", "in.txt:odom:"):
        log, said = convert({"in.txt": "".join(lines)}, "table", name, "out", *words)
        seen = log.recorded.observations
        assert (len(log.recorded), seen.frame[:4].tolist()) == (9, [1, 2, 2, 4])
        assert seen.z[:3] == pytest.approx(np.array([[8.0, 0.0], [7.0, 0.0], [7.0, 1.0]]))
        assert "inferred: frame, of the row of odometry above" in said
    one = "id:{}\nx:{}\ny:0.5\n"
    blocks = [f"obs:{k}\ntime:{k}\n{one.format(4, 9 - k)}{one.format(7, 5)}\n" for k in range(6)]
    log, _ = read({"o.csv": WHEELS, "s.txt": "".join(blocks)}, "--observations", "s.txt", "--columns", "label=id")
    assert log.label.tolist() == [4, 7] * 6
    assert log.recorded.observations.z[::2, 0] == pytest.approx(9.0 - np.arange(6))
    text = "#made: 1 2\n\tat: [0, 0, 1],\n" + "".join(f"t: {k}.5 pose[2]: {k} true_pose: {k} 0 0\n" for k in range(9))
    log, _ = read({"o.csv": text.replace("pose[2]: ", "step: 1 ")}, "--columns", "dx=step_1,dtheta=step_2")
    assert log.truth.pose[:, 0].tolist() == [*range(9)], "several numbers behind a key, below titles"


def test_rows_of_any_number_of_observations_are_rows_of_one(read, unread):
    """The landmarks stand still along the way, which tells what the three numbers are."""
    rows, places = [], np.array([[3.0, 4.0], [8.0, -2.0], [1.0, 6.0]])
    for k in range(60):
        turn = 0.03 * k  # on a circle
        off = (places - [np.sin(turn) / 0.3, (1.0 - np.cos(turn)) / 0.3])[: k % 4]
        far, to = np.hypot(*off.T), np.arctan2(off[:, 1], off[:, 0]) - turn
        rows.append(" ".join([f"{0.1 * k:.1f}", *(f"{j} {r:.6f} {b:.6f}" for j, (r, b) in enumerate(zip(far, to)))]))
    files = {"o.csv": WHEELS.replace(",1,0", ",1,0.3"), "s.txt": "\n".join(rows) + "\n"}
    log, said = read(files, "--observations", "s.txt")
    o = log.recorded.observations
    assert (len(o.z), log.label[:4].tolist()) == (90, [0, 0, 1, 0])
    assert o.z[0] == pytest.approx([np.hypot(2.9, 4.0), np.arctan2(4.0, 2.9) - 0.03], abs=2e-3)
    assert "inferred: a row is a stamp and any number of observations of 3 numbers each" in said
    files["s.txt"] = files["s.txt"].replace(rows[5], rows[5] + " 7")
    assert "a row for each is needed" in unread(files, "--observations", "s.txt")


@pytest.mark.parametrize("form", ["cells", "its transpose", "lists"])
def test_cells_by_row_are_lines_of_words_and_numbers(convert, tmp_path, form):
    rows = [row for k in range(40) for row in (["odom", k, 0.5, 0.1], ["lm", k, 9.0 - 0.1 * k, 0.2])]
    made = np.array([[np.array(f) for f in row] for row in rows], object)
    savemat(tmp_path / "a.mat", {"log": made.T if form == "its transpose" else made})
    file, named = "a.json" if form == "lists" else "a.mat", "odometry.t=2,v=3,omega=4,range=3,bearing=4"
    log, _ = convert({"a.json": json.dumps(rows)}, "table", file, "out", "--columns", named)
    assert log.recorded.observations.z[:, 0] == pytest.approx(9.0 - 0.1 * np.arange(40))

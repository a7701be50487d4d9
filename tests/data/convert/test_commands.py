"""The converter's command line: what it writes and says, that each flag does what it says, and no folder is told."""

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from data.command import portable, without_places
from data.convert.__main__ import main
from data.convert.kinds import CALIBRATION
from data.errors import DataError
from data.formats.mrclam import FROZEN, Calibration, Treatment, load_mrclam
from data.formats.open_log import load_folder
from data.logs import Reading
from tests.builders.logs import same
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.world import exchange, replace_row, save_folder, save_zip
from tests.data.formats.recordings.ros.bags import FORMS, Maker
from tests.quick import slow
from tests.wings.laser.formats.carmen_text import SMALL


@pytest.fixture
def source(tmp_path):
    return save_folder(tmp_path / "MRCLAM_Dataset77", world.texts())


@pytest.fixture
def convert(source, tmp_path):
    """`convert(*flags)`: the log that comes out of robot 1 of the small dataset."""

    def run(*flags):
        assert main(["mrclam", str(source), str(tmp_path / "out"), "--robot", "1", *flags]) == 0
        return load_folder(tmp_path / "out")

    return run


def test_corrected_landmarks_beside_a_dataset_are_taken_and_said(source, convert, tmp_path, capsys):
    survey = world.texts()["Landmark_Groundtruth.dat"]
    corrected = tmp_path / "Landmark_Groundtruth.corrected.dat"
    corrected.write_text(exchange(survey, 11, 17))
    published, log = load_mrclam(source, 1).recorded.map, convert()
    assert published is not None
    assert log.recorded.map is not None
    swapped = published.xy[[published.id.tolist().index({11: 17, 17: 11}.get(n, n)) for n in published.id.tolist()]]
    assert log.recorded.map.xy.tolist() == swapped.tolist()
    assert log.source["landmarks"] == corrected.name
    assert f"Landmarks are read from {corrected.name} beside the dataset" in capsys.readouterr().out
    shutil.rmtree(tmp_path / "out")
    given = convert("--landmarks", str(source / "Landmark_Groundtruth.dat")).recorded.map
    assert given is not None
    assert given.xy.tolist() == published.xy.tolist()
    assert "Landmarks are read" not in capsys.readouterr().out


class TestMrclam:
    def test_the_folder_holds_the_loaders_log_under_its_own_name(self, source, convert):
        log = convert()
        assert log.name == "out"
        assert same(log, load_mrclam(source, 1))
        assert log.source["file"] == source.name
        assert log.labels_are_sensed

    def test_window_truth_and_prior_flags_reach_the_loader(self, source, convert, tmp_path):
        other = tmp_path / "places.dat"
        other.write_text("6 1.0 2.0 0 0\n20 3.0 4.0 0 0\n")
        log = convert(
            "--start", "2", "--stop", "9", "--exclude-truth", "4:5", "--exclude-truth", "6:6.5",
            "--landmarks", str(other), "--prior-sigma", "0.2", "0.1",
        )  # fmt: skip
        wanted = load_mrclam(source, 1, Treatment(2.0, 9.0, other, [(4.0, 5.0), (6.0, 6.5)], prior_sigma=(0.2, 0.1)))
        assert same(log, wanted)
        assert (log.notes, log.recorded.sensor) == (wanted.notes, wanted.recorded.sensor)
        assert log.recorded.map is not None
        assert log.recorded.map.id.tolist() == [6, 20]
        assert log.source["exclude_truth"] == [[4.0, 5.0], [6.0, 6.5]]

    @pytest.mark.parametrize("name", sorted(CALIBRATION))
    def test_each_number_of_the_calibration_has_a_flag(self, convert, name):
        flag = name.replace("_", "-")
        if isinstance(getattr(FROZEN, name), bool):
            value: float = not getattr(FROZEN, name)
            log = convert(f"--{flag}" if value else f"--no-{flag}")
        else:
            value = 0.25 if name != "turn_limit" else 0.15
            log = convert(f"--{flag}", str(value))
        written = log.source["calibration"]
        assert isinstance(written, dict)
        assert written[name] == value
        others = {n: written[n] for n in CALIBRATION if n != name}
        assert others == {n: getattr(FROZEN, n) for n in others}
        assert not same(log, convert())

    def test_every_number_of_the_calibration_is_covered(self):
        assert set(CALIBRATION) == {f.name for f in fields(Calibration)} - {"motion"}

    @pytest.mark.parametrize(("flags", "why"), [
        (["--sigma", "1", "1", "--sigma-range", "1"], "--sigma and --sigma-range contradict"),
        (["--motion-noise", "displacement"], "--motion-noise displacement needs --motion-alphas"),
        (["--motion-noise", "density", "--motion-alphas", "1", "1", "1", "1"], "--motion-alphas does not go with"),
        (["--motion-noise", "displacement", "--motion-alphas", *"111111"], "takes 4 numbers, not 6"),
        (["--range-scale", "0"], "range_scale"), (["--landmarks", "nowhere.dat"], "nowhere.dat"),
    ])  # fmt: skip
    def test_a_senseless_combination_is_one_line_and_status_2(self, source, tmp_path, refused, flags, why):
        assert why in refused(main, ["mrclam", str(source), str(tmp_path / "out"), "--robot", "1", *flags])
        assert not (tmp_path / "out").exists()

    def test_bad_data_is_one_line_and_leaves_the_older_log(self, source, convert, tmp_path, refused):
        before = convert()
        name = "Robot1_Odometry.dat"
        text, line = replace_row((source / name).read_text(), 3, "1 2")
        (source / name).write_text(text)
        assert f"{name}:{line}" in refused(main, ["mrclam", str(source), str(tmp_path / "out"), "--robot", "1"])
        assert same(load_folder(tmp_path / "out"), before)


class TestTheOthers:
    def test_victoria_park(self, tmp_path):
        assert main(["victoria-park", str(tmp_path / "park")]) == 0
        log = load_folder(tmp_path / "park")
        assert (log.name, len(log.recorded), len(log.recorded.observations.z)) == ("park", 6969, 3640)
        assert log.recorded.time_is_index


@pytest.mark.parametrize("words", [
    ["mrclam", "a", "b", "--robot", "one"], ["mrclam", "a", "b", "--robot", "1", "--exclude-truth", "5:4"],
    ["mrclam", "a", "b", "--robot", "1", "--star", "1"], ["arena", "a", "--seed", "-1"], [],
])  # fmt: skip
def test_wrong_usage_is_one_line_and_status_2(words, refused):
    refused(main, words)


def test_each_flag_of_a_lab_recording_says_how_its_camera_is_read(monkeypatch, tmp_path):
    asked = []

    def opened(source, reading, say):
        asked.append((source, reading))
        raise DataError(f"{source}: read no further")

    monkeypatch.setattr("wings.camera.opening.open_lab_log", opened)
    words = ["lab", str(tmp_path), str(tmp_path / "out")]
    flags = ["--camera-translation", "mm", "--camera-reading", "to-body", "--corner-noise", "depth", "--trust-pickle"]
    assert main(words) == 2
    assert main([*words, *flags]) == 2
    assert asked == [
        (tmp_path, Reading("cm", "to-camera", "lab", trust_pickle=False)),
        (tmp_path, Reading("mm", "to-body", "depth", trust_pickle=True)),
    ]


ODOMETRY = "t,v,omega\n" + "".join(f"{k},1,0.1\n" for k in range(5))
SEEN = "t,range,bearing\n1,3,0.5\n2,2.5,0.6\n3,2,0.7\n"
SIGMAS = ("--odometry-sigma", ".05,.02", "--observation-sigma", ".1,1deg")
G2O = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0.1
VERTEX_XY 2 1 1
FIX 0
EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 1000
EDGE_SE2_XY 1 2 0.1 0.9 50 0 50
"""


def table(folder):
    (folder / "odo.csv").write_text(ODOMETRY)
    (folder / "seen.csv").write_text(SEEN)
    return ["table", str(folder / "odo.csv"), "--observations", str(folder / "seen.csv"), *SIGMAS]


def carmen(folder):
    (folder / "small.log").write_text(SMALL)
    (folder / "small.relations.csv").write_text("row1,row2,x,y,theta\n0,2,0.1,0.2,0.3\n")
    return ["carmen", str(folder / "small.log")]


def graph(folder):
    (folder / "small.g2o").write_text(G2O)
    return ["g2o", str(folder / "small.g2o")]


def mrclam(folder):
    source = save_folder(folder / "MRCLAM_Dataset77", world.texts())
    other = shutil.copy(source / "Landmark_Groundtruth.dat", folder / "corrected.dat")
    return ["mrclam", str(source), "--robot", "1", "--landmarks", str(other)]


def zipped(folder):
    return ["mrclam", str(save_zip(folder / "MRCLAM_Dataset77.zip", world.texts())), "--robot", "1"]


def bag(folder, form):
    recording = Maker(form)
    recording.drive(np.arange(0.0, 2.0, 0.1))
    for k in range(4):
        recording.scan(0.2 + 0.4 * k, [2.0, 2.5, 3.0])
    return ["rosbag", str(recording.save(folder))]


SOURCES: dict[str, Callable[[Path], list[str]]] = {
    "table": table,
    "carmen": carmen,
    "g2o": graph,
    "mrclam": mrclam,
    "mrclam zip": zipped,
    **{form: lambda folder, form=form: bag(folder, form) for form in FORMS},  # type: ignore[misc]
}


@pytest.mark.parametrize("kind", [kind if kind in ("carmen", "mrclam", "g2o") else slow(kind) for kind in SOURCES])
def test_a_converted_log_has_the_same_bytes_from_another_folder(kind, tmp_path):
    made = []
    for place in ("here", "some/where/else"):
        folder = tmp_path / place
        folder.mkdir(parents=True)
        first = made[0] if made else None
        words = SOURCES[kind](folder)
        if first is not None and kind in FORMS:  # writers of bags put the time into them
            shutil.rmtree(folder)
            shutil.copytree(tmp_path / "here", folder)
        out = tmp_path / f"out{len(made)}" / "log"
        assert main([words[0], words[1], str(out), *words[2:]]) == 0
        made.append(out)
        for file in out.iterdir():
            assert str(tmp_path).encode() not in file.read_bytes()
    one, two = ({f.name: f.read_bytes() for f in out.iterdir()} for out in made)
    assert one == two
    source = load_folder(made[0]).source
    stated = source.get("file", source.get("odometry"))
    assert stated in {p.name for p in (tmp_path / "here").iterdir()}


def test_the_digest_is_that_of_the_file(tmp_path):
    words = table(tmp_path)
    assert main([*words[:2], str(tmp_path / "log"), *words[2:]]) == 0
    source = load_folder(tmp_path / "log").source
    assert source["observations"] == "seen.csv"
    assert source["observations_sha256"] == hashlib.sha256(SEEN.encode()).hexdigest()


def test_words_of_a_command_keep_names_and_lose_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = str(tmp_path)
    assert [portable(w) for w in (f"{here}/logs/a", "/else/where/b", "mine=/x/own.py:Mine", "--out=/x/y/r", here)] == [
        "logs/a", "b", "mine=own.py:Mine", "--out=r", ".",
    ]  # fmt: skip
    kept = ["tcp://host:8786", "arena:0", "../b", "ekf,batch", "t=stamp,v=speed", "0.5"]
    assert [portable(w) for w in kept] == kept
    text = f"report: /x/y/r/report.html; {here}/logs/a; scans of /scan at 3 m/s; / alone"
    assert without_places(text, ["--out=/x/y/r"]) == "report: r/report.html; logs/a; scans of /scan at 3 m/s; / alone"

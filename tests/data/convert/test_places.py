"""A log that is handed on does not say where its source lay: name and digest, and the same bytes from anywhere."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from data.command import portable, without_places
from data.convert.__main__ import main
from data.formats.open_log.reader import load_folder
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.world import save_folder, save_zip
from tests.data.formats.recordings.ros.bags import FORMS, Maker
from tests.quick import slow
from tests.wings.laser.formats.carmen_text import SMALL

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

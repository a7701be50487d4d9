"""A copy of an input for its maintainers: smaller, with the same notices, without places, stamps and names."""

import re
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from data.formats.g2o import log_of, read_graph
from data.formats.open_log import write_folder
from data.logs import open_log
from data.questions.asked import ask
from data.se2 import compose, transform_points
from eval.inspect import problem
from eval.report import problem as module
from tests.data.formats.test_recognize import circle

FAR = 5e5


@pytest.fixture(autouse=True)
def few_tries(monkeypatch):
    monkeypatch.setattr(module, "TRIES", 16)


def opened(path, folder):
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    texts = {f.name: f.read_text() for f in folder.rglob("*") if f.is_file()}
    assert not any(word in text for text in texts.values() for word in ("secret", str(folder), "tmp"))
    numbers = [float(n) for name in texts if name.endswith(".csv") for n in re.findall(r"-?\d+\.\d+", texts[name])]
    assert max(map(abs, numbers)) < 0.1 * FAR
    return texts


def test_a_log_keeps_what_its_notice_needs(tmp_path):
    log, T = open_log("arena:3"), np.array([FAR, -FAR, 1.0])
    r, o = log.recorded, log.recorded.observations
    mirrored = replace(
        r, time=r.time + 1.5e9, prior=replace(r.prior, mean=compose(T, r.prior.mean)),
        observations=replace(o, z=o.z * [1.0, -1.0]), map=replace(r.map, xy=transform_points(T, r.map.xy)),
    )  # fmt: skip
    truth = replace(log.truth, pose=compose(T, log.truth.pose), landmarks=None)
    write_folder(replace(log, recorded=mirrored, truth=truth, notes=("A secret.",)), tmp_path / "secret")
    assert problem([str(tmp_path / "secret"), "--out", str(tmp_path / "p.zip")]) == 0
    opened(tmp_path / "p.zip", tmp_path / "copy")
    copy = open_log(tmp_path / "copy" / "log")
    assert "contradiction" in {n.code for n in ask(copy)}
    assert len(copy.recorded) == 16
    assert len(copy.recorded.observations.z) < 0.6 * len(o.z)


def test_an_estimate_keeps_the_poses_that_its_question_needs(tmp_path, capsys):
    t = 1.7e9 + 0.1 * np.arange(300.0)
    truth = np.column_stack([FAR + 9.0 * np.cos(0.02 * np.arange(300.0)), FAR + np.sin(0.04 * np.arange(300.0)), 0 * t])
    for name, pose in (("secret_truth.csv", truth), ("secret.csv", truth - [FAR - 40.0, FAR - 40.0, 0.0])):
        rows = np.column_stack([t, pose])
        np.savetxt(tmp_path / name, rows, delimiter=",", header="t,x,y,theta", comments="", fmt="%.6f")
    files = [str(tmp_path / name) for name in ("secret.csv", "secret_truth.csv")]
    assert problem([*files, "--out", str(tmp_path / "p.zip")]) == 0
    texts = opened(tmp_path / "p.zip", tmp_path / "copy")
    assert "warning path-frame: estimate.csv lies" in texts["README.txt"]
    assert 20 <= texts["estimate.csv"].count("\n") <= 160
    assert "300 rows" in capsys.readouterr().out


def test_a_graph_without_a_notice_is_kept_whole(tmp_path):
    circle(tmp_path / "secret.g2o", "true", frames=30)
    whole = log_of("g", read_graph(tmp_path / "secret.g2o"))
    assert problem([str(tmp_path / "secret.g2o"), "--out", str(tmp_path / "p.zip")]) == 0
    opened(tmp_path / "p.zip", tmp_path / "copy")
    copy = open_log(tmp_path / "copy" / "log").recorded
    np.testing.assert_allclose(copy.increments.mean, whole.recorded.increments.mean)
    assert len(copy.observations.z) == len(whole.recorded.observations.z)

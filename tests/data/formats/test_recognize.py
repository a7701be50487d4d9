"""What is no log yet: the command is said that makes one of it, and it does."""

from __future__ import annotations

import shlex

import numpy as np
from scipy.io import savemat

from data.convert.__main__ import main as convert
from data.formats.recognize import door, what_to_type
from eval.inspect import main
from tests.data.formats.mrclam import world


def commands(text):
    """The words after the name of each command in a text."""
    return [shlex.split(line)[2:] for line in text.splitlines() if line.startswith("  slamref ")]


def test_the_line_said_of_an_mrclam_folder_makes_a_log_that_is_then_inspected(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = world.save_folder(tmp_path / "my set", world.texts())
    assert main([str(source)]) == 0
    said = capsys.readouterr().out
    assert "UTIAS MRCLAM dataset, robot" in said
    arguments = commands(said)[0]
    assert arguments[:2] == ["mrclam", str(source)]
    assert convert(arguments) == 0
    capsys.readouterr()
    assert main([arguments[2]]) == 0
    assert "frames" in capsys.readouterr().out
    assert door(arguments[2]) is None


def test_a_mat_file_of_the_visual_lab_is_told_by_its_folder(tmp_path):
    (tmp_path / "landmark").mkdir()
    savemat(tmp_path / "log.mat", {"log": np.zeros(1)})
    answer = door(str(tmp_path / "log.mat"))
    assert answer is not None
    assert commands("\n".join(answer)) == [["lab", str(tmp_path), f"logs/{tmp_path.name}"]]


def test_a_mat_file_of_no_format_here_is_named_with_what_it_holds(tmp_path, capsys):
    savemat(tmp_path / "mine.mat", {"odom": np.zeros((3, 3)), "scan": np.zeros((3, 5))})
    assert main([str(tmp_path / "mine.mat")]) == 2
    said = capsys.readouterr().err
    assert "odom, scan" in said
    assert "slamref convert table" in said
    assert said.count("\n") == 1


def test_what_is_no_log_cannot_be_drawn(tmp_path, capsys):
    source = world.save_folder(tmp_path / "set", world.texts())
    assert main([str(source), "--plot", str(tmp_path / "a.png")]) == 2
    assert "not a log yet" in capsys.readouterr().err


def test_a_pose_graph_without_observations_is_sent_to_the_command_that_optimizes_it(tmp_path):
    for name, tag in (("a.g2o", "EDGE_SE2"), ("b.graph", "EDGE2"), ("c.txt", "ODOMETRY")):
        (tmp_path / name).write_text(f"{tag} 0 1 1 0 0 1 0 0 1 0 1\n\n{tag} 0 1 1 0 0 1 0 0 1 0 1\n")
        said = what_to_type(tmp_path / name)
        assert f"a pose graph; slamref audit {tmp_path / name} optimizes it, slamref convert g2o" in said
    (tmp_path / "d.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 0 7 1 1 1 0 1\n")
    assert "slamref convert g2o" in what_to_type(tmp_path / "d.g2o")
    (tmp_path / "table.txt").write_text("time x y\n0 1 2\n")
    assert "slamref convert table" in what_to_type(tmp_path / "table.txt")

"""`eval.inspect` says what a log holds and what is odd about it, draws it, and fails with one line."""

import dataclasses

import numpy as np
import pytest

from data.formats.open_log import write_folder
from data.inputs import CLUTTER, UNLABELLED
from data.log import Log
from data.questions.summary import longest_run, repeated_in_frame, summarize
from data.sensors import RangeBearing
from data.truth import UNKNOWN_ID, Truth
from eval.figures.map import log_figure
from eval.inspect import main
from tests.builders.logs import NOTHING, increments_of, inputs_of, map_of, observations_of, still


def small_log() -> Log:
    """Twelve frames along the x axis at 1 m/s, with a gap of 3 s before frame 6 and a jump of 50 m into frame 9."""
    n = 12
    time = np.arange(float(n))
    time[6:] += 2.0
    mean = np.zeros((n, 3))
    mean[1:, 0] = np.diff(time)
    mean[9, 0] = 50.0
    frame = np.array([0, 0, 2, 2, 2, 9])
    z = np.array([[2.0, np.pi / 2], [1.0, 0.0], [2.0, 0.5], [3.0, -0.5], [3.0, 0.1], [11.0, 0.0]])
    pose = np.column_stack([np.cumsum(mean[:, 0]), np.zeros(n), np.zeros(n)])
    pose[3:5] = np.nan
    known, steps = map_of([[0.0, 2.0], [3.0, 6.0]], [1, 4]), increments_of(mean, np.diag([0.04, 0.01, 0.0001]))
    return Log(
        "by-hand",
        inputs_of(steps, observations_of(frame, z), RangeBearing(max_range=10.0), known, time=time, floored=3),
        Truth(pose, known, np.array([4, 1, 4, UNKNOWN_ID, CLUTTER, UNKNOWN_ID])),
        label=np.array([4, 1, 4, 4, 7, UNLABELLED]), labels_are_sensed=True, source={"maker": "hand", "seed": 3},
        notes=("one of a kind",),
    )  # fmt: skip


def said(log: Log, key: str) -> str:
    lines = [text for name, text in summarize(log) if name == key]
    assert len(lines) == 1
    return lines[0]


def odd(log: Log) -> str:
    return "\n".join(text for name, text in summarize(log) if name == "check")


def test_summary_says_what_the_log_holds():
    log = small_log()
    assert said(log, "name") == "by-hand"
    assert [text for name, text in summarize(log) if name == "source"] == ["maker = hand", "seed = 3"]
    assert said(log, "note") == "one of a kind"
    assert said(log, "frames") == "12"
    assert said(log, "span") == "13 s, from 0 to 13; rate 0.8462 per s"
    assert said(log, "gaps") == "largest 3 s, before frame 6; median 1 s; 1 longer than 1 s"
    assert said(log, "increments").startswith("path 62 m, turned 0 deg in all; 0 of 11")
    assert said(log, "noise").startswith(
        "median σ forward 0.2 m, sideways 0.1 m, heading 0.573 deg; covariance raised to the minimum"
    )
    assert said(log, "noise").endswith("in 3 of 11 (27.3 %)")
    assert said(log, "sensor") == "range_bearing, up to 10 m, -180 to 180 deg"
    assert said(log, "observations") == "6, per frame 0 to 3, mean 0.5; 0.4615 per s"
    assert said(log, "blind frames") == "9 of 12 (75.0 %) without observation; longest stretch 6 frames from frame 3"
    assert said(log, "measured").startswith("range 1 to 11 m, bearing -28.65 to 90 deg; 1 of 6 (16.7 %) outside")
    assert said(log, "labels").startswith(
        "sensed; 3 distinct, seen 1 to 3 times, median 1; 1 of 6 (16.7 %) unlabelled, 0 clutter"
    )
    assert said(log, "labels").endswith("1 of 4 (25.0 %) differ from the true id")
    assert said(log, "truth").startswith(
        "10 of 12 (83.3 %) frames with a pose; longest stretch without 2 frames from frame 3"
    )
    assert said(log, "truth").endswith("4 of 6 (66.7 %) observations with an id")
    assert said(log, "landmarks") == "2 (map and truth), ids 1 to 4, x 0 to 3 m, y 2 to 6 m"


def test_odd_rows_are_counted_and_the_first_ones_named():
    text = odd(small_log())
    assert "without a true pose: 2 frames 3, 4" in text
    assert "outside the stated range or field of view: 1 observation 5" in text
    assert "moved more than 10 times faster than the usual 1 m/s: 1 frame 9" in text
    assert "label repeated in the same frame: 1 observation 3" in text
    assert "not in the map: 1 label 7" in text
    assert len(text.splitlines()) == 5


def test_what_a_log_does_not_have_is_said_and_one_of_one_frame_is_summarized():
    log = small_log()
    bare = dataclasses.replace(log, recorded=log.recorded.without_map(), truth=Truth(), label=None, source={}, notes=())
    assert said(bare, "labels") == "none"
    assert said(bare, "truth") == "no poses; no ids"
    assert said(bare, "landmarks") == "none known"
    assert "source" not in dict(summarize(bare))
    assert "without a true pose" not in odd(bare)
    log = small_log()
    one = inputs_of(still(1), NOTHING, RangeBearing(), time=[5.0], time_is_index=True, covariance_floor=0.0)
    single = Log("one", one, Truth(landmark_of=np.zeros(0, np.int64)))
    assert said(single, "frames") == "1, without stamps (t is a frame number)"
    assert said(single, "observations") == "none"
    assert said(single, "sensor").startswith("range_bearing, any range")
    assert said(single, "span") == "0 steps, from 5 to 5"
    log_figure(single)
    unfloored = dataclasses.replace(log, recorded=dataclasses.replace(log.recorded, covariance_floor=0.0, floored=0))
    assert said(unfloored, "noise").endswith("no covariance floor, 0 singular")


def test_longest_run_and_repeated_labels_are_found():
    assert longest_run(np.array([1, 0, 1, 1, 0, 1], bool)) == (2, 2)
    assert longest_run(np.ones(3, bool)) == (0, 3)
    assert longest_run(np.zeros(3, bool)) == (0, 0)
    frame, label = np.array([0, 0, 0, 1, 1, 1]), np.array([5, -1, 5, 5, -1, -1])
    assert repeated_in_frame(frame, label).tolist() == [2]


def test_the_picture_places_observations_where_the_landmarks_are():
    log = small_log()
    drawn = {line.get_label(): np.asarray(line.get_xydata()) for line in log_figure(log).axes[0].lines}
    assert drawn["6 of 6 observations,\nfrom the true path"][0] == pytest.approx([0.0, 2.0])
    assert drawn["2 landmarks"].tolist() == [[0.0, 2.0], [3.0, 6.0]]
    assert drawn["dead reckoning"][-1] == pytest.approx([62.0, 0.0])
    blind = dataclasses.replace(log, truth=Truth(), label=None)
    assert "6 of 6 observations,\nfrom dead reckoning" in {line.get_label() for line in log_figure(blind).axes[0].lines}
    assert log_figure(log).axes[0].get_aspect() == 1.0


def test_the_command_prints_the_summary_and_writes_the_picture(tmp_path, capsys):
    write_folder(small_log(), tmp_path / "kept")
    assert main([str(tmp_path / "kept"), "--plot", str(tmp_path / "new" / "kept.png")]) == 0
    out, err = capsys.readouterr()
    assert "kept" in out.splitlines()[0]
    assert "path 62 m" in out
    assert err == ""
    assert (tmp_path / "new" / "kept.png").read_bytes().startswith(b"\x89PNG")


def test_bad_data_and_bad_names_are_one_line_and_exit_2(tmp_path, refused):
    write_folder(small_log(), tmp_path / "kept")
    observations = tmp_path / "kept" / "observations.csv"
    observations.write_text(observations.read_text().replace("\n0,", "\n99,", 1))
    (tmp_path / "file").write_text("")
    for arguments, named in (
        ([str(tmp_path / "kept")], "observations.csv:2: column frame: 99 is out of range"),
        ([str(tmp_path / "nowhere")], "nowhere"),
        (["arena:0", "--plot", "picture.bmp"], "picture.bmp"),
        (["arena:0", "--plot", str(tmp_path / "file" / "picture.png")], "cannot be written"),
    ):
        assert named in refused(main, arguments)

"""What is written of a laser log: every number in its section is that of the run it names; its map files read back."""

from dataclasses import fields, replace

import numpy as np
import pytest

from association.names import SCAN
from data.notice import stopped
from data.result import Failure
from data.truth import Relations
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.report.page.blocks import Folded, Table
from tests.eval.handmade import FRAMES, circle_log, run_with_error, true_path
from wings.laser.report import facts_of, laser_sections, write_map
from wings.laser.scans.constraints import Chain, LaserRun, Loops
from wings.laser.scans.occupancy import Grid

KEYS = 8
CHAIN = Chain(
    np.arange(0, FRAMES, 5), np.zeros((KEYS, 3)), np.zeros((KEYS, 3, 3)), np.arange(FRAMES) // 5,
    np.zeros((FRAMES, 3)), np.zeros((FRAMES, 3, 3)),
)  # fmt: skip
LOOPS = Loops(
    np.array([0, 0, 1, 1]), np.array([7, 6, 7, 5]), np.zeros((4, 3)), np.tile(np.eye(3), (4, 1, 1)), np.ones(4),
    np.array([7, 6, 7, -1]),
)  # fmt: skip
STOPPED = Failure("diverged", 5, stopped("made up"))
SIDE = np.array([0.0, 1.0, 0.0])


def laser(estimator="isam2", offset=0.1, *, phases=("online", "final"), **more):
    made = run_with_error(offset * SIDE, estimator=estimator, association=SCAN, phases=phases, mapped=False)
    parts = {f.name: getattr(made, f.name) for f in fields(made)}
    return LaserRun(**parts, **{
        "chain": CHAIN, "loops": LOOPS, "weight": np.array([1.0, 0.9, 0.0, np.nan]),
        "key_pose": np.zeros((KEYS, 3)), "last": true_path() + offset * SIDE, **more,
    })  # fmt: skip


def laser_log(*, truth=True, relations=None, name="hall"):
    log = circle_log(truth=truth, name=name)
    return replace(log, truth=replace(log.truth, relations=relations))


def stretched(count=2):
    """Relations from the first frame to later ones, whose truth is 0.3 m longer ahead than the path."""
    to = 1 + np.arange(count)
    path = true_path()
    c, s = np.cos(path[0, 2]), np.sin(path[0, 2])
    away = (path[to, :2] - path[0, :2]) @ np.array([[c, -s], [s, c]])
    turn = path[to, 2] - path[0, 2]
    longer = away + 0.3 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Relations(np.zeros(count, int), to, np.column_stack([longer, turn]), np.array([1, *[0] * (count - 1)]))


def section(tmp_path, trials, pictures=()):
    options = Output(formats=("csv",), no_plots=True)
    return laser_sections(tmp_path, options, trials, [pictures] * len(trials))


def text_of(sections):
    blocks = [b for s in sections for b in s.blocks]
    blocks += [inner for b in blocks if isinstance(b, Folded) for inner in b.blocks]
    return "\n".join(b for b in blocks if isinstance(b, str))


def facts(*runs, log=None):
    return facts_of(Trial(log or laser_log(), "slam", runs), runs[0])


def test_graph_and_loop_closures_are_counted_and_robust_smoothers_say_what_they_left_out(tmp_path):
    runs = (laser(), laser("gnc"), laser("batch-cauchy", weight=np.array([1.0, 1.0, 1.0, np.nan])), laser("batch"))
    found = facts(*runs)
    sizes = {"scans": 0, "frames": FRAMES, "keys": KEYS, "loops": 4, "believed": 3}
    unknown = {"scale": None, "time": None}
    assert found.items() >= (sizes | unknown | {"left_out": (("gnc", 1), ("batch-cauchy", 0))}).items()
    text = text_of(section(tmp_path, [Trial(laser_log(), "slam", runs)]))
    assert ("* 0 scans in 40 frames became 8 key poses; 4 candidate loop closures were tested and 3 accepted,") in text
    assert "* `gnc` finally rejected 1 of them.\n* `batch-cauchy` finally rejected 0 of them." in text
    assert "variances" not in text
    assert "front end" not in text


def test_the_scale_of_claimed_variances_is_told_with_its_error(tmp_path):
    text = text_of(section(tmp_path, [Trial(laser_log(), "slam", (laser(scale=(2.5, 0.31)),))]))
    assert "Variance scale of scan matching: 2.50 ± 0.31, learned" in text


def test_the_time_of_the_front_end_is_set_against_that_of_the_drive(tmp_path):
    seconds = np.full(FRAMES, 0.01)
    seconds[7] = 0.4
    run = laser(frame_seconds=seconds)
    text = text_of(section(tmp_path, [Trial(laser_log(), "slam", (run,))]))
    # 40 frames half a second apart are 19.5 s
    assert "took 0.790 s for 19.5 s of driving, 24.7 times real time" in text
    assert "the longest 400 ms." in text
    numbered = laser_log()
    numbered = replace(numbered, recorded=replace(numbered.recorded, time_is_index=True))
    assert facts(run, log=numbered)["time"] is None


EKF = laser("ekf", 0.2, phases=("online",))


def test_the_table_of_relations_has_a_row_per_phase(tmp_path):
    given = Trial(laser_log(relations=stretched()), "slam", (laser(), EKF, replace(laser("gnc"), failure=STOPPED)))
    (made,) = section(tmp_path, [given])
    (table,) = (b for b in made.blocks if isinstance(b, Table))
    frame = table.frame
    assert frame[["estimator", "phase"]].to_numpy().tolist() == [
        ["isam2", "online"], ["isam2", "final"], ["ekf", "online"],
    ]  # fmt: skip
    assert set(frame["all by row (2) [m]"]) == set(frame["exact by row (1) [m]"]) == {"0.3000 ± 0.0000"}
    assert set(frame["heading [°]"]) == {"0.000 ± 0.000"}
    assert set(frame["largest [m]"]) == {"0.300"}
    assert not any("by time" in c for c in frame), "relations without stamps are tied to rows alone"


def loaded(folder):
    """Cells (H, W) with row 0 in the south, -1 unknown, 0 free, 100 occupied; resolution and origin. As the loader: p =
    (255 - pixel) / 255, occupied above occupied_thresh, free below free_thresh.
    """
    said = dict(line.split(": ", 1) for line in (folder / "map.yaml").read_text().splitlines())
    magic, size, most, body = (folder / said["image"]).read_bytes().split(b"\n", 3)
    assert (magic, most, said["negate"], said["mode"]) == (b"P5", b"255", "0", "trinary")
    width, height = map(int, size.split())
    p = (255 - np.frombuffer(body, np.uint8).reshape(height, width)[::-1].astype(float)) / 255.0
    cells = np.full(p.shape, -1)
    cells[p > float(said["occupied_thresh"])] = 100
    cells[p < float(said["free_thresh"])] = 0
    origin = [float(v) for v in said["origin"].strip("[]").split(",")]
    return cells, float(said["resolution"]), origin


@pytest.fixture
def grid():
    p = np.array([[0.9, 0.5, 0.1], [0.5, 0.64, 0.1], [0.66, 0.36, 0.34], [0.5, 0.5, 0.97]])
    return Grid(np.array([-3.2, 1.15]), 0.05, np.log(p / (1.0 - p)))


def test_cells_are_read_back_as_they_were(grid, tmp_path):
    write_map(grid, tmp_path)
    cells, resolution, origin = loaded(tmp_path)
    assert cells.tolist() == [[100, -1, 0], [-1, -1, 0], [100, -1, 0], [-1, -1, 100]]
    assert (resolution, origin) == (0.05, [-3.2, 1.15, 0.0])


def test_same_grid_same_bytes_and_these_pixels(grid, tmp_path):
    first = [p.read_bytes() for p in write_map(grid, tmp_path / "a")]
    assert first == [p.read_bytes() for p in write_map(grid, tmp_path / "b")]
    # north comes first; 254 free, 0 occupied, 205 unknown
    assert first[0] == b"P5\n3 4\n255\n" + bytes([205, 205, 0, 0, 205, 254, 205, 205, 254, 0, 205, 254])
    assert b"occupied_thresh: 0.65\nfree_thresh: 0.196\n" in first[1]

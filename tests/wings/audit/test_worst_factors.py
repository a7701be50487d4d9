"""The report names the worst factors of the graph that `batch` ends with."""

from dataclasses import replace

import numpy as np
import pytest

from association.names import SCAN
from data.result import Trajectory
from data.worlds.registry import named_log
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.replay.run import compare
from eval.report.page.blocks import Table
from tests.eval.handmade import circle_log
from wings.audit.worst_factors import worst_factors_section
from wings.laser.scans.constraints import Chain, LaserRun, Loops


def section(tmp_path, trial):
    (made,) = worst_factors_section(tmp_path, Output(), trial)
    kinds, worst = (block for block in made.blocks if isinstance(block, Table))
    return made.facts[0], kinds.frame, worst.frame


@pytest.fixture(scope="module")
def arena():
    return named_log("arena:0:frames=60")


def test_a_wrong_reading_comes_first(tmp_path, arena):
    o = arena.recorded.observations
    row = int(np.flatnonzero(o.frame == 30)[1])
    z = o.z.copy()
    z[row, 0] += 7.0 * np.sqrt(o.R[row, 0, 0])
    log = replace(arena, recorded=replace(arena.recorded, observations=replace(o, z=z)))
    inputs = log.inputs(labels=True)
    run = compare(inputs, "localization", ["ekf", "batch"])[-1]
    facts, kinds, worst = section(tmp_path, Trial(log, "localization", (run,)))
    assert facts["rejected"] >= 1
    assert worst["factor"].iloc[0].startswith("observation 1 of landmark ")
    assert worst["frames"].iloc[0] == "30"
    assert len(worst) == 10
    assert kinds["kind"].tolist()[:3] == ["prior", "odometry", "observations"]
    assert (tmp_path / "tables" / "arena_0_frames=60-localization-worst.csv").is_file()


def test_a_log_without_batch_has_none(tmp_path, arena):
    runs = compare(arena.inputs(labels=True), "slam", ["ekf", "isam2"])
    assert worst_factors_section(tmp_path, Output(), Trial(arena, "slam", tuple(runs))) == []


def test_loop_closures_are_named_by_key_poses_and_frames(tmp_path):
    """Ten key poses on a line; one closure is wrong."""
    rng, log = np.random.default_rng(0), circle_log()
    sigma, keys, n = np.array([0.02, 0.02, 0.01]), 10, len(log.recorded)
    C = np.diag(sigma**2)
    motion = np.tile([1.0, 0.0, 0.0], (keys, 1)) + rng.normal(0, sigma, (keys, 3))
    motion[0] = 0.0
    a, b = np.array([2, 1, 2, 0, 3, 1, 0]), np.array([9, 6, 9, 9, 8, 7, 8])
    relative = np.column_stack([b - a, 0.0 * a, 0.0 * a]) + rng.normal(0, sigma, (7, 3))
    relative[3] += 8.0 * sigma
    believed = np.array([9, 6, -1, 9, 8, 9, 8])
    chain = Chain(4 * np.arange(keys), motion, np.tile(C, (keys, 1, 1)), np.minimum(np.arange(n) // 4, keys - 1),
                  np.zeros((n, 3)), np.zeros((n, 3, 3)))  # fmt: skip
    loops = Loops(a, b, relative, np.tile(C, (7, 1, 1)), np.ones(7), believed)
    pose = np.column_stack([np.arange(keys), np.zeros(keys), np.zeros(keys)]).astype(float)
    path = Trajectory(np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)))
    none = np.empty(0, np.int64)
    run = LaserRun("batch", SCAN, "slam", None, path, None, none, none, none, chain=chain, loops=loops, key_pose=pose)
    facts, kinds, worst = section(tmp_path, Trial(log, "slam", (run,)))
    assert worst["factor"].iloc[0] == "loop, key poses 0 and 9"
    assert worst["frames"].iloc[0] == "0, 36"
    assert facts["rejected"] >= 1
    assert kinds.set_index("kind")["factors"].to_dict() == {"prior": 1, "scan matching": 9, "loop": 6}

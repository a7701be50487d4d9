"""Studies through the command: resumed after an interrupt, the same for any number of processes and on a cluster."""

import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd
import pytest

from eval.run_all import main
from eval.studies import store

SCENARIO = """
about = "a small arena"
task = ["localization", "slam"]

[world]
kind = "arena"
frames = 30
landmarks = 10

[estimators]
ekf = { must_be = "consistent", task = ["localization"] }
ekf-invariant = {}
batch = {}
"""
PATIENCE = 300.0
"""s, for a process that starts on a busy machine and may have to compile the kernels first."""
CLUSTER_RUNS = 20
TABLES = ("consistency.csv", "metrics.csv", "association.csv")


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SCENARIO)
    return str(path)


def study(small, out, *more, runs=6):
    return main(["--scenario", small, "--runs", str(runs), "--out", str(out), "--no-plots", "-q", *more])


def same(a: Path, b: Path) -> None:
    for name in TABLES:
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
    pages = [(p / "report.md").read_text() for p in (a, b)]
    assert pages[0] == pages[1]


def wait_for(ended: Callable[[], object], folder: Path, runs: int) -> int:
    """Until so many runs are kept by what has not `ended`; how many there are."""
    deadline = time.monotonic() + PATIENCE
    while (kept := len(list(folder.rglob("[0-9]*.npz")))) < runs:
        assert not ended()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return kept


@pytest.mark.slow
def test_a_finished_run_is_never_done_again_and_more_runs_add_to_it(small, tmp_path, monkeypatch):
    assert study(small, tmp_path / "r", "--jobs", "1", runs=4) == 0
    done = []
    real = store.save
    monkeypatch.setattr(
        "eval.plan.execute.store.save", lambda folder, seed, r: (done.append(seed), real(folder, seed, r))
    )
    assert study(small, tmp_path / "r", "--jobs", "1", runs=6) == 0
    assert sorted(done) == [4, 5]
    assert study(small, tmp_path / "other" / "r", "--jobs", "1", runs=6) == 0
    same(tmp_path / "r", tmp_path / "other" / "r")


def test_a_run_that_diverges_is_listed_with_its_seed_and_a_command_that_replays_it(
    small, tmp_path, monkeypatch, capsys
):
    from eval.studies import montecarlo
    from eval.studies.montecarlo import Sample

    real = montecarlo.one_run

    def one_run(scenario, seed):
        result = real(scenario, seed)
        if seed == 3:
            result["slam", "ekf", "known", "online"] = Sample(failure="frame 9: the state is no longer finite")
        return result

    monkeypatch.setattr("eval.plan.execute.one_run", one_run)
    out = tmp_path / "r"
    assert main(["--scenario", small, "--runs", "5", "--out", str(out), "--no-plots", "--jobs", "1"]) == 0
    table = pd.read_csv(out / "consistency.csv").set_index(["task", "estimator", "quantity"])
    assert table.loc["slam", "ekf", "pose"][["runs", "diverged"]].tolist() == [4, 1]
    page = (out / "report.md").read_text()
    assert f"python -m eval.run_all --scenario {small} --estimator ekf --seed 3 --runs 1" in page
    assert "diverged with seed 3, frame 9" in capsys.readouterr().out


@pytest.mark.slow
def test_a_rejected_declaration_is_exit_1_and_named(small, tmp_path, monkeypatch, capsys):
    from dataclasses import replace

    from eval.studies import montecarlo

    real = montecarlo.one_run

    def boastful(scenario, seed):
        return {k: replace(s, means={q: v / 0.6 for q, v in s.means.items()}) for k, s in real(scenario, seed).items()}

    monkeypatch.setattr("eval.plan.execute.one_run", boastful)
    asked = ["--scenario", small, "--estimator", "ekf", "--runs", "50", "--out", str(tmp_path / "r"), "--no-plots"]
    assert main([*asked, "--jobs", "1"]) == 1
    assert "rejected: ekf (small, localization, online)" in capsys.readouterr().out


@pytest.mark.parametrize(("arguments", "words"), [
    (["--scenario", "arena", "--runs", "0"], "at least one run"),
    (["--scenario", "nowhere.toml"], "no such file; shipped: arena"),
    (["--scenario", "arena", "--log", "arena:0"], "exclude each other"),
    (["--scenario", "arena", "--gate", "0.9"], "exclude each other"),
    (["--scenario", "arena", "--scenario", "arena"], "two scenarios are named"),
    (["--scenario", "arena", "--scheduler", "tcp://127.0.0.1:9"], "--scheduler tcp://127.0.0.1:9"),
])  # fmt: skip
def test_what_makes_no_sense_is_one_line_and_exit_2(arguments, words, tmp_path, monkeypatch, refused):
    monkeypatch.setattr("eval.plan.work.CONNECT", 1)
    assert words in refused(main, [*arguments, "--out", str(tmp_path / "r"), "-q"])
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_a_cluster_gives_the_same_numbers_though_a_worker_is_killed(small, tmp_path):
    from distributed import LocalCluster

    assert study(small, tmp_path / "here" / "r", "--jobs", "1", runs=CLUSTER_RUNS) == 0
    there = tmp_path / "there" / "r"
    with (
        ThreadPoolExecutor() as pool,
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0", worker_dashboard_address=":0"
        ) as cluster,
    ):
        asked = pool.submit(study, small, there, "--scheduler", cluster.scheduler_address, runs=CLUSTER_RUNS)
        kept = wait_for(asked.done, there.parent / ".studies", 1)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        assert asked.result(PATIENCE) == 0
    assert kept < CLUSTER_RUNS
    same(tmp_path / "here" / "r", tmp_path / "there" / "r")

"""Worlds, estimators, methods and options in all pairs: each run ends well or says in one line why it cannot."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import pandas as pd
import pytest

from eval.replay.settings import ASSOCIATIONS, ESTIMATORS, STEPPING
from eval.run_all import main

TRIED = 30
"""Rows that compete for each place."""


def pairwise(factors: Mapping[str, Sequence[str]], rng: np.random.Generator) -> list[dict[str, str]]:
    """Rows that cover all pairs (the greedy way of AETG, Cohen et al., IEEE TSE 23(7), 1997)."""
    names = list(factors)
    left = {((a, x), (b, y)) for a, b in combinations(names, 2) for x in factors[a] for y in factors[b]}
    rows: list[dict[str, str]] = []
    while left:
        best: tuple[int, dict[str, str]] = (-1, {})
        for _ in range(TRIED):
            row = dict(sorted(left)[int(rng.integers(len(left)))])
            for name in rng.permutation([n for n in names if n not in row]).tolist():
                levels = rng.permutation(factors[name]).tolist()
                row[name] = max(levels, key=lambda level: _gained(row, name, level, names, left))
            count = sum(pair in left for pair in _pairs(row, names))
            best = max(best, (count, row), key=lambda found: found[0])
        rows.append({name: best[1][name] for name in names})
        left -= set(_pairs(best[1], names))
    return rows


def _pairs(row: Mapping[str, str], names: Sequence[str]) -> list[tuple[tuple[str, str], tuple[str, str]]]:
    return [((a, row[a]), (b, row[b])) for a, b in combinations(names, 2)]


def _gained(row: Mapping[str, str], name: str, level: str, names: Sequence[str], left: set[object]) -> int:
    pairs = (sorted([(name, level), other], key=lambda pair: names.index(pair[0])) for other in row.items())
    return sum(tuple(pair) in left for pair in pairs)


WORLDS = (
    "arena:{}:frames=90", "arena:{}:frames=60+sensor=relative_point+clutter=0.1", "arena:{}:frames=60+landmarks=3",
    "arena:{}:frames=80+curvature=0.03+scale=-0.1", "park:{}:frames=120", "corridor:{}:frames=60",
    "corridor:{}:people+no-odometry+frames=50", "circle:{}:frames=100+turn_rate=0.1", "linear:{}:frames=60",
    "walls:{}:frames=160", "floorplan:{}:frames=80",
)  # fmt: skip
FACTORS = {
    "world": WORLDS, "--task": ("localization", "slam"), "--estimator": (*ESTIMATORS, ",".join(ESTIMATORS)),
    "--association": ASSOCIATIONS, "--gate": ("", "none", "0.9"), "--new-gate": ("", "none", "0.999"),
    "--gate-known": ("", "none", "0.99"), "--in-view": ("", "on"), "--maintain": ("", "on"),
    "--forget-after": ("", "4"), "--deactivate-after": ("", "2"), "--lag": ("", "3"),
    "--calibrate": ("", "auto", "scale,curvature", "left,right=0.1", "range,bearing", "drift"),
}  # fmt: skip
SWITCHES = ("--in-view", "--maintain")
RUNS = 200
NEVER_BLANK = ("frames", "observations", "rmse_position_m")


def sensible(row):
    """The combination without what is refused for its log or task, so that nothing is hidden behind a refusal."""
    found = dict(row)
    if row["--task"] == "localization":
        found |= dict.fromkeys(("--maintain", "--forget-after", "--deactivate-after"), "")
    if "ekf-fej" in row["--estimator"]:
        found["--deactivate-after"] = ""
    if row["world"].startswith("floorplan"):
        found["--calibrate"] = ""
    elif row["--association"] == "scan":
        found["--association"] = "jcbb"
    return found


def arguments(row, seed):
    """The command line of a combination; every tenth as it fell."""
    row = sensible(row) if seed % 10 else row
    found = ["--log", row["world"].format(seed)]
    for name, value in row.items():
        if name.startswith("--") and value:
            found += [name] if name in SWITCHES else [name, value]
    return found


def checked(folder):
    """Estimators that came to an end, of those in the tables; fails where a status is `ok` and a number is missing."""
    metrics = pd.read_csv(folder / "metrics.csv")
    assert len(metrics)
    assert set(metrics["status"]) <= {"ok", "diverged", "incomplete", "implausible"}
    fine = metrics[metrics["status"] == "ok"]
    for name in NEVER_BLANK:
        assert fine[name].notna().all(), name
    assert np.isfinite(fine["rmse_position_m"]).all()
    assert (fine["rmse_position_m"] >= 0).all()
    broken = {f"{r.task}-{r.estimator}-{r.association}" for r in metrics[metrics["status"] != "ok"].itertuples()}
    sound = [path for path in folder.rglob("online.csv") if path.parent.name not in broken]
    assert len(sound) >= len(set(fine["estimator"]) & set(STEPPING))
    for path in sound:
        run = pd.read_csv(path)
        assert np.isfinite(run[["t", "x", "y", "theta"]]).all(axis=None), path
        assert (run[["c_xx", "c_yy", "c_tt"]] >= 0).all(axis=None), path
    return set(fine["estimator"])


@pytest.fixture(scope="module")
def rows():
    rng = np.random.default_rng(20)
    found = pairwise(FACTORS, rng)
    assert len(found) <= RUNS
    while len(found) < RUNS:
        found.append({name: levels[int(rng.integers(len(levels)))] for name, levels in FACTORS.items()})
    return found


@pytest.mark.slow
@pytest.mark.parametrize("k", range(RUNS))
def test_a_combination_ends_well_or_says_why_not(rows, k, tmp_path, capsys):
    asked = arguments(rows[k], 1000 + k)
    status = main([*asked, "--out", str(tmp_path / "out"), "--no-plots"])
    said = capsys.readouterr().err
    assert "Traceback" not in said
    if status == 2:
        last = said.strip().splitlines()[-1]
        assert last.startswith(("slamref", "python -m ")), asked
        assert len(last) < 400
        assert not (tmp_path / "out").exists()
    else:
        assert status in (0, 1)
        checked(tmp_path / "out")

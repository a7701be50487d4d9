"""Localization in a map with errors, with and without the map's standard deviations: NEES and accuracy over many runs.

`python -m tests.research.uncertain_map OUT [--runs 100]` prints a row for each size of the map's errors and estimator,
and draws the NEES along the path to OUT/uncertain-map.png. The world is the arena with 200 frames, 25 landmarks and
labels; sensor 0.1 m and 0.02 rad. NEES is of the last pose, which is one draw a run. Its bounds are those of the mean
of chi-square variables with three degrees of freedom, 99 %.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from data.command import Parser
from data.log import Log
from data.se2 import Array
from data.worlds.registry import named_log
from eval.figures.style import BAND_COLOUR, DASHED, drawing, page_width, save, style_of
from eval.referee.consistency import nees
from eval.replay.run import compare
from eval.replay.settings import FILTERS

SIZES = (0.02, 0.05, 0.1, 0.2)  # m
DRAWN = 0.1  # m, size of the figure
ESTIMATORS = (*FILTERS, "batch")
SHOWN = ("ekf", "batch")


def as_exact(log: Log) -> Log:
    """The same log with the same map, which claims to be exact."""
    assert log.recorded.map is not None
    return replace(log, recorded=replace(log.recorded, map=log.recorded.map.exact))


def measured(log: Log) -> dict[str, tuple[Array, Array]]:
    """NEES (N,) and squared error of the position (N,) [m^2] by estimator."""
    assert log.truth.pose is not None
    found = {}
    for run in compare(log.inputs(labels=True), "localization", ESTIMATORS):
        t = run.trajectory(run.phases[-1])
        off = np.sum((t.pose[:, :2] - log.truth.pose[:, :2]) ** 2, axis=1)
        found[run.estimator] = nees(t.pose, t.covariance, log.truth.pose, "pose"), off
    return found


def figure(along: dict[tuple[str, bool], Array], runs: int) -> Figure:
    """Mean NEES (N,) by frame, of estimators with the sigmas (True) and without."""
    low, high = chi2.ppf([0.005, 0.995], 3 * runs) / runs
    with drawing():
        fig = Figure(figsize=(page_width(), 2.6))
        ax = fig.subplots()
        ax.axhspan(low, high, color=BAND_COLOUR, label="99 % bounds of the mean")
        for (name, used), mean in along.items():
            style = style_of(name)
            what = "with the sigmas" if used else "map taken as exact"
            line = "-" if used else DASHED
            ax.semilogy(mean, color=style.colour, linestyle=line, label=f"{style.label}, {what}")
        ax.set(xlabel="frame", ylabel=f"pose NEES, mean of {runs} runs", xlim=(0, len(mean) - 1))
        fig.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return fig


def main() -> None:
    """Run the study."""
    p = Parser(prog="python -m tests.research.uncertain_map", description=__doc__)
    p.add_argument("out", type=Path, metavar="OUT")
    p.add_argument("--runs", type=int, default=100, metavar="N")
    options = p.parse_args()
    low, high = chi2.ppf([0.005, 0.995], 3 * options.runs) / options.runs
    print(f"| map [m] | estimator | NEES | without | RMSE [m] | without |   bounds {low:.2f} to {high:.2f}")
    for size in SIZES:
        total: dict[tuple[str, bool], list[tuple[Array, Array]]] = {}
        for seed in range(options.runs):
            log = named_log(f"arena:{seed}:sigma_map={size}")
            for used, each in ((True, log), (False, as_exact(log))):
                for name, found in measured(each).items():
                    total.setdefault((name, used), []).append(found)
        mean = {key: np.mean([n for n, _ in rows], axis=0) for key, rows in total.items()}
        rmse = {key: np.sqrt(np.mean([off for _, off in rows])) for key, rows in total.items()}
        for name in ESTIMATORS:
            one, other = (name, True), (name, False)
            row = f"{mean[one][-1]:.2f} | {mean[other][-1]:.1f} | {rmse[one]:.4f} | {rmse[other]:.4f}"
            print(f"| {size} | `{name}` | {row} |", flush=True)
        if size == DRAWN:
            shown = {(name, used): mean[name, used] for name in SHOWN for used in (True, False)}
            options.out.mkdir(parents=True, exist_ok=True)
            save(figure(shown, options.runs), options.out, "uncertain-map", ("png",))


if __name__ == "__main__":
    main()

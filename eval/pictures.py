"""The files of one trial: its runs, its figures with their captions, and its films."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from eval import figures
from eval.options import Options
from eval.report import Picture
from eval.run_files import folder_name, write_run
from eval.score import Trial
from eval.style import save


def stem(trial: Trial, what: str) -> str:
    """Name of a trial's file, without suffix."""
    return f"{folder_name(trial.log.name)}-{trial.task}-{what}"


def publish(folder: Path, options: Options, trial: Trial) -> tuple[Picture, ...]:
    """Write everything about one trial below the result folder; returns the pictures for the report."""
    for run in trial.runs:
        write_run(folder, trial, run)
        if options.animate and run.failure is None:
            from eval.animate import animate

            animate(trial.log, run, folder / "figures" / f"{stem(trial, run.estimator)}.mp4")
    if options.no_plots:
        return ()
    return tuple(_pictures(folder / "figures", trial))


def _pictures(place: Path, trial: Trial) -> list[Picture]:
    log, whole = trial.log, [r for r in trial.runs if r.failure is None]
    shown = [r for r in whole if r.estimator != "dead-reckoning"]
    made = []

    def add(what: str, figure: Figure, caption: str, alt: str) -> None:
        save(figure, place, stem(trial, what))
        made.append(Picture(stem(trial, what), caption, alt))

    where = f"`{log.name}`, {trial.task}"
    add(
        "map", figures.map_figure(log, trial.runs),
        f"{where}: paths and landmarks with 3σ ellipses. World frame, no alignment.",
        f"Map of {log.name} with the paths of {', '.join(r.estimator for r in trial.runs)}",
    )  # fmt: skip
    if not shown:
        return made
    reference = trial.find("batch")
    if log.truth.known_poses:
        add(
            "error", figures.error_figure(log, shown),
            f"{where}: error of each coordinate with the estimator's own ±3σ, which rarely leaves it if consistent.",
            f"Errors over time on {log.name} in x, y and heading, one column per estimator",
        )  # fmt: skip
        add(
            "nees", figures.nees_figure(log, shown),
            f"{where}: pose NEES per frame; a consistent one is in the band 95 % of the time. One run: no verdict.",
            f"Pose NEES over time on {log.name}",
        )  # fmt: skip
    elif reference is not None and reference.failure is None and len(shown) > 1:
        others = [r for r in shown if r is not reference]
        add(
            "difference", figures.difference_figure(log, others, reference),
            f"{where}: distance from the batch solution, with each run's own 3σ. No error: the log has no true path.",
            f"Distance from the batch solution over time on {log.name}",
        )  # fmt: skip
    return made

"""The files of one trial: its runs and films, and each of its pictures with caption and alternative text."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from data.result import Run
from eval import figures
from eval.options import Options
from eval.report import Picture
from eval.run_files import folder_name, write_run
from eval.score import Trial
from eval.style import save


def stem(trial: Trial, what: str) -> str:
    """Name of a trial's file, without suffix."""
    return f"{folder_name(trial.log.name)}-{trial.task}-{what}"


def publish_runs(folder: Path, options: Options, trial: Trial) -> None:
    """Write the run files of a trial, and its films if asked for."""
    for run in trial.runs:
        write_run(folder, trial, run)
        if options.animate and run.failure is None:
            from eval.animate import animate

            animate(trial.log, run, folder / "figures" / f"{stem(trial, run.estimator)}.mp4")


def kinds(trial: Trial) -> tuple[str, ...]:
    """Which pictures a trial gets."""
    shown, reference = _shown(trial), trial.find("batch")
    if not shown:
        return ("map",)
    if trial.log.truth.known_poses:
        return ("map", "error", "nees")
    comparable = reference is not None and reference.failure is None and len(shown) > 1
    return ("map", "difference") if comparable else ("map",)


def draw(folder: Path, trial: Trial, kind: str) -> Picture:
    """Draw one picture of `kinds`, as files below the result folder."""
    figure, caption, alt = _picture(trial, kind)
    save(figure, folder / "figures", stem(trial, kind))
    return Picture(stem(trial, kind), caption, alt)


def _shown(trial: Trial) -> list[Run]:
    return [r for r in trial.runs if r.failure is None and r.estimator != "dead-reckoning"]


def _picture(trial: Trial, kind: str) -> tuple[Figure, str, str]:
    """Figure, caption and what it shows in a sentence."""
    log, shown = trial.log, _shown(trial)
    where = f"`{log.name}`, {trial.task}"
    if kind == "map":
        return (
            figures.map_figure(log, trial.runs),
            f"{where}: paths and landmarks with 3σ ellipses. World frame, no alignment.",
            f"Map of {log.name} with the paths of {', '.join(r.estimator for r in trial.runs)}",
        )
    if kind == "error":
        return (
            figures.error_figure(log, shown),
            f"{where}: error of each coordinate with the estimator's own ±3σ, which rarely leaves it if consistent.",
            f"Errors over time on {log.name} in x, y and heading, one column per estimator",
        )
    if kind == "nees":
        return (
            figures.nees_figure(log, shown),
            f"{where}: pose NEES per frame; a consistent one is in the band 95 % of the time. One run: no verdict.",
            f"Pose NEES over time on {log.name}",
        )
    reference = trial.find("batch")
    assert reference is not None  # `kinds` asks for a difference only where there is one
    return (
        figures.difference_figure(log, [r for r in shown if r is not reference], reference),
        f"{where}: distance from the batch solution, with each run's own 3σ. No error: the log has no true path.",
        f"Distance from the batch solution over time on {log.name}",
    )

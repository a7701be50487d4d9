"""Which logs get a player, and writing it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from data.log import folder_name
from eval.player.document import document
from eval.player.scene import scene
from eval.referee.paths.given import is_truth_alone
from eval.referee.score import Trial
from eval.replay.settings import Setup

FOLDER = "players"


def player_of(log_name: str) -> str:
    """Place of a log's player in the result folder."""
    return f"{FOLDER}/{folder_name(log_name)}.html"


def played(trials: Sequence[Trial]) -> list[tuple[Trial, ...]]:
    """Trials by log, those of one player together: all tasks, and what stands beside them on the same recording."""
    found: dict[str, list[Trial]] = {}
    for trial in trials:
        if trial.beside is None and trial.runs and not is_truth_alone(trial.log):
            found.setdefault(trial.log.name, []).append(trial)
    for trial in trials:
        hosts = found.get(trial.beside or "", [])
        if hosts and trial.log.recorded is hosts[0].log.recorded:
            hosts.append(trial)
    return [tuple(group) for group in found.values()]


def write_player(folder: Path, trials: Sequence[Trial], setup: Setup) -> Path:
    """Write the player of the log of some trials (one of `played`) below a result folder."""
    path = folder / player_of(trials[0].log.name)
    path.parent.mkdir(exist_ok=True)
    write_page(path, trials, setup)
    return path


def write_page(path: Path, trials: Sequence[Trial], setup: Setup) -> None:
    """Write the player of the log of some trials as a file."""
    path.write_text(document(trials[0].log.name, [scene(trials, setup)]), encoding="utf-8", newline="\n")

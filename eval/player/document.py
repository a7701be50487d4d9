"""The page: one file with style, scripts and data, loading nothing else; live (`wings.robot.live`), without data."""

import html
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from data.log import folder_name
from data.wing import of_all
from eval.player.pack import text_of
from eval.player.scene import scene
from eval.referee.given.runs import is_truth_alone
from eval.referee.score import Trial
from eval.replay.settings import Setup

FIRST = ("decode", "history", "view", "marks", "state", "map", "team", "walls")
SCRIPTS = (*FIRST, "controls", "inspect", "matching", "camera", "plots", "main")
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'"


def document(name: str, chunks: Sequence[Mapping[str, Any]]) -> str:
    """The page of a log, with its recording in one or more chunks."""
    inside = [f'<script type="application/json" class="chunk">{text_of(c)}</script>' for c in chunks]
    return _page(name, f"{name}: player", inside, "file", POLICY)


def live_document(name: str) -> str:
    """The page of a drive, which fetches `chunks` and `chunks/FRAME` beside its own address."""
    return _page(name, f"{name}: live", [], "live", f"{POLICY}; connect-src 'self'")


def _page(name: str, title: str, inside: Sequence[str], begin: str, policy: str) -> str:
    """`begin`: the script that loads the recording, and the notes on it."""
    here = files("eval.player")
    page, vendor = here / "page", here / "vendor"

    def read(folder: Any, file: str) -> str:
        return str((folder / file).read_text(encoding="utf-8"))

    # without the library's first line, which names its address
    plotting = re.sub(r"^/\*!.*?\*/\s*", "", read(vendor, "uPlot.iife.min.js"))
    return Template(read(page, "player.html")).substitute(
        title=html.escape(title), name=html.escape(name), policy=policy,
        style=read(vendor, "uPlot.min.css") + read(page, "player.css"), notes=read(page, f"{begin}-notes.html").strip(),
        chunks="\n".join(inside), uplot=read(vendor, "VERSION").split()[1].rstrip(","),
        licence=read(vendor, "LICENSE").strip(), plotting=plotting,
        scripts="\n".join(read(page, f"{script}.js") for script in (*SCRIPTS, begin)),
    )  # fmt: skip


FOLDER = "players"


def player_of(log_name: str) -> str:
    """Path of a log's player in the result folder."""
    return f"{FOLDER}/{folder_name(log_name)}.html"


def played(trials: Sequence[Trial]) -> list[tuple[Trial, ...]]:
    """Trials by log, those of one player together: all tasks, and variants on the same recording."""
    found: dict[str, list[Trial]] = {}
    for trial in trials:
        if trial.variant_of is None and trial.runs and not is_truth_alone(trial.log):
            found.setdefault(trial.log.name, []).append(trial)
    for trial in trials:
        hosts = found.get(trial.variant_of or "", [])
        given = [t.log.recorded for t in (trial, *hosts[:1])]
        if hosts and given[0].observations is given[1].observations and given[0].increments is given[1].increments:
            hosts.append(trial)
    return [tuple(group) for group in found.values()]


def company_of(group: Sequence[Trial], trials: Sequence[Trial]) -> Any:
    """The other robots of a player's log, among all trials; None: there are none."""
    return next((found for of in of_all("company") if (found := of(group, trials)) is not None), None)


def write_page(path: Path, trials: Sequence[Trial], setup: Setup, company: Any = None) -> None:
    """Write the player of trials on one log, with the other robots of `company_of`, to a file."""
    path.write_text(document(trials[0].log.name, [scene(trials, setup, company)]), encoding="utf-8", newline="\n")

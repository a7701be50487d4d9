"""What logs, estimators and ways of association are called in a paper."""

from __future__ import annotations

import re

from eval.figures.style import style_of

METHODS = {
    "known": "known", "none": "", "nn": "NN", "ml": "ML", "ml-ratio": "ML ratio", "singles": "SINGLES", "gnn": "GNN",
    "jcbb": "JCBB", "jcbb-first": "first JCBB", "jcbb-hindsight": "JCBB, hindsight", "scan": "scan matching",
}  # fmt: skip
TASKS = {"slam": "SLAM", "localization": "localization"}
WORLDS = {
    "arena": "arena", "corridor": "corridor", "circle": "circle", "linear": "linear world", "park": "park",
    "visual": "visual lab", "floorplan": "floor plan", "walls": "walls",
}  # fmt: skip
LOGS = {"victoria-park": "Victoria Park"}


def estimators(text: str) -> str:
    """One estimator, or several separated by commas."""
    return ", ".join(style_of(name.strip()).label for name in text.split(","))


def association(name: str) -> str:
    """A way of association; blank for none."""
    return METHODS.get(name, name)


def place(name: str) -> str:
    """A log, a task, or `association NAME`."""
    if name.startswith("association "):
        return f"association {association(name.removeprefix('association '))}"
    return TASKS.get(name, log(name))


def log(name: str) -> str:
    """A log: `corridor:0:people+range=8` is corridor 0 (people, range 8); a name that somebody gave stays as it is."""
    parts = re.fullmatch(r"([a-z]+):(\d+)(?::(.*))?", name)
    if parts is None or parts[1] not in WORLDS:
        return LOGS.get(name, name)
    more = (parts[3] or "").replace("+", ", ").replace("=", " ").replace("-", " ").replace("_", " ")
    return f"{WORLDS[parts[1]]} {parts[2]}" + (f" ({more})" if more else "")

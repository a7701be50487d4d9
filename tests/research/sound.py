"""`python -m tests.research sound`: how often the cross-examination accuses sound logs.

Each number draws a simulated world, a format in which the log goes out and comes back, a level of noise, and which of
truth, ids and map it has. Formats: open log folders and g2o graphs of our worlds; tables with velocities, poses or
steps of another robot (`tests/mistakes.py`), with steps observations are points.
"""

import contextlib
import io
import re
import tempfile
from collections import Counter
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from data.convert.__main__ import main as convert
from data.formats.g2o import Estimate, graph_text, log_of, read_graph
from data.formats.open_log import load_folder, write_folder
from data.log import Log
from data.notice import Code
from data.questions.asked import ask
from data.se2 import dead_reckoned
from data.truth import Truth
from data.words import sentence
from data.worlds.registry import parameters_of, simulate
from tests.mistakes import RATE, Tables, words, world, write

STREAM = 0x50D
NOISES = (0.3, 1.0, 3.0)
TABLES = ("velocities", "poses", "steps")
FORMATS = ("open", "g2o", *TABLES)
WORLDS: dict[str, dict[str, int]] = {
    "mixed": {}, "corridor": {}, "arena": {}, "linear": {}, "park": {"frames": 400}, "circle": {"frames": 400},
}  # fmt: skip
"""Worlds of points or walls, with their odometry; parameters other than the usual."""
NOISE = re.compile(r"sigma_(?!map|descriptor)|sr?(rho|phi)|s(x|y|theta)_(move|turn)|prior_sigma")
"""Parameters that are noise, not spreads of what is drawn."""


def of_world(folder: Path, kind: str, form: str, seed: int, noise: float, **parts: bool) -> Log:
    """The log of one of our worlds as a folder or graph."""
    values = parameters_of(kind)(**WORLDS[kind])
    own = [f.name for f in fields(values) if NOISE.match(f.name)]
    log = simulate(kind, replace(values, **{name: noise * getattr(values, name) for name in own}), seed)
    if form == "g2o":
        true, places = log.truth, log.truth.landmarks
        assert true.pose is not None
        assert true.landmark_of is not None
        assert places is not None
        poses = Estimate(true.pose, true.landmark_of, dict(zip(places.id.tolist(), places.xy, strict=True)))
        (folder / "log.g2o").write_text(graph_text(log.recorded, poses))
        return log_of("log", read_graph(folder / "log.g2o"), true=parts["truth"])
    truth = log.truth if parts["truth"] else Truth(landmark_of=log.truth.landmark_of, landmarks=log.truth.landmarks)
    recorded = log.recorded
    if not parts["ids"]:
        truth, log = replace(truth, landmark_of=None), replace(log, label=None)
    if not parts["known"]:
        truth, recorded = replace(truth, landmarks=None), replace(recorded, map=None)
    return write_folder(replace(log, recorded=recorded, truth=truth), folder / "log")


def of_tables(folder: Path, t: Tables, kind: str, **parts: bool) -> Log:
    """The log of tables of a kind of odometry; with steps observations are points."""
    write(folder, t)
    given = words(folder, t, **parts)
    if kind != "velocities":
        half = 0.5 * t.odometry[:, 2] / RATE
        chord = t.odometry[:, 1] / RATE * np.sinc(half / np.pi)
        steps = np.stack([chord * np.cos(half), chord * np.sin(half), 2.0 * half], axis=1)
        steps = np.vstack([np.zeros((1, 3)), steps[:-1]])
        table, names = (steps, "dx,dy,dtheta") if kind == "steps" else (dead_reckoned(np.zeros(3), steps), "x,y,theta")
        rows = np.column_stack([t.odometry[:, 0], table])
        np.savetxt(folder / "odometry.csv", rows, "%.9g", ",", header=f"t,{names}", comments="")
        a, b, c, d = t.sigmas
        sigma = f"{a / RATE**0.5:.6g},{0.1 * a / RATE**0.5:.6g},{b / RATE**0.5:.6g}"
        given[given.index("--odometry-sigma") + 1] = sigma
        given += ["--odometry-noise", "step"]
        if kind == "steps":
            _, r, bearing, _ = t.seen.T
            seen = np.column_stack([t.seen[:, 0], r * np.cos(bearing), r * np.sin(bearing), t.seen[:, 3]])
            form = ["%.9g", "%.9g", "%.9g", "%d"]
            np.savetxt(folder / "seen.csv", seen, form, ",", header="t,x,y,id", comments="")
            across = float(np.hypot(c, d * np.median(r)))
            given[given.index("--observation-sigma") + 1] = f"{across:.6g},{across:.6g}"
    with contextlib.redirect_stdout(io.StringIO()):
        assert convert(given) == 0
    return load_folder(folder / "log")


def study(logs: int, first: int) -> None:
    """Print each accusation and what else is asked, and their numbers."""
    accused, asked = Counter[str](), Counter[str]()
    for number in range(first, first + logs):
        rng = np.random.default_rng([number, STREAM])
        form, noise = FORMATS[number % len(FORMATS)], NOISES[number // len(FORMATS) % len(NOISES)]
        kind = str(rng.choice([*WORLDS][2 * (form == "g2o") :]))
        parts = dict(zip(("truth", "ids", "known"), (rng.random(3) < 0.6).tolist(), strict=True))
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            if form in TABLES:
                log, kind = of_tables(folder, world(number, noise), form, **parts), "robot"
            else:
                log = of_world(folder, kind, form, number, noise, **parts)
        for question in ask(log):
            (accused if question.code == Code.CONTRADICTION else asked)[question.code] += 1
            print(number, kind, form, noise, parts, sentence(question), flush=True)
        if number % 20 == 19:
            print(
                f"{accused.total()} of {number + 1 - first} sound logs accused; else asked: {dict(asked)}", flush=True
            )

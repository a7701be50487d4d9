"""`python -m tests.research.accusations [SEEDS]`: how often sound logs are accused, and how long it takes.

Every seed has three levels of noise and three kinds of tables: velocities with ranges and bearings, poses with them,
and steps with points. Each log has all its parts, or lacks the truth, the ids, the map, or all three.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from data.convert.__main__ import main as convert
from data.formats.open_log import load_folder
from data.log import Log
from data.questions.asked import ask
from data.se2 import dead_reckoned
from data.words import sentence
from tests.mistakes import RATE, Tables, words, world, write

PARTS: tuple[dict[str, bool], ...] = (
    {}, {"truth": False}, {"ids": False}, {"known": False}, {"truth": False, "known": False, "ids": False},
)  # fmt: skip
KINDS = ("velocities", "poses", "steps")


def made(folder: Path, t: Tables, kind: str, **parts: bool) -> Log:
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


def main(seeds: int) -> None:
    """Print each accusation, and the share."""
    accused, logs, spent = 0, 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(100, 100 + seeds):
            for noise in (0.3, 1.0, 3.0):
                for kind in KINDS:
                    for parts in PARTS:
                        log = made(Path(folder), world(seed, noise), kind, **parts)
                        begin = time.process_time()
                        found = ask(log)
                        spent, logs = spent + time.process_time() - begin, logs + 1
                        if found:
                            accused += 1
                            print(seed, noise, kind, parts, sentence(found[0]), flush=True)
            print(f"{accused} of {logs} sound logs accused; {1e3 * spent / logs:.0f} ms each", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)

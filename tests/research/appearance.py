"""What descriptors and classes are worth: decisions and errors with and without them, on aliased worlds.

`python -m tests.research.appearance [--seeds N] [WORLD ...]` prints a row for each world, method and choice: means over
the seeds of true and false decisions (final), median position RMSE [m], and in how many worlds fewer or more were
false. `--log FOLDER --classes K` does the same with a recorded log whose true ids are read as K classes, such as
barcodes of which a camera sees the colour alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data.appearance import Appearance
from data.command import Parser
from data.log import Log
from data.logs import open_log
from data.worlds.registry import named_log
from eval.referee.score import Trial, score
from eval.replay.run import compare

WORLDS = {
    # dense landmarks: several inside each gate; the descriptor's noise in shares of its spread
    "dense, descriptor 0.1": ("slam", "arena:{}:landmarks=100+frames=60+descriptor_sigma=0.1"),
    "dense, descriptor 0.3": ("slam", "arena:{}:landmarks=100+frames=60+descriptor_sigma=0.3"),
    "dense, 4 classes, 5 % wrong": ("slam", "arena:{}:landmarks=100+frames=60+classes=4"),
    "dense, 2 classes, 10 % wrong": ("slam", "arena:{}:landmarks=100+frames=60+classes=2+class_error=0.1"),
    # poor odometry and false alarms
    "drifting, 4 classes": ("slam", "arena:{}:frames=120+sigma_omega=0.06+clutter=1+landmarks=50+classes=4"),
    # four sides that look the same, with people
    "corridor with people, descriptor 0.1": ("slam", "corridor:{}:people+descriptor_sigma=0.1"),
    "corridor with people, 4 classes": ("slam", "corridor:{}:people+classes=4"),
    "blind corridor in its map, 4 classes": ("localization", "corridor:{}:people+no-odometry+classes=4"),
}
METHODS = ("nn", "jcbb", "jcbb-hindsight")


class Counts(NamedTuple):
    """Final decisions of a run, and its position RMSE [m], NaN where it failed."""

    tp: int
    tn: int
    fp: int
    fn: int
    rmse: float


def counts(log: Log, task: str, method: str, *, appearance: bool) -> Counts:
    """Of the EKF with a method on a log."""
    inputs = log.inputs() if appearance else log.inputs().without_appearance()
    (run,) = compare(inputs, task, ("ekf",), method)
    found = score([Trial(log, task, (run,))])
    final = found.association[found.association.phase == "final"].iloc[-1]
    return Counts(*(int(final[n]) for n in ("tp", "tn", "fp", "fn")), float(found.metrics.rmse_position_m.iloc[0]))


def as_classes(log: Log, count: int) -> Log:
    """The log with the class of each observation: its true id modulo `count`, at random for clutter."""
    ids = log.truth.landmark_of
    assert ids is not None
    m = len(ids)
    read = np.where(ids >= 0, ids % count, np.random.default_rng(0).integers(0, count, m))
    names = tuple(f"colour {k}" for k in range(count))
    looks = Appearance(np.full(m, np.nan), np.ones(m), read, np.full(m, 0.01), names)
    recorded = replace(log.recorded, observations=replace(log.recorded.observations, appearance=looks))
    return replace(log, recorded=recorded)


def rows(what: str, task: str, logs: Sequence[Log]) -> None:
    """Print the rows of some logs."""
    for method in METHODS:
        pairs = [[counts(log, task, method, appearance=on) for log in logs] for on in (False, True)]
        better = sum(on.fp < off.fp for off, on in zip(*pairs, strict=True))
        worse = sum(on.fp > off.fp for off, on in zip(*pairs, strict=True))
        for on, each in zip((False, True), pairs, strict=True):
            tp, tn, fp, fn = np.mean([c[:4] for c in each], axis=0)
            rmse = float(np.nanmedian([c.rmse for c in each]))
            row = (what, method, "with" if on else "without", f"{tp:.0f}", f"{tn:.0f}", f"{fp:.1f}", f"{fn:.1f}")
            change = f"{better} fewer, {worse} more" if on else ""
            print(" | ".join((*row, f"{rmse:.3f}", change)), flush=True)


def main() -> None:
    """Print the table."""
    parser = Parser(prog="python -m tests.research.appearance", description="What appearance is worth.")
    parser.add_argument("world", nargs="*", default=[], help=", ".join(WORLDS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--log")
    parser.add_argument("--classes", type=int, default=3)
    args = parser.parse_args()
    if args.log:
        log = as_classes(open_log(args.log), args.classes)
        for task in ("localization", "slam"):
            rows(f"{log.name}, {task}", task, [log])
        return
    for world in args.world or WORLDS:
        task, name = WORLDS[world]
        rows(world, task, [named_log(name.format(seed)) for seed in range(args.seeds)])


if __name__ == "__main__":
    main()

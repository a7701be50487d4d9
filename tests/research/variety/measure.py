"""Runs of association methods on the variety of worlds: a row each, kept in a CSV that an interrupted run goes on with.

SLAM by the EKF; RMSE is that of the online path, decisions and map are those at the end. Beside the methods stands
`known`, which is granted the labels: what a world allows at all.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from data.inputs import Inputs
from data.log import Log
from data.notice import Code
from data.result import Run
from data.worlds.registry import named_log
from eval.referee.errors import position_distance, rms
from eval.referee.plausibility import judged
from eval.referee.score import confusion_of
from eval.replay.batch import batch
from eval.replay.frontend import FrontEnd
from eval.replay.recorder import Observer
from eval.replay.run import step_by_step
from eval.replay.settings import HINDSIGHT
from graph.optimum import NotConvergedError
from tests.research.variety.worlds import draw, log_of

JCBB = "jcbb"
KNOWN = "known"
METHODS = (JCBB, HINDSIGHT, KNOWN)
LIMIT = 60.0  # s of wall time that a method has for a world
SLOW = "slow"  # Status of a run that was not done in time
OK = "ok"


class Row(NamedTuple):
    """One method on one world.

    number: the world's index; rmse_m: of the positions; fp, fn: decisions, of `readings`; landmarks: in the map in the
    end; visible: true ones read at least once, often: at least three times; seconds: wall time; status: that of the
    run, or `SLOW`; said_lost: 1 where the run says that it was lost while mapping, else 0; smoothed_m: RMSE of `batch`
    with the final decisions, infinite: not run or not smoothed.
    """

    number: int
    method: str
    world: str
    frames: int
    readings: int
    visible: int
    often: int
    rmse_m: float
    fp: int
    fn: int
    landmarks: int
    seconds: float
    status: str
    said_lost: int = 0
    smoothed_m: float = math.inf


class OutOfTimeError(Exception):
    """A run was not done in time."""


class Deadline(Observer):
    """An observer who ends a replay at the first frame that begins too late."""

    def __init__(self, seconds: float) -> None:
        self._end = time.perf_counter() + seconds

    def moved(self, front: FrontEnd) -> None:
        if time.perf_counter() > self._end:
            raise OutOfTimeError


def measure(log: Log, index: int, world: str, method: str, limit: float = LIMIT, *, smoothing: bool = False) -> Row:
    """One method on the log of a world; `smoothing`: `batch` smooths its final decisions, too."""
    who = log.truth.landmark_of
    assert who is not None
    times = np.bincount(who[who >= 0])
    size = (len(log.recorded), len(who), int((times > 0).sum()), int((times > 2).sum()))
    begin = time.perf_counter()
    inputs = log.inputs(labels=method == KNOWN).without_map()
    try:
        with threadpool_limits(1):
            run = step_by_step("ekf", inputs, "slam", method, observer=Deadline(limit))
    except OutOfTimeError:
        return Row(index, method, world, *size, math.nan, 0, 0, 0, time.perf_counter() - begin, SLOW)
    seconds = time.perf_counter() - begin
    (run,) = judged([run], inputs)
    said = any(note.code in (Code.MAP_RESTARTED, Code.RETRACTED) for note in run.notes)
    smoothed = _smoothed_rmse(run, inputs, log) if smoothing else math.inf
    return Row(index, method, world, *size, *_scores(run, log), seconds, run.status, int(said), smoothed)


def _smoothed_rmse(run: Run, inputs: Inputs, log: Log) -> float:
    """RMSE [m] of the final path by its final decisions; infinite where that cannot be smoothed."""
    assert log.truth.pose is not None
    try:
        with threadpool_limits(1):
            found = batch("batch", inputs, run)
    except NotConvergedError:
        return math.inf
    return math.inf if found.failure else rms(position_distance(found.trajectory("final").pose, log.truth.pose))


def _scores(run: Run, log: Log) -> tuple[float, int, int, int]:
    """RMSE [m], FP, FN and landmarks; NaN for the RMSE of a run that did not reach the end."""
    outcomes, truth = confusion_of(run, log, "final"), log.truth.pose
    assert outcomes is not None
    assert truth is not None
    rmse = rms(position_distance(run.trajectory("online").pose, truth)) if run.failure is None else math.nan
    return rmse, outcomes.fp, outcomes.fn, 0 if run.map is None else len(run.map)


def world_of(index: int, *, exact: bool = False) -> tuple[Log, str]:
    """Log and kind of a world of the variety; `exact`: see `draw`."""
    drawn = draw(index, exact=exact)
    return log_of(drawn), drawn.name.partition(":")[0]


def measure_all(
    indices: Sequence[int], done: Sequence[Row], limit: float = LIMIT, methods: Sequence[str] = METHODS, *,
    world: Callable[[int], tuple[Log, str]] = world_of, smoothing: bool = False,
) -> Iterator[Row]:  # fmt: skip
    """The methods on worlds of these indices, without what is done; `world`: log and kind of one. Compiles before."""
    known, more = {(r.number, r.method) for r in done}, {"smoothing": True} if smoothing else {}
    warm = named_log("arena:0:frames=20")
    for method in methods:
        measure(warm, -1, "arena", method)
    for index in indices:
        left = [m for m in methods if (index, m) not in known]
        if left:
            log, kind = world(index)
            for method in left:
                yield measure(log, index, kind, method, limit, **more)


def line_of(row: Row) -> str:
    return (
        f"{row.number:3d} {row.world:8s} {row.method:14s} {row.frames:5d} frames {row.readings:6d} readings:"
        f" RMSE {row.rmse_m:8.3f} m, FP {100 * row.fp / max(row.readings, 1):5.1f} %,"
        f" landmarks {row.landmarks:4d} of {row.visible:4d}, {row.seconds:6.1f} s, {row.status}"
    )

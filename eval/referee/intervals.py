"""Bootstrap intervals of one run, and of paired differences between a filter and a smoother.

Errors of successive frames are strongly correlated. The stationary bootstrap (Politis & Romano, JASA 1994) draws whole
stretches of the log, of random length with a given mean, and so keeps the correlation within them. The intervals assume
stationary errors and hold for this log, not for another one. docs/notes/verdicts.md has the measured coverage.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data.log import Log
from data.result import Run
from data.se2 import Array
from eval.referee.consistency import LEVEL
from eval.referee.errors import Along, aligned_distance
from eval.referee.given.runs import log_of

REPLICATES = 1000  # Bootstrap replicates: the 2.5 % point has a standard error of 0.5 % in level, p is at least 1/1001
SEED = 0  # seed of every run and pair, so that a run has the same interval wherever it is scored
MIN_FRAMES = 50  # least number of frames of an interval: with 30 the measured coverage is 89 % even without correlation
LONGEST = 0.1  # largest mean block, as a share of the frames: ten blocks
MIN_INDEPENDENT = 20.0  # Least number of independent frames; below, coverage is 20 to 80 % (docs/notes/verdicts.md)
ONE_DRAW = "in SLAM the error of the frame is one draw, which no part of the log shows"
CHUNK = 500_000  # blocks drawn at once, for 50 MB of memory


@dataclass(frozen=True)
class Interval:
    """A number of one log with its 95 % interval; NaN where there is none."""

    value: float
    lower: float = math.nan
    upper: float = math.nan
    p: float = math.nan  # two-sided, of a difference of zero
    block: float = math.nan  # mean length of the blocks [frames], also one that is too long for an interval
    why: str = ""  # clause that explains a missing interval


def intervals(
    squared_errors: Array | tuple[Array, Array], nees: Array | tuple[Array, Array], rng: np.random.Generator
) -> tuple[Interval, Interval]:
    """Intervals of position RMSE [m] and mean pose NEES of one run, in blocks of the longer estimated mean length.

    Of two runs on the same frames those of the differences, first minus second, with p of "no difference"; both share
    the blocks, so that common errors cancel. p is about the mean squares and the mean NEES: with T the difference of
    the two means and T* a resampled one, p = (1 + #{|T* - T| >= |T|}) / (1 + replicates) (Davison & Hinkley, Bootstrap
    Methods and their Application, 1997, section 4.4). The block length is estimated on the differences by frame.

    `squared_errors` (N,) [m²] of the positions and `nees` (N,) of the poses; a frame with NaN is left out.
    """
    every = (np.atleast_2d(values).T for values in (squared_errors, nees))
    parts = [columns[np.isfinite(columns).all(axis=1)] for columns in every]
    lengths, whys = zip(*(_length(_contrast(part)) for part in parts), strict=True)
    block = max((length for length, why in zip(lengths, whys, strict=True) if not why), default=math.nan)
    found = []
    for part, length, why, root in zip(parts, lengths, whys, (True, False), strict=True):
        value = float(_statistic(part.mean(axis=0), root)) if len(part) else math.nan
        found.append(Interval(value, block=length, why=why) if why else _interval(part, value, block, rng, root=root))
    return found[0], found[1]


def _contrast(columns: Array) -> Array:
    return columns[..., 0] if columns.shape[-1] == 1 else columns[..., 0] - columns[..., 1]


def _statistic(means: Array, root: bool) -> Array:
    return _contrast(np.sqrt(means) if root else means)


def _length(series: Array) -> tuple[float, str]:
    """Mean block length [frames] of a series (n,), and why it allows no interval (empty: it does)."""
    n = len(series)
    if n == 0:
        return math.nan, "no frame has a true pose and, for NEES, a covariance to compare with"
    if n < MIN_FRAMES:
        return math.nan, f"{n} frames with truth are too few, {MIN_FRAMES} are needed"
    if np.ptp(series) <= 1e-12 * np.abs(series).max():
        return math.nan, "the compared values do not vary along the log"
    length, worth = block_length(series), independent_frames(series)
    if worth < MIN_INDEPENDENT:
        worth_of = f"{n} frames with truth are worth about {worth:.0f} independent ones"
        return length, f"errors are so correlated that {worth_of}, {MIN_INDEPENDENT:.0f} are needed"
    if length > LONGEST * n:
        return length, f"errors are correlated over about {length:.0f} frames, more than a tenth of the {n} with truth"
    return length, ""


def independent_frames(series: Array) -> float:
    """Effective number of independent values in a series (n,) that varies: n over the sum of autocorrelations.

    Sums of two successive lags are added while they are positive, none larger than the previous one (Geyer, Statistical
    Science 1992, section 3.3).
    """
    n = len(series)
    covariance = np.fft.irfft(np.abs(np.fft.rfft(series - series.mean(), 2 * n)) ** 2)[: n - n % 2]
    pairs = covariance[::2] + covariance[1::2]
    end = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else len(pairs)
    sums = float(np.minimum.accumulate(pairs[:end]).sum()) / covariance[0]
    return float(n / max(2.0 * sums - 1.0, 1.0))


def block_length(series: Array) -> float:
    """Mean block length [frames], at least 1, of the stationary bootstrap for a series (n,) that varies.

    Politis & White, Econometric Reviews 23, 2004, with the correction of Patton, Politis & White, 28, 2009. Lags count
    up to twice the last one before K = max(5, log10 n) autocorrelations in a row are insignificant; no block is longer
    than 3 sqrt(n) or a third of the series.
    """
    n = len(series)
    error = series - series.mean()
    in_a_row = max(5, int(np.log10(n)))
    most = math.ceil(math.sqrt(n)) + in_a_row
    covariance, correlation = np.empty(most + 1), np.empty(most + 1)
    for lag in range(most + 1):
        product = error[lag:] @ error[: n - lag]
        # scaled without one more value at either end, as in Patton's program and `arch`
        later, earlier = error[lag + 1 :], error[: -lag - 1]
        covariance[lag] = product / n
        correlation[lag] = abs(product) / np.sqrt((later @ later) * (earlier @ earlier))
    small = correlation[:-1] < 2.0 * np.sqrt(np.log10(n) / n)
    runs = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(small, in_a_row).all(axis=1))
    lags = min(2 * max(int(runs[0]), 1), most) if len(runs) else most
    k = np.arange(1, lags + 1)  # weights of the flat-top lag window: 1 up to half of the lags, down to 0 at the last
    weight, significant = 2.0 * np.minimum(1.0, 2.0 * (1.0 - k / lags)), covariance[1 : lags + 1]
    slope, spectrum = sum(weight * k * significant), sum(weight * significant, start=covariance[0])
    length = (slope**2 / spectrum**2) ** (1 / 3) * n ** (1 / 3)
    return float(np.clip(length, 1.0, np.ceil(min(3.0 * np.sqrt(n), n / 3.0))))


def _interval(values: Array, value: float, block: float, rng: np.random.Generator, *, root: bool) -> Interval:
    means = resampled_means(values, block, rng)
    tail = 0.5 * (1.0 - LEVEL)
    lower, upper = np.quantile(_statistic(means, root), (tail, 1.0 - tail))
    p = math.nan
    if values.shape[1] == 2:
        difference = float(_contrast(values.mean(axis=0)))
        p = (1 + np.count_nonzero(np.abs(_contrast(means) - difference) >= abs(difference))) / (1 + len(means))
    return Interval(value, float(lower), float(upper), float(p), block)


def resampled_means(values: Array, block: float, rng: np.random.Generator, replicates: int = REPLICATES) -> Array:
    """Means (replicates, k) of the columns of `values` (n, k) over n rows drawn by the stationary bootstrap.

    Blocks begin anywhere on the log closed to a ring and have geometric lengths with mean `block` >= 1; the last one is
    cut at n rows (Politis & Romano 1994, section 2). Cumulative sums make the cost that of blocks, not of rows.
    """
    n, k = values.shape
    twice = np.zeros((2 * n + 1, k))
    np.cumsum(np.concatenate([values, values]), axis=0, out=twice[1:])
    # number of blocks: eight standard deviations above its mean
    width = min(n, math.ceil(n / block + 8.0 * math.sqrt(n / block)) + 1)
    scale = -1.0 / math.log1p(-1.0 / block) if block > 1.0 else 0.0  # the whole part of an exponential is geometric
    at_once = max(1, CHUNK // width)
    sums = np.empty((replicates, k))
    for first in range(0, replicates, at_once):
        rows = min(at_once, replicates - first)
        ends = np.cumsum(1.0 + np.floor(scale * rng.standard_exponential((rows, width))), axis=1)
        ends[:, -1] = n
        length = np.diff(np.minimum(ends, n).astype(np.int64), axis=1, prepend=0)
        start = rng.integers(n, size=(rows, width))
        sums[first : first + rows] = (twice[start + length] - twice[start]).sum(axis=1)
    return np.asarray(sums / n)


def difference_rows(
    log: Log, task: str, runs: Sequence[Run], errors: Mapping[tuple[int, str], Along]
) -> list[dict[str, object]]:
    """Rows of filters (online) against smoothers (final) under the same association method, see `intervals`.

    `errors` are by index in `runs` and phase. A run without a final path is a filter; implausible runs are left out.
    In SLAM, where the error of the frame is one draw, RMSEs are compared after alignment, and NEES has no interval.
    """
    rows: list[dict[str, object]] = []
    kept = {(i, p) for i, p in errors if runs[i].flaw is None and log_of(runs[i], log) is log}
    filters = [(r, errors[i, "online"]) for i, r in enumerate(runs) if r.final is None and (i, "online") in kept]
    smoothers = [(r, errors[i, "final"]) for i, r in enumerate(runs) if (i, "final") in kept]
    alike = ((a, b) for a in filters for b in smoothers if a[0].association == b[0].association)
    for (a, ours), (b, theirs) in alike:
        squares, values = (ours.distance**2, theirs.distance**2), (ours.nees["pose"], theirs.nees["pose"])
        if task == "slam" and log.truth.pose is not None:
            online, final = a.trajectory("online").pose, b.trajectory("final").pose
            squares = aligned_distance(online, log.truth.pose) ** 2, aligned_distance(final, log.truth.pose) ** 2
        rmse, nees = intervals(squares, values, np.random.default_rng(SEED))
        if task == "slam":
            nees = Interval(nees.value, block=nees.block, why=ONE_DRAW)
        row: dict[str, object] = {"log": log.name, "task": task, "association": a.association}
        row |= {"a": a.estimator, "b": b.estimator, "phase_a": "online", "phase_b": "final"}
        row |= {"rmse_position_m": rmse.value, "nees_pose": nees.value}
        row["block_frames"] = rmse.block if not rmse.why else nees.block
        for name, found in (("rmse_position", rmse), ("nees_pose", nees)):
            row |= {f"{name}_lower": found.lower, f"{name}_upper": found.upper, f"{name}_p": found.p}
            row[f"{name}_why"] = found.why or None
        rows.append(row)
    return rows

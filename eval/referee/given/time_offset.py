"""The offset between the clocks of an estimate and its truth, from their speeds and turn rates.

Neither depends on the frames of the two paths; without headings the speed alone tells. With independent Gaussian
residuals of unknown variance, minus twice the log-likelihood of an offset is N sum(log MSE) over the rates, N the
number of independent samples. All offsets with half of the shorter path in common are tried by correlation, and the
best is refined.
"""

import math

import numpy as np
import scipy

from data.errors import DataError
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.timeline import MAX_GAP

HALF = 0.25  # s either side of an instant for its rates, or one and a half steps of the slower path if longer
MOST = 2**16  # largest number of instants of a path
TOGETHER = 0.5  # least share of the shorter path in common with the other
APART = 9.0  # least difference of -2 log-likelihood from any other maximum: 3 standard errors
WIDE, RATE = (
    0.04,
    0.01,
)  # Most seconds, as a share of the path, that halves differ from the whole; least difference of rates
EXACT = 1e-8  # least mean squared residual, as a share of the truth's mean square


class _Path:
    """Known poses of a path, to interpolate: stamps (n,) [s], x, y and unwrapped heading (n, 3); without any (n, 2)."""

    def __init__(self, time: Array, pose: Array) -> None:
        pose = pose if np.isfinite(pose[:, 2]).any() else pose[:, :2]
        known = np.isfinite(pose).all(axis=1)
        self.time = np.asarray(time)[known]
        self.values = np.column_stack([pose[known, :2], *np.unwrap(pose[known, 2:].T)])
        self.step = float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0

    def rates(self, at: Array, half: float) -> tuple[Array, BoolArray]:
        """Speed and turn rate (m, 2) at instants (m,), without headings (m, 1), and where they are known."""
        ends = []
        known = np.ones(len(at), bool)
        for t in (at - half, at + half):
            after = np.clip(np.searchsorted(self.time, t), 1, len(self.time) - 1)
            known &= (t >= self.time[0]) & (t <= self.time[-1])
            known &= self.time[after] - self.time[after - 1] <= max(MAX_GAP, 3.0 * self.step)
            ends.append(np.column_stack([np.interp(t, self.time, v) for v in self.values.T]))
        moved = ends[1] - ends[0]
        rates = np.column_stack([np.hypot(moved[:, 0], moved[:, 1]), moved[:, 2:]]) / (2.0 * half)
        return np.where(known[:, None], rates, 0.0), known


def time_offset(file: str, time: Array, pose: Array, truth_time: Array, truth: Array) -> tuple[float, float]:
    """Seconds to add to the stamps (n,) of an estimate (n, 3) beside a truth (K, 3) at stamps (K,); standard error.
    Raises DataError with `file` where no offset stands out: steady motion, or repeated laps.
    """
    a, b = _Path(time, pose), _Path(truth_time, truth)
    shared = min(a.values.shape[1], b.values.shape[1])  # headings count where both have some
    a.values, b.values = a.values[:, :shared], b.values[:, :shared]
    if min(len(a.time), len(b.time)) < 3:
        raise DataError.at(file, "--time-offset auto: fewer than three poses; state the offset")
    half = max(HALF, 1.5 * a.step, 1.5 * b.step)
    spans = a.time[-1] - a.time[0], b.time[-1] - b.time[0]
    dt = max(min(a.step, b.step), max(spans) / MOST)
    grids = [p.time[0] + dt * np.arange(int(span / dt) + 1) for p, span in zip((a, b), spans, strict=True)]
    (of_a, known_a), (of_b, known_b) = a.rates(grids[0], half), b.rates(grids[1], half)
    if not (known_a.any() and known_b.any()):
        raise DataError.at(file, "--time-offset auto: the path is too short for rates; state the offset")
    floor = EXACT * np.mean(of_b[known_b] ** 2, axis=0) + 1e-18
    cost, lags = _costs(of_a, known_a, of_b, known_b, floor)
    samples = TOGETHER * min(known_a.sum(), known_b.sum()) * dt / (2.0 * half)
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        raise DataError.at(file, "--time-offset auto: gaps leave too little in common with the truth; state the offset")
    shift = grids[1][0] - grids[0][0]

    def value(offset: float, part: BoolArray) -> float:
        at, known = b.rates(grids[0] + offset, half)
        both = known & known_a & part
        return float(np.log(np.mean((of_a[both] - at[both]) ** 2, axis=0) + floor).sum()) if both.any() else math.inf

    start = float(shift + lags[best] * dt)
    found = scipy.optimize.minimize_scalar(
        lambda more: value(start + more, known_a),
        bounds=(-2.0 * dt, 2.0 * dt),
        method="bounded",
        options={"xatol": 1e-5 * dt},
    )
    seconds, least = start + float(found.x), float(found.fun)
    (here, known), (later, soon), (sooner, just) = (b.rates(grids[0] + seconds + d, half) for d in (0.0, dt, -dt))
    both = known & known_a & soon & just
    if not both.any():
        raise DataError.at(file, "--time-offset auto: too little in common with the truth; state the offset")
    slope = (later[both] - sooner[both]) / (2.0 * dt)
    square = np.mean((of_a[both] - here[both]) ** 2, axis=0) + floor
    information = float((np.mean(slope**2, axis=0) / square).sum()) * both.sum() * dt / (2.0 * half)
    error = 1.0 / math.sqrt(information) if information > 0.0 else math.inf
    elsewhere = np.abs(lags - lags[best]) * dt > 2.0 * half
    rival = float(cost[elsewhere].min(initial=math.inf))
    if error > half or samples * (rival - least) < APART:
        why = "the motion is steady" if math.isinf(rival) or error > half else "another fits about as well: laps?"
        what = f"--time-offset auto: no offset stands out ({why})"
        raise DataError.at(file, f"{what}; state it, as in --time-offset {seconds:.6g}")
    span, middle = float(np.ptp(grids[0][both])), float(np.median(grids[0][both]))
    parts, wide = (grids[0] < middle, grids[0] >= middle), np.linspace(-WIDE, WIDE, 81) * span
    each = [np.array([value(seconds + w, part) for w in wide]) for part in parts]
    first, last = (float(wide[np.argmin(costs)]) for costs in each)
    gain = sum(0.5 * samples * float(costs[len(wide) // 2] - costs.min()) for costs in each)
    if abs(rate := 2.0 * (last - first) / span) > RATE and gain > APART:
        what = f"--time-offset auto: the clocks run at different rates, by {100.0 * rate:.2g} %"
        raise DataError.at(file, f"{what}; stamps of one clock are needed")
    return seconds, error


def _costs(a: Array, known_a: BoolArray, b: Array, known_b: BoolArray, floor: Array) -> tuple[Array, IntArray]:
    """Sum of log MSE at each lag of samples (m, 2) behind (k, 2), infinite with too little in common; and the lags."""
    ma, mb = known_a.astype(float), known_b.astype(float)

    def over(x: Array, y: Array) -> Array:
        """Sums over i of x[i] y[i + lag]."""
        return np.asarray(scipy.signal.correlate(y, x, mode="full", method="fft"))

    count = np.rint(over(ma, mb))
    enough = count >= TOGETHER * min(ma.sum(), mb.sum())
    cost = np.zeros(len(count))
    for c in range(a.shape[1]):
        square = over(a[:, c] ** 2, mb) + over(ma, b[:, c] ** 2) - 2.0 * over(a[:, c], b[:, c])
        cost += np.log(np.maximum(square, 0.0) / np.maximum(count, 1.0) + floor[c])
    return np.where(enough, cost, np.inf), np.arange(len(count), dtype=np.int64) - (len(a) - 1)

"""A result and its truth made comparable: one unit of stamps, one pair of frames, and questions about what differs.

The offset between their clocks is found from their speeds and turn rates, which do not depend on the frames of the two
paths; without headings the speed alone tells. With independent Gaussian residuals of unknown variance, minus twice the
log-likelihood of an offset is N sum(log MSE) over the rates, N the number of independent samples. All offsets with half
of the shorter path in common are tried by correlation, and the best is refined.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import scipy

from data import se2, se3
from data.errors import DataError
from data.formats.recordings.ros import TRANSFORMS, Tree, bare
from data.formats.results import path as paths
from data.formats.results.path import ROWS, Clock, GivenPath, Spatial, restamped
from data.formats.results.space import flattened, in_frame, translation_first
from data.inputs import IntArray
from data.notice import Code, Notice, notice
from data.questions.examination import LEAST, heading_unit, paths_otherwise
from data.questions.readings import TINY, Kind
from data.se2 import Array, BoolArray, compose, interpolate, rigid_fit, wrap_angle
from data.timeline import MAX_GAP, truth_at, usual_gap
from data.truth_windows import leaps
from eval.referee.consistency import nees
from eval.referee.errors import aligned_distance, rms
from eval.referee.given.in_space import NONE, SAME_VERTICAL, SE3, SIM3, YAW, InSpace, Poses, aligning, poses, tilts
from eval.referee.given.runs import around

HALF = 0.25  # s either side of an instant for its rates, or one and a half steps of the slower path if longer
MOST = 2**16  # largest number of instants of a path
TOGETHER = 0.5  # least share of the shorter path in common with the other
APART = 9.0  # least difference of -2 log-likelihood from any other maximum: 3 standard errors
WIDE, SLOW = 0.04, 0.01  # most seconds, as a share of the path, that halves differ by; least difference of rates
COVERED = 0.9  # least share of poses within the other path's of which nothing is said
LEAPT = 2.0  # least ratio of errors after and before a track is lost
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
        lambda more: value(start + more, known_a), bounds=(-2.0 * dt, 2.0 * dt), method="bounded",
        options={"xatol": 1e-5 * dt},
    )  # fmt: skip
    seconds, least = start + float(found.x), float(found.fun)
    (here, known), (later, soon), (sooner, just) = (b.rates(grids[0] + seconds + d, half) for d in (0.0, dt, -dt))
    both = known & known_a & soon & just
    if not both.any():
        raise DataError.at(file, "--time-offset auto: too little in common with the truth; state the offset")
    slope = (later[both] - sooner[both]) / (2.0 * dt)
    square = np.mean((of_a[both] - here[both]) ** 2, axis=0) + floor
    information = float((np.mean(slope**2, axis=0) / square).sum()) * both.sum() * dt / (2.0 * half)
    error = 1.0 / math.sqrt(information) if information > 0.0 else math.inf
    rival = float(cost[np.abs(lags - lags[best]) * dt > 2.0 * half].min(initial=math.inf))
    if error > half or samples * (rival - least) < APART:
        why = "the motion is steady" if math.isinf(rival) or error > half else "another fits about as well: laps?"
        what = f"--time-offset auto: no offset stands out ({why})"
        raise DataError.at(file, f"{what}; state it, as in --time-offset {seconds:.13g}")
    span, middle = float(np.ptp(grids[0][both])), float(np.median(grids[0][both]))
    parts, wide = (grids[0] < middle, grids[0] >= middle), np.linspace(-WIDE, WIDE, 81) * span
    each = [np.array([value(seconds + w, part) for w in wide]) for part in parts]
    first, last = (float(wide[np.argmin(costs)]) for costs in each)
    gain = sum(0.5 * samples * float(costs[len(wide) // 2] - costs.min()) for costs in each)
    if abs(rate := 2.0 * (last - first) / span) > SLOW and gain > APART:
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


FEW, PLENTY = 5, 20  # least number of matched poses for a question about both files; about their clocks and frames


def same_clock(a: GivenPath, b: GivenPath, name: str, *, moved: bool = False) -> tuple[GivenPath, GivenPath]:
    """Both with stamps in s; a unit inferred by rate gives way where the plain numbers fit the other file better.

    Files without stamps, or whose stamps count rows, get those of the other. DataError where the spans of both and
    their steps differ by the same power of a thousand, or where two files, of which one has no stamps, have unequal
    numbers of poses; `name` is that of `a` in flags; `moved`: by how much is stated, from the first rows on.
    """
    every = [f.time if f.every is None else f.every for f in (a, b)]
    every = every if (same := len(every[0]) == len(every[1])) else [a.time, b.time]
    for lacking, other, (own, theirs) in ((a, b, every), (b, a, every[::-1])):
        if lacking.clock.by != ROWS and not _counts_rows(lacking, other):
            continue
        k = rows_apart(a, b) if not same and not moved else 0
        if k is None:
            if lacking.clock.by != ROWS:
                continue
            what = f"{len(lacking)} poses without stamps, and {len(other)} of {other.file}: which belong together?"
            flag = f"--times {name if lacking is a else 'truth'}=FILE, a stamp [s] a line"
            where = f"--time-offset {name}=0 where both begin together"
            raise DataError.at(lacking.file, f"{what} As many in both are needed, or {flag}, or {where}{lacking.runs}")
        at = np.searchsorted(own, lacking.time) + (k if lacking is a else -k)
        time = np.interp(at, np.arange(len(theirs)), theirs)
        time += (at - np.clip(at, 0, len(theirs) - 1)) * float(np.median(np.diff(theirs)))
        why = ", before --time-offset" if moved else ", as motions fit best so" * (not same)
        said = f"inferred: row {1 + max(0, -k)} of {a.file} is of row {1 + max(0, k)} of {b.file}{why}"
        told = a if lacking.clock.by == ROWS and same else replace(a, notes=(*a.notes, said))
        return (restamped(told, time, b.clock), b) if lacking is a else (told, restamped(b, time, a.clock))
    a, b = _plain_if_better(a, b), _plain_if_better(b, a)
    (span_a, step_a), (span_b, step_b) = _span(a), _span(b)
    if {a.clock.by, b.clock.by} & {paths.ASSUMED, paths.RATE} and min(span_a, span_b, step_a, step_b) > 0.0:
        for name, factor in [*((n, 10.0**digits) for n, digits in paths.DIGITS.items()), ("min", 60.0)]:
            for slow, fast, spans, steps in (
                (a, b, span_a / span_b, step_a / step_b),
                (b, a, span_b / span_a, step_b / step_a),
            ):
                if factor > 1.0 and abs(spans / factor - 1.0) < 0.1 and 1.0 / 3.0 < steps / factor < 3.0:
                    what = f"stamps span {_span(slow)[0]:.6g} s, those of {fast.file} {_span(fast)[0]:.6g} s"
                    ask = f"are they {name} in one of the two? State the units: --unit NAME={name}, --unit NAME=s"
                    raise DataError.at(slow.file, f"{what}: {ask}")
    return a, b


SHIFTS, MANY, KEPT, CLEARLY = 2, 100, 0.9, 0.5  # most rows apart; fewest poses; share compared; ratio to other errors


def rows_apart(a: GivenPath, b: GivenPath, at: int = 0) -> int | None:
    """By how many rows motions of `a` are earlier in it than in `b`, where one number fits clearly best; None: none."""
    more, steps, off = len(b) - len(a), list[Array](), dict[int, float]()
    flat = any(f.space is None or not np.isfinite(f.space.rotation).all() for f in (a, b))
    if min(len(a), len(b)) < MANY or abs(more) > FEW:
        return None
    for f in (a, b):
        place, turned = f.pose[:, :2], wrap_angle(np.diff(f.pose[:, 2]))
        if f.space is not None and not flat:
            place, turned = f.space.position, se3.angle_between(f.space.rotation[:-1], f.space.rotation[1:])
        each = np.abs([np.linalg.norm(np.diff(place, axis=0), axis=1), turned])
        steps.append(each / np.maximum(np.sort(each)[:, : int(KEPT * len(f))].mean(axis=1, keepdims=True), TINY))
    for k in range(min(0, more) + at - SHIFTS, max(0, more) + at + SHIFTS + 1):
        i = np.arange(max(0, -k), min(len(a), len(b) - k) - 1)
        each = np.sort(np.abs(steps[0][:, i] - steps[1][:, i + k]))[:, : int(KEPT * len(i))].mean(axis=1)
        off[k] = float(np.prod(each[np.isfinite(each)]))
    best, second, *_ = sorted(off, key=lambda k: off[k])
    return best if off[best] < CLEARLY * off[second] else None


def _span(path: GivenPath) -> tuple[float, float]:
    """Span and median step of the stamps [s]."""
    return (0.0, 0.0) if len(path) < 2 else (float(path.time[-1] - path.time[0]), float(np.median(np.diff(path.time))))


def _plain_if_better(path: GivenPath, other: GivenPath) -> GivenPath:
    """A path whose unit was inferred by its rate, with stamps in s where the other's span fits those better."""
    if path.clock.by != paths.RATE or other.clock.unit != "s":
        return path
    plain = path.time * 10.0 ** paths.DIGITS[path.clock.unit]
    better = _overlap(plain, other.time) > 2.0 * _overlap(path.time, other.time)
    return restamped(path, plain, Clock("s", paths.ASSUMED)) if better else path


def _counts_rows(path: GivenPath, other: GivenPath) -> bool:
    """Whether stamps count rows, and those of the other are elsewhere."""
    counts = path.clock.by == paths.ASSUMED and min(len(path), len(other)) > FEW and (np.diff(path.time) == 1.0).all()
    return bool(counts and not _overlap(path.time, other.time))


def _overlap(time: Array, other: Array) -> float:
    common = min(time[-1], other[-1]) - max(time[0], other[0])
    whole = max(time[-1], other[-1]) - min(time[0], other[0])
    return max(float(common / whole), 0.0) if whole > 0.0 else 0.0


def same_frames(path: GivenPath, truth: GivenPath, align: str) -> tuple[GivenPath, list[Notice]]:
    """The estimate in the stated frames of the truth, by transforms of either file; a question where none is known."""
    if path.space is None or truth.space is None:
        return path, []
    ours, theirs = path.space.stated, truth.space.stated
    trees = tuple(t for t in (path.transforms, truth.transforms) if isinstance(t, Tree))
    asked = []
    for of, own, other in (("world", ours.world, theirs.world), ("body", ours.body, theirs.body)):
        own_tf = of == "world" and truth.space.kind == TRANSFORMS  # of which the estimate would be made, too
        moved = in_frame(
            path, of, other, () if own_tf else trees, still=of == "body" or align != NONE
        )  # a localizer corrects a world
        if moved is not None:
            path = moved
        elif align == NONE or of == "body":
            asked.append(notice(Code.FRAMES_DIFFER, of=of, estimate=bare(own), truth=bare(other)))
    return path, asked


def called(questions: Iterable[Notice], names: Mapping[str, str]) -> list[Notice]:
    """The questions with the names by which flags call their files (`names` by file)."""
    made = []
    for q in questions:
        if FLAGS not in q.named:
            made.append(q)
            continue
        file = str(next((q.named[k] for k in ("file", "estimate", "of") if k in q.named), ""))
        flags = tuple(flag.replace("NAME", names.get(file, "NAME")) for flag in cast("tuple[str, ...]", q.named[FLAGS]))
        made.append(replace(q, values=tuple(sorted({**q.named, FLAGS: flags}.items()))))
    return made


FLAGS = "flags"  # value of a question: what is typed if it is right, with NAME for what its file is called


@dataclass(frozen=True, eq=False)
class Pair:
    """An estimate and its truth: the whole files, and true poses at the estimate's stamps (n, 3), NaN where unknown."""

    estimate: GivenPath
    truth: GivenPath | None
    at: Array
    space: InSpace | None = None  # of both in space, as scored
    aligned: bool = False

    @property
    def in_rows(self) -> bool:
        """Whether rows of one file, with one stamp each, hold both."""
        one = self.truth is not None and self.truth.file == self.estimate.file
        return one and bool(np.isin(self.estimate.time, cast("GivenPath", self.truth).time).all())


def about_file(path: GivenPath) -> Iterator[Notice]:
    """Questions about one file."""
    if _first_is_w(path):
        yield notice(Code.PATH_QUATERNIONS, file=path.file)
    else:
        yield from _axes(path)
    if path.headings is not None:
        pose = np.column_stack([path.pose[:, :2], path.headings])
        yield from heading_unit(path.file, path.time, pose, "--unit NAME=deg")


FLAT, STEEP = 0.1, 0.2


def _axes(path: GivenPath) -> Iterator[Notice]:
    """Positions that vary in a plane that is not the ground of the axes they were read in."""
    s = path.space
    if s is None or len(s) < 2:
        return
    x, y, z = np.ptp(s.position, axis=0).tolist()
    # in the file's own axes x is -y, y is -z, and z is x of the robot's
    for wanted, flattest, low, wide, extent in (("camera", "y", y, x, (x, y, z)), ("robot", "z", x, y, (y, z, x))):
        if low <= wide and low < FLAT * z and z > STEEP * wide and bool(s.stated.axes) == (wanted == "robot"):
            flag = f"--axes NAME={'-'.join(filter(None, (s.stated.inverse, wanted)))}"
            yield notice(Code.PATH_AXES, file=path.file, wanted=wanted, flattest=flattest, extent=extent, flags=(flag,))


def about_pair(pair: Pair) -> Iterator[Notice]:
    """Questions that estimate and truth raise together."""
    both = np.concatenate([pair.at, pair.estimate.pose], axis=1)
    known: BoolArray = np.isfinite(both).all(axis=1)
    placed: BoolArray = np.isfinite(both[:, [0, 1, 3, 4]]).all(axis=1)
    bad, asked = _leaps(pair, placed)
    known, placed = known & ~bad, placed & ~bad
    yield from asked
    if own := leaps(*_of_positions(pair.estimate.pose, np.where(placed[:, None], pair.at, np.nan))):
        first, last = zip(*own, strict=True)
        back = first[0] > 0 and last[-1] + 1 < len(pair.estimate)
        yield notice(Code.PATH_OUTLIERS, file=pair.estimate.file, first=first, last=last, back=back)
    yield from _track_lost(pair, np.flatnonzero(placed))
    t, ours = pair.truth, pair.estimate
    yield from _coverage(ours, t) if t is not None and t.clock.by != ROWS and placed.any() else ()
    states = t is not None and t.space is not None and t.space.stated.world  # a message, which has room for them
    if t is not None and t.file != ours.file and t.covariance is not None and ours.covariance is None and not states:
        yield notice(Code.PATH_SWAPPED, estimate=ours.file, truth=t.file)
    yield from _order(pair, known)
    if t is not None and not pair.in_rows and t.clock.by == ours.clock.by == ROWS and len(t) == len(ours):
        at = round(float(ours.time[0] - t.time[0]))
        if (k := rows_apart(ours, t, at)) not in (None, at):
            yield notice(Code.PATH_SHIFT, file=ours.file, other=t.file, flags=(f"--time-offset NAME={k}",))
    files = [about_file(f) for f in (pair.estimate, pair.truth) if f is not None]
    alone = [question for asked in files for question in asked]  # which explain what both say together
    tilted = [] if t is None or pair.space is None else [*_tilt(ours, t, pair.space)]
    found = [*_otherwise(pair, known, placed)] if placed.sum() >= FEW and not alone else []
    if any(q.named.get("tips") for q in tilted):  # headings alone do not explain rotations that differ
        found = [q for q in found if "theta" not in str(q.named["of"]) or cast("float", q.named["fits"]) < 2.0 * FITS]
    rows = known if known.any() else placed
    yield from found or (_clock_and_frame(pair, rows) if rows.sum() >= PLENTY and not alone else ())
    yield from tilted


def _coverage(*paths: GivenPath) -> Iterator[Notice]:
    """Whether a tenth of the poses of one of two paths is where the other has none."""
    files = [(f.file, f.time[np.isfinite(f.pose[:, :2]).all(axis=1)]) for f in paths]
    least = max(usual_gap(time, math.inf) for _, time in files)
    for (file, time), (other, at) in (files, files[::-1]):
        gaps, share = np.diff(np.clip(time, at[0], at[-1]), prepend=at[0], append=at[-1]), around(at, time, least)[2]
        if (inside := float(np.isfinite(share).mean())) < COVERED and gaps.max() > least:
            said = dict[str, Any](gaps=int((gaps > least).sum()), longest=float(gaps.max()), least=least, poses=len(at))
            yield notice(Code.COVERAGE, file=file, other=other, share=inside, **said)


def _track_lost(pair: Pair, rows: IntArray) -> Iterator[Notice]:
    """The first of rows (n,) from which on all errors exceed twice those before by more than the truth's steps."""
    ours, theirs = pair.estimate.pose[rows, :2], pair.at[rows, :2]
    if pair.space is not None:
        ours, theirs = poses(pair.space.estimate).position[rows], pair.space.truth.position[rows]
    off, step = (np.linalg.norm(d, axis=1) for d in (ours - theirs, np.diff(theirs, axis=0)))
    before, after = np.maximum.accumulate(off), np.minimum.accumulate(off[::-1])[::-1]
    least = np.maximum(LEAPT * before, before + step.max(initial=0.0))[PLENTY - 1 : -FEW]
    for k in PLENTY + np.flatnonzero(after[PLENTY : 1 - FEW] > least)[:1]:
        said = dict[str, Any](before=float(before[k - 1]), after=float(after[k]), rmse=rms(off[:k]))
        said |= {"file": pair.estimate.file, "stamp": float(pair.estimate.time[rows[k]])}
        yield notice(Code.TRACK_LOST, int(rows[k]), **said)


def _leaps(pair: Pair, placed: BoolArray) -> tuple[BoolArray, list[Notice]]:
    """Where (n,) the truth leaps away from the estimate's way and comes back, and what is asked then."""
    truth, estimate = pair.truth, pair.estimate
    if truth is None:
        return ~placed, []
    theirs, ours = _of_positions(truth.pose, truth_at(estimate.time, estimate.pose, truth.time))
    found, inside = [], np.zeros(len(placed), bool)
    edge = min(1e-3, 0.1 * float(np.diff(truth.time).min(initial=1.0)))
    for first, last in leaps(theirs, ours):
        before = truth.time[first - 1] if first else truth.time[0] - 2.0 * edge
        after = truth.time[last + 1] if last + 1 < len(truth) else truth.time[-1] + 2.0 * edge
        within = (estimate.time > before) & (estimate.time < after)
        if (within & placed).any():
            inside |= within
            found.append((first, last, f"--exclude-truth {before + edge:.15g}:{after - edge:.15g}"))
    if not found:
        return inside, []
    of, to, flags = zip(*found, strict=True)
    said = {"file": truth.file, "other": estimate.file, "back": of[0] > 0 and to[-1] + 1 < len(truth)}
    return inside, [notice(Code.PATH_LEAP, first=of, last=to, flags=flags, **said)]


def _of_positions(path: Array, other: Array) -> tuple[Array, Array]:
    """Two paths (n, 3), where one has positions alone laid onto each other, with headings of 0."""
    path, other = path.copy(), other.copy()
    known = np.isfinite(np.hstack([path[:, :2], other[:, :2]])).all(axis=1)
    if known.sum() >= FEW and not np.isfinite(path[known, 2] + other[known, 2]).any():
        other = compose(rigid_fit(other[known, :2], path[known, :2]), other)
        path[:, 2] = other[:, 2] = 0.0
    return path, other


WORSE, POOR, FAIR = 4.0, 12.0, 30.0  # Least ratio of pose NEES as read and otherwise, least as read, largest otherwise


def _order(pair: Pair, known: BoolArray) -> Iterator[Notice]:
    """Covariances whose order or frame is not stated, and that fit the errors in another one."""
    s = pair.estimate.space if pair.space is None else pair.space.estimate
    if s is None or s.covariance is None or known.sum() < 3:
        return
    turned = replace(s, covariance=translation_first(s.covariance))
    others = {} if s.stated.order else {f"--cov-order {paths.ROTATION}": turned}
    if not s.stated.convention:
        others |= {f"--cov-frame {f}": replace(s, frame=f) for f in paths.FRAMES[:3] if f != s.frame}
    as_read, best = _mean_nees(s, pair.at), (math.inf, "")
    for flag, other in others.items():
        best = min(best, (_mean_nees(other, pair.at), flag))
    if as_read > POOR and as_read > WORSE * best[0] and best[0] < FAIR:
        yield notice(Code.PATH_ORDER, file=s.file, nees=as_read, other=best[0], flag=best[1], read_as=s.frame)


def _mean_nees(path: Spatial | GivenPath, truth: Array) -> float:
    """Mean pose NEES in the plane; infinite where it has none."""
    values = np.array([math.nan])
    with suppress(DataError):  # as read this way it is no covariance in the plane
        path = flattened(path) if isinstance(path, Spatial) else path
        values = values if path.covariance is None else nees(path.pose, path.covariance, truth, "pose")
    return float(np.nanmean(values)) if np.isfinite(values).any() else math.inf


TILTED = SAME_VERTICAL  # smallest median tilt between two worlds that raises a question


def _tilt(path: GivenPath, truth: GivenPath, both: InSpace) -> Iterator[Notice]:
    """The tilt between estimate and truth at matched stamps, as a question where it is large, else as a fact."""
    ours, at = poses(both.estimate), both.truth
    known = ours.known & at.known
    if not known.any() or _first_is_w(path) or _first_is_w(truth):
        return
    ours, theirs = ours.of(known), at.of(known)
    tilt = float(np.median(tilts(ours, theirs)))  # a fit of places on a line may turn the estimate about it
    level = min(tilt, float(np.median(tilts(poses(both.original).of(known), theirs)))) <= TILTED
    bodies = np.swapaxes(ours.rotation, -1, -2) @ theirs.rotation
    spread = _spread(theirs.rotation @ np.swapaxes(ours.rotation, -1, -2)), _spread(bodies)
    of = scipy.spatial.transform.Rotation  # whether quaternions fit the truth's tilt when their first number is w
    turned = of.from_quat(np.roll(of.from_matrix(ours.rotation.copy()).as_quat(), -1, axis=1)).as_matrix()
    fitted = np.median(tilts(Poses(ours.position, turned), theirs))
    first = not (level or both.estimate.stated.axes) and fitted < 0.5 * TILTED and _same_vertical(ours, theirs)
    tips = not level and not first and min(spread) > tilt  # no turn of axes explains it
    if level or tips:
        if np.abs([ours.rotation[:, 2, :2], theirs.rotation[:, 2, :2]]).max() > 1e-6:
            yield notice(Code.TILT, tilt=math.degrees(tilt), poses=int(known.sum()), tips=tips)
        return
    which = "quaternion" if first else "world" if spread[0] <= spread[1] else "body"
    flags = ("--axes NAME=camera",) * (which != "body" or _apart(ours, theirs)[1] < SURELY)
    degrees = dict(zip(("tilt", "left"), np.degrees([tilt, spread[1]]).tolist(), strict=True))
    yield notice(Code.PATH_TILT, estimate=path.file, truth=truth.file, which=which, flags=flags, **degrees)


FITS = 0.05  # largest RMS error of a fit, as a share of the path's size


def _otherwise(pair: Pair, known: BoolArray, placed: BoolArray) -> Iterator[Notice]:
    """One of the files read otherwise: lengths or headings in another unit, mirrored, or turned headings."""
    rows = known if known.sum() >= FEW else placed
    ours, theirs = pair.estimate.pose[rows].copy(), pair.at[rows].copy()
    if not known[rows].all():  # of positions alone the course
        for path in (ours, theirs):
            path[:, 2] = np.arctan2(*np.gradient(path[:, 1::-1], axis=0).T)
    files = [(ours, pair.estimate), *([] if pair.truth is None else [(theirs, pair.truth)])]
    raw: list[Array | None] = []
    for _, f in files:  # headings as in the file, at the nearest stamps
        nearest = scipy.spatial.cKDTree(f.time[:, None]).query(pair.estimate.time[rows, None])[1]
        raw.append(None if f.headings is None else f.headings[nearest])
    found = paths_otherwise(pair.estimate.time[rows], ours, theirs, raw)
    if found is not None:
        k, e = found
        r = e.readings[0]
        flag = f"--unit NAME={r.unit}" if r.kind == Kind.UNIT else "--align sim3" if r.kind == Kind.SCALE else ""
        yield _reading(files[k][1], r.kind, r.of, e.stated, e.fits, r.number, unit=r.unit, flag=flag)


ROUNDING, CERTAIN = 1e-4, 5.0  # Error over the path's size that files round to; least standard errors of an offset
OTHER_FRAME, LATE = 5.0, 0.5  # Least ratio of RMS errors as read and after a fit; largest at other stamps and as read


def _clock_and_frame(pair: Pair, known: BoolArray) -> Iterator[Notice]:
    """An estimate whose clock is not that of its truth, or whose frame: errors are those of an offset, or of a turn."""
    time, ours, theirs = pair.estimate.time[known], pair.estimate.pose[known], pair.at[known]
    direct, fitted = rms(np.hypot(*(ours - theirs)[:, :2].T)), rms(aligned_distance(ours[:, :2], theirs[:, :2]))
    size = math.sqrt(float(np.var(theirs[:, :2], axis=0).sum()))
    if not direct > ROUNDING * size:
        return
    mirrored, (far, placed) = rms(aligned_distance(ours[:, :2] * [1, -1], theirs[:, :2])), _displaced(ours, theirs)
    if OTHER_FRAME * mirrored < fitted and fitted > FITS * size:  # where the robot hardly turns
        yield _reading(pair.estimate, Kind.SIDE, "truth's mirror", fitted / size, mirrored / size)
        return
    times, path, there, truth = time, ours, time, theirs
    if pair.truth is not None and not pair.aligned:  # all of both, not what their stamps match
        files = (pair.estimate, pair.truth)
        rows = [np.flatnonzero(np.isfinite(f.pose[:, :2]).all(axis=1)) for f in files]
        (times, path), (there, truth) = ((f.time[k], f.pose[k]) for f, k in zip(files, rows, strict=True))
    error = 0.0
    seconds, left = (0.0, 0.0) if pair.in_rows else _late_by(times, path, there, truth)
    if by_speed := not pair.in_rows and not left < min(LATE * direct, FITS * size):  # another frame, or another error
        seconds, times, path, there, truth = 0.0, time, ours, time, theirs
        with suppress(DataError):  # none stands out
            seconds, error = time_offset(pair.estimate.file, time, ours, time, theirs)
    moved = times + seconds
    inside = (moved >= there[0]) & (moved <= there[-1])
    if inside.sum() >= FEW and abs(seconds) > CERTAIN * error:
        at = interpolate(there, truth, moved[inside])
        own = path[inside]
        aligned = rms(aligned_distance(own[:, :2], at[:, :2]))
        if aligned < (LATE * rms(aligned_distance(own[:, :2], theirs[inside, :2])) if by_speed else fitted):
            if far > LEAST[Kind.PLACED] and placed < LATE * aligned:
                yield _reading(pair.estimate, Kind.PLACED, "truth", fitted / size, placed / size, far)
                return
            flags = (f"--time-offset NAME={round(seconds, 3):.9g}",)
            yield notice(Code.PATH_CLOCK, file=pair.estimate.file, stated=fitted, fits=aligned, flags=flags)
            ours, theirs, fitted = own, at, aligned
            direct = rms(np.hypot(*(ours - theirs)[:, :2].T))
    elif far > LEAST[Kind.PLACED] and placed < LATE * fitted:
        yield _reading(pair.estimate, Kind.PLACED, "truth", fitted / size, placed / size, far)
        return
    mean = _mean_nees(pair.estimate, pair.at)
    if not pair.aligned and direct > max(OTHER_FRAME * fitted, FITS * size) and not mean < POOR:
        turned = math.degrees(float(rigid_fit(ours[:, :2], theirs[:, :2])[2]))
        said = mean if math.isfinite(mean) else None
        off, turn = math.hypot(*(ours - theirs)[0, :2]), abs(float(wrap_angle(ours[0, 2] - theirs[0, 2])))
        reach = float(np.hypot(*(theirs - theirs[0])[:, :2].T).max())  # what the first poses' difference grows over
        if OTHER_FRAME * (off + reach * turn) < direct:
            yield notice(Code.PATH_DRIFT, file=pair.estimate.file, direct=direct, aligned=fitted, apart=off, askew=turn)
            return
        yield notice(Code.PATH_FRAME, file=pair.estimate.file, direct=direct, aligned=fitted, turned=turned, nees=said)


TRIED, SEEN = 1000, 0.25  # offsets that are tried, of as many poses at most; least share of them with a truth then


def _reading(
    path: GivenPath, kind: str, of: str, stated: float, fits: float, number: float = math.nan,
    *, unit: str = "", flag: str = "",
) -> Notice:  # fmt: skip
    said = dict[str, Any](stated=stated, fits=fits, number=number, unit=unit, flags=(flag,) if flag else ())
    return notice(Code.PATH_READING, file=path.file, kind=kind, of=of, **said)


def _displaced(ours: Array, theirs: Array) -> tuple[float, float]:
    """How far [m] apart on the robot the points of two paths (n, 3) are, and their RMS distance without that."""
    if not np.isfinite(theirs).all():
        return 0.0, math.inf
    A = np.concatenate([se2.worlds_from_bodies(theirs[:, 2])[:, :2, :2], np.tile(np.eye(2), (len(ours), 1, 1))], axis=2)
    found, off = np.zeros(4), (ours - theirs)[:, :2]
    found[:] = np.linalg.lstsq(A.reshape(-1, 4), off.ravel())[0]
    return float(np.hypot(*found[:2])), rms(np.hypot(*(off - A @ found).T))


def _late_by(time: Array, ours: Array, there: Array, theirs: Array) -> tuple[float, float]:
    """Offset [s] up to half the longer span at which paths (n, 3), (m, 3) are nearest, and their RMS distance then."""
    some = np.unique(np.linspace(0, len(time) - 1, TRIED).astype(int))
    half = 0.5 * max(float(np.ptp(time)), float(np.ptp(there)))

    def apart(seconds: float) -> float:
        at = time[some] + seconds
        rows = (at >= there[0]) & (at <= there[-1])
        if rows.sum() < max(1, SEEN * len(some)):
            return math.inf
        off = [ours[some[rows], k] - np.interp(at[rows], there, theirs[:, k]) for k in (0, 1)]
        return rms(np.hypot(*off)) * (1.0 + abs(seconds) / half)

    best = float(min(np.linspace(-half, half, TRIED + 1), key=apart))
    found = scipy.optimize.minimize_scalar(
        apart, bounds=(best - half / TRIED * 2.0, best + half / TRIED * 2.0), method="bounded", options={"xatol": 1e-4}
    )
    return float(found.x), float(found.fun)


def _first_is_w(path: GivenPath) -> bool:
    """Whether rotations are about x alone on level ground, as quaternions about z with w first are, read w last."""
    s = path.space
    if s is None or len(s) < FEW or s.stated.axes or not np.isfinite(s.rotation).all():  # matrices, or no headings
        return False
    q = scipy.spatial.transform.Rotation.from_matrix(s.rotation.copy()).as_quat()
    return bool(np.abs(q[:, 1:3]).max() < LEVEL and np.ptp(q[:, 0]) > 0.3)


LEVEL = 0.02  # largest entry of a quaternion that is none but rounding and tilt


SURELY, TWICE = 30.0, 2.0  # deg, largest error of rotations, and least ratio of errors, of poses that fit if inverted


def inverted(both: InSpace) -> tuple[int, str, float, float] | None:
    """Poses that fit the other file's by far better if they, or their rotations alone, are inverted: the estimate's (0)
    or the truth's (1), which of `INVERSE`, and errors of rotations [deg] as read and then.
    """
    pair, found = [poses(both.original), both.truth], list[tuple[float, int, str, float, float]]()
    rows = pair[0].known & pair[1].known
    if rows.sum() < PLENTY:
        return None
    pair = [p.of(rows) for p in pair]
    far, stated, _ = _apart(*pair)
    for k, p in enumerate(pair):
        back = np.swapaxes(p.rotation, -1, -2)
        whole = -np.einsum("nij,nj->ni", back, p.position)
        for how, other in zip(paths.INVERSE, (Poses(whole, back), Poses(p.position, back)), strict=True):
            off, left, narrow = _apart(*(other if i == k else q for i, q in enumerate(pair)))
            turned = TWICE * off < narrow and OTHER_FRAME * left < stated
            moved = TWICE * off < far and (TWICE * left < stated or OTHER_FRAME * off < far)
            if left < SURELY and (moved if how == paths.INVERSE[0] else turned):
                found.append(((1 + k) * _driven(p) / _driven(other), k, how, stated, left))
    return min(found)[1:] if found else None


def _driven(p: Poses) -> float:
    """How likely a path is driven: short, unlike the world's from a body that turns, and along one axis of the body."""
    way = np.diff(p.position, axis=0)
    ahead = np.linalg.norm(np.einsum("nji,nj->i", p.rotation[1:], way))
    return float(max(ahead, TINY) / max(np.linalg.norm(way, axis=1).sum() ** 2, TINY))


def _apart(a: Poses, b: Poses) -> tuple[float, float, float]:
    """Errors after Sim(3) and a turn of the body: of positions by the path's size, of rotations [deg]; second axis."""
    fit = aligning(a, b, SIM3)
    assert fit is not None  # there are matches
    size = np.linalg.svd((b.position - b.position.mean(axis=0)) / math.sqrt(len(b.position)), compute_uv=False)
    off = rms(np.linalg.norm(fit.scale * a.position @ fit.R.T + fit.t - b.position, axis=1))
    spread = _spread(np.swapaxes(fit.R @ a.rotation, -1, -2) @ b.rotation)
    return off / max(math.hypot(*size), TINY), math.degrees(spread), size[1] / max(math.hypot(*size), TINY)


def _spread(R: Array) -> float:
    """RMS angle [rad] of rotations (n, 3, 3) from their mean."""
    U, _, Vt = np.linalg.svd(R.sum(axis=0))
    return rms(se3.angle_between(np.broadcast_to(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, R.shape), R))


def _same_vertical(ours: Poses, theirs: Poses) -> bool:
    """Whether positions fit about as well when the estimate is only turned about the vertical."""
    found = []
    for how in (YAW, SE3):
        fit = aligning(ours, theirs, how)
        assert fit is not None  # there are matches
        found.append(rms(np.linalg.norm(ours.position @ fit.R.T + fit.t - theirs.position, axis=1)))
    return found[0] <= 2.0 * found[1] + FITS * float(np.linalg.norm(np.ptp(theirs.position, axis=0)))

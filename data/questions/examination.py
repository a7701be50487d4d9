"""Cross-examination of a log: what odometry, observations, map, ids and truth each say of the others.

Every mistake that can be made in writing a log is a change of its arrays. Where witnesses contradict each other, each
reading, and likely pairs of them, are tried. The one that explains most is named, or those that explain it as well.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import cast

import numpy as np

from data.inputs import IntArray
from data.log import ODOMETRY_KIND, ODOMETRY_PERIOD, Log
from data.notice import Code, Notice, notice
from data.questions import readings, witnesses
from data.questions.readings import DEG, SMALL_NOISE, TINY, Kind, Numbered, Part, Reading, flags_of
from data.questions.witnesses import EXACT, FEWEST, WEIGHT, WITNESSES, Case, Samples, by_nearest, case_of, changes
from data.se2 import Array, between, compose, dead_reckoned, inverse, rigid_fit, transform_points

LEFT = 2.0  # Above this multiple of the stated noise parts contradict each other under a reading, too: pairs are tried
CLEAR = 20.0  # Least gain of a reading in log-likelihood
SLIGHT = 0.05  # Least difference that a reading without a number, or of turns, explains: it changes all of them
PLAIN, LESS, POOR, NEAREST = 0.6, 0.8, 0.4, 0.13
"""Largest share of a witness's difference that another reading may leave (`LESS` if it has a number to fit), and the
largest difference that it may leave at all, relative to what is compared; by the nearest observations, without ids."""
CLOSE = 0.01  # Readings whose gains differ by at most this share explain the log equally well


@dataclass(frozen=True, eq=False)
class Explained:
    """What readings explain: their gain, and the witness that decides, as stated and as read otherwise."""

    readings: tuple[Reading, ...]
    gain: float
    sharp: float  # the gain without regard to the noise that is stated
    witness: str
    stated: float
    fits: float
    left: bool  # whether parts still contradict each other
    poor: float = POOR  # largest difference that it may leave
    only: tuple[float, float] | None = None  # s, the part of the log in which it is so; None: in all
    noise: float = 0.0  # of the witness as read otherwise, by what is stated


def _told(
    kind: Kind, of: str, witness: str, stated: float, fits: float = 0.0, unit: str = "", number: float = math.nan,
    gain: float = math.inf,
) -> list[Explained]:  # fmt: skip
    """A reading that shows by itself, without being tried."""
    return [Explained((Reading(kind, of, lambda c: c, unit, number),), gain, 0.0, witness, stated, fits, False)]


class Examination:
    """A case and what its witnesses say, against which other readings are judged."""

    def __init__(self, c: Case, s: Samples, before: tuple[Reading, ...] = ()) -> None:
        """The case, with readings already applied."""
        self.case, self.samples, self.before = c, s, before
        self.said = {name: witness(c, s) for name, witness in WITNESSES.items()}

    @property
    def sound(self) -> bool:
        """Whether all parts agree up to their noise."""
        return all(f is None or f.agrees for fits in self.said.values() for f in fits)

    def judged(self, r: Reading) -> Explained:
        """What a reading gains."""
        c, gain, sharp, witness, best = r.change(self.case), 0.0, 0.0, "", (1.0, 1.0, 0.0, 0.0)
        left, alone, worst = False, by_nearest(self.case, self.samples), 0.0
        for name, fits in self.said.items():
            if name == "observations and map" and self.case.id is None and r.part != Part.MAP:
                continue
            all_parts = r.of in (Part.ODOMETRY, "bearing and omega", "truth and map")
            new = WITNESSES[name](c, self.samples) if name in readings.HEARD[r.part] or all_parts else fits
            for f, g in zip(fits, new, strict=False):
                if f is None or g is None:
                    continue
                more = f.cost - g.cost if not f.agrees else min(f.cost - g.cost, 0.0)
                if self.before and f.noise < witnesses.LOUDEST:  # a second one gains nothing by larger motions
                    by_noise = math.log((f.off * g.noise + TINY) / (f.noise * g.off + TINY))
                    more = min(more, min(f.count, WEIGHT) * by_noise)
                gain += more
                sharp += min(f.count, g.count, WEIGHT) * math.log((f.off + EXACT) / (g.off + EXACT))
                left |= g.off > LEFT * g.noise
                worst = max(worst, g.off if g.off > LEFT**2 * g.noise else 0.0)
                if (more > CLEAR and g.off <= POOR, more) > (best[2] > CLEAR and best[1] <= POOR, best[2]):
                    witness, best = name, (f.off, g.off, more, g.noise)
        poor = max(NEAREST, LEFT * best[3]) if alone and witness.startswith(Part.OBSERVATIONS) else POOR
        poor *= worst <= max(POOR, 4.0 * best[0])  # a small contradiction beside a large one
        return Explained((*self.before, r), gain, sharp, witness, best[0], best[1], left, poor, None, best[3])

    def searched(self, kind: Kind, of: str, change: Numbered, grid: Array) -> Explained:
        """The best of a reading's numbers, between those of a grid."""

        def at(number: float) -> Explained:
            return self.judged(Reading(kind, of, change(number), "", number))

        best = max((at(x) for x in grid.tolist()), key=lambda e: e.sharp)
        width = float(grid[1] - grid[0])
        for _ in range(REFINED):
            width *= 0.4
            middle = best.readings[-1].number
            best = max([best, at(middle - width), at(middle + width)], key=lambda e: e.sharp)
        number = best.readings[-1].number
        # a rounder number is a more probable one
        rounded = [*(at(unit * round(number / unit)) for unit in ROUND.get(kind, ())), best]
        return max(enumerate(rounded), key=lambda ke: ke[1].sharp - 0.5 * ke[0])[1]

    def scaled(self, of: str) -> Explained:
        """The best scale of a quantity."""
        e = self.searched(Kind.SCALE, of, lambda log_scale: SCALED[of](math.exp(log_scale)), SCALES)
        return replace(e, readings=(*e.readings[:-1], replace(e.readings[-1], number=math.exp(-e.readings[-1].number))))

    def plain(self) -> Iterator[Explained]:
        """What each reading without a number gains."""
        c = self.case
        # bearings in degrees reach beyond a turn; as radians they would lie ahead, and near each other
        radians = float(np.abs(c.z[:, 1]).max(initial=0.0)) <= TURN
        for r in readings.READINGS:
            named = c.kind == "velocities" or r.unit not in ("km/h", "mph", "kn", "rpm")
            if named and self._told(r.part) and not (radians and r.kind == Kind.UNIT and r.of == "bearing"):
                yield self.judged(r)
        if len(c.z) and c.truth is None and c.names is None:  # where the world's x axis points is unknown, too
            yield self.searched(
                Kind.WORLD, "bearing", lambda x: lambda c: replace(readings.turned_by(x)(c), world=True), TURNS
            )
        if c.id is not None and c.names is not None:
            first, last = c.names.min() - c.id[c.id >= 0].min(), c.names.max() - c.id.max()
            for by in sorted({-1, 1, int(first), int(last)} - {0}):
                yield self.judged(Reading(Kind.SHIFTED, "ids", readings.shifted(by), number=float(by)))
            if c.truth is not None and (fit := readings.frame_of(c, self.samples.some)) is not None:
                moved = readings.truly(lambda pose: compose(fit, pose))
                yield self.judged(Reading(Kind.FRAME, Part.TRUTH, moved, carry=tuple(fit.tolist())))

    def clocks(self) -> Iterator[Explained]:
        """The best offset of each part's stamps."""
        c = self.case
        three = len(c.z) and c.truth is not None  # of two clocks either may be late
        parts = (Part.OBSERVATIONS, len(c.z)), (Part.TRUTH, c.truth is not None), (Part.ODOMETRY, three and c.u.any())
        for part, have in parts:
            if have and self._told(part):
                of: Numbered = partial(readings.late_by, part)
                near = self.searched(Kind.CLOCK, part, of, CLOCKS)
                far = min(0.95 * float(c.time[-1] - c.time[0]), FARTHEST)
                told = accepted(near) and not near.left and abs(near.readings[-1].number) < CLOCKS[-1]
                wide = np.arange(-far, far, 2.0 * (CLOCKS[1] - CLOCKS[0]))
                told = told or bool(self.before) or far <= CLOCKS[-1] or (len(c.z) > 0 and by_nearest(c, self.samples))
                yield near if told else self.searched(Kind.CLOCK, part, of, wide)

    def far_clock(self, part: Part) -> Explained | None:
        """The offset that stands out of all others without ids, by which much fits; of laps the least."""
        c, step = self.case, 0.5 * float(CLOCKS[1] - CLOCKS[0])
        far = min(0.95 * float(c.time[-1] - c.time[0]), FARTHEST)
        if not len(c.z) or not by_nearest(c, self.samples) or far <= CLOCKS[-1] or not self._told(part):
            return None
        wide, of = np.arange(-far, far, 4.0 * step), partial(readings.late_by, part)
        each = [self.judged(Reading(Kind.CLOCK, part, of(x), "", x)) for x in wide.tolist()]
        sharp = np.array([e.sharp for e in each])
        peaks = np.flatnonzero((sharp[1:-1] >= sharp[:-2]) & (sharp[1:-1] >= sharp[2:])) + 1
        peaks = peaks[np.argsort(-sharp[peaks])][:PEAKS]
        found = [self.searched(Kind.CLOCK, part, of, wide[k] + step * np.arange(-2.0, 2.5)) for k in peaks.tolist()]
        most = max((e.sharp for e in found), default=0.0)
        alike = [e for e in found if e.sharp > most - ALIKE]
        rest = [e.sharp for e in found if e.sharp <= most - ALIKE]
        if not alike or max(rest, default=0.0) > most - CLEAR:
            return None
        least = min(alike, key=lambda e: abs(e.readings[-1].number))
        return replace(least, poor=2.0 * least.poor)

    def numbered(self) -> Iterator[Explained]:
        """The best number of each other reading."""
        c = self.case
        yield from self.clocks()
        if len(c.z):
            yield self.searched(Kind.TURNED, "sensor", readings.turned_by, TURNS)
        if c.truth is not None:
            yield self.searched(Kind.TURNED, "truth.theta", readings.heading_off, TURNS)
        yield from (
            self.judged(r) for r in (readings.mounted(c, self.samples), readings.lever_arm(c, self.samples))
            if r is not None
        )  # fmt: skip
        if np.ptp(c.u[1:], axis=0).any():  # steps that are all equal are a motion prior, whose length is a guess
            for of in SCALED:
                if self._told(readings.PARTS.get(of, Part.OBSERVATIONS)):
                    yield self.scaled(of)

    def _told(self, part: Part) -> bool:
        return any(f is not None for name in readings.HEARD[part] for f in self.said[name])


SCALED: Mapping[str, Numbered] = {
    "v": readings.faster, "omega": readings.turning, "v and omega": readings.rates,
    "range": lambda k: readings.seen_as(k, 1.0), Part.MAP: lambda k: readings.on_map(k * np.eye(2)),
    Part.TRUTH: lambda k: readings.truly(lambda p: p * [k, k, 1.0]),
}  # fmt: skip
"""Quantities that may have another scale."""
SCALES = np.linspace(-7.2, 7.2, 37)  # Logarithms of scales that are tried first
CLOCKS, FARTHEST, TURNS = np.linspace(-6.0, 6.0, 31), 150.0, np.linspace(-165.0, 180.0, 24)
"""Clock offsets [s] and turns [deg] that are tried first, and the largest where none of these explains all; the search
goes on around the best."""
ROUND = {Kind.CLOCK: (1.0, 0.5, 0.1, 0.05, 0.01, 0.001), Kind.TURNED: (90.0, 45.0, 10.0, 5.0, 1.0), Kind.SCALE: (0.01,)}
"""Units to which the best offset [s], turn [deg] or logarithm is rounded: the next rounder is exp(0.5) as probable."""
PEAKS, ALIKE = 12, 7.0
"""Best offsets that are compared; log-likelihoods by which those of laps differ, a sigma of `WEIGHT` differences."""
REFINED = 6  # Steps of the search; each is 0.4 times as wide as the one before


def accepted(e: Explained) -> bool:
    """Whether a reading explains clearly what does not fit as stated."""
    r = e.readings[-1]
    share = LESS if r.kind in LEAST else PLAIN
    # at one of many some fit by chance
    far = any(r.kind == Kind.CLOCK and abs(r.number) > CLOCKS[-1] for r in e.readings)
    return e.gain > CLEAR and e.fits <= min(share * e.stated, e.poor / 2.0 if far else e.poor) and _matters(e)


def _matters(e: Explained) -> bool:
    """Whether what is explained, and a number that was searched for, are large enough to be named."""
    r = e.readings[-1]
    if (r.kind not in LEAST or "omega" in r.of) and e.stated <= SLIGHT:
        return False
    scales = [q for q in e.readings if q.kind == Kind.SCALE]
    if any(abs(math.log(q.number)) < (SHARPER if "omega" in q.of else LARGER) for q in scales):
        return False
    return r.kind not in LEAST or r.kind == Kind.SCALE or abs(r.number) >= LEAST[r.kind]


LARGER = 0.2  # Least logarithm of a scale that is named: wheels are wrong by less, and `--calibrate` finds that
WILD = math.log(10.0)  # One of two readings that is a larger scale takes its part away, so that little is left to fit
SHARPER = 0.5  # That of turns: a constant rate of 0.1 rad/s in a log of one circle is a scale of 1.26 as well
LEAST = {Kind.CLOCK: 0.03, Kind.TURNED: 10.0, Kind.SCALE: LARGER, Kind.PLACED: 0.1}  # s, deg, logarithm, m
SIZE, NAMES, ROWS = "size", "names", "rows"
BRISK, SPEED, CRAWL, SLOW = 5.0, 50.0, 200.0, 0.05
"""Median speeds [m/s]: below the first lengths may be in m, above the second in cm, above the third in mm; between the
last and the first another unit may be right, too."""
CREEP, CLOSE_BY, FULL = 5e-3, 0.1, 0.9
"""m/s and m: no robot is slower that sees no farther, lengths are in km; quantile of speeds of one that stops, too."""
INCHES, CENTIMETRES = 63.0, 300.0
"""Multiples of the stated noise by which ranges change otherwise than predicted: above the first lengths are in inches,
above the second in cm, above the third in mm, as the noise is in m."""
UNWRAPPED = 3.0 * math.pi  # rad, a direction of half a turn less a heading of one: bearings that were not wrapped
TURN = FASTEST = 2.0 * math.pi  # rad; rad/s: all recordings and worlds turn at most 1.7 rad in a second
SHARE = 0.01  # Smallest share of turning seconds above `FASTEST`: a single slip or jump raises no question


def _by_size(x: Examination) -> list[Explained]:
    """A unit by the size of numbers alone, where nothing else tells: speeds, turn readings.rates, bearings."""
    c = x.case

    if c.stamped and len(c.time) > 1:
        moved = np.hypot(c.u[1:, 0], c.u[1:, 1]) / np.diff(c.time)
        moved = moved[moved > 0.0]
        speed = float(np.median(moved)) if len(moved) >= FEWEST else 0.0
        pull = _sideways(c) if speed > BRISK else 0.0
        quick = c.kind != "velocities" and np.median(np.diff(c.time)) < FAST  # which are the same over any stamps
        slower = quick and SLOW <= speed / 60.0 <= BRISK and GRAVITY < pull < 3600.0 * GRAVITY
        minutes = _told(Kind.UNIT, "everything", SIZE, speed, speed / 60.0, "min", 1.0) if slower else []
        tiny = speed > 0.0 and np.quantile(moved, FULL) < CREEP and float(c.z[:, 0].max(initial=0.0)) < CLOSE_BY
        over = _over_noise(c, x.samples) if speed > BRISK or tiny else 1.0
        if tiny:
            return _told(Kind.UNIT, "everything", SIZE, speed, readings.METRES["km"] * speed, "km", over)
        if speed > SPEED or over > SMALL_NOISE:
            large = over > CENTIMETRES if over > SMALL_NOISE else speed > CRAWL
            units = ["mm", "cm"] if large else ["cm", "mm"]
            if over > SMALL_NOISE:  # errors of an inch are 39 times as large
                units.insert(0 if over < INCHES else 2, "in")
            told = [_told(Kind.UNIT, "everything", SIZE, speed, readings.METRES[u] * speed, u, over)[0] for u in units]
            noise = [1.0 if over == 1.0 else over * readings.METRES[u] for u in units]  # over the stated one
            fine = [SLOW <= e.fits <= BRISK and 0.1 < n < 2.0 for e, n in zip(told, noise, strict=True)]
            minutes *= over <= LEFT  # errors as large as stated are those of metres
            return told[:1] + [e for e, likely in zip(told[1:], fine[1:], strict=True) if likely] + minutes
        if pull > GRAVITY:
            lengths = [(u, readings.METRES[u]) for u in ("cm", "mm", "in")] if over == 1.0 or over > LEFT else []
            lengths = [(u, k) for u, k in lengths if SLOW <= k * speed <= BRISK and k * pull < GRAVITY]
            return [_told(Kind.UNIT, "everything", SIZE, speed, k * speed, u, 1.0)[0] for u, k in lengths] + minutes
        true = np.zeros(1) if c.truth is None else np.nan_to_num(np.diff(c.truth[:, 2]))
        for of, turn in (("omega", c.u[1:, 2]), ("truth.theta", true)):
            if len(turn) == len(c.time) - 1 and (rate := fastest(c.time, turn)):
                return _told(Kind.UNIT, of, SIZE, rate, DEG * rate, "deg/s" if of == "omega" else "deg", 1.0)
    largest = float(np.abs(c.z[:, 1]).max(initial=0.0))
    wide = largest > UNWRAPPED * (1.0 + 1e-6)
    return _told(Kind.UNIT, "bearing", SIZE, largest, DEG * largest, "deg", 1.0) if wide else []


def _minutes(c: Case) -> list[Explained]:
    """Velocities over stamps in minutes: what is seen changes 60 times as much as they predict."""
    if not c.stamped or c.kind != "velocities" or len(c.z) < FEWEST or np.median(np.diff(c.time)) > FAST:
        return []
    slower = replace(c, time=60.0 * c.time, at=60.0 * c.at, truth_time=60.0 * c.truth_time)
    e = Examination(slower, witnesses.samples(slower)).judged(BY_MINUTES)
    return [e] * accepted(e)


FAST = 0.1  # s, longest median frame interval that may be one of 6 s
BY_MINUTES = next(r for r in readings.READINGS if r.of == "v and omega" and r.unit == "min")


def _sideways(c: Case) -> float:
    """The acceleration [m/s²] to the side above which a tenth of the way is driven, of ten frames each."""
    at = np.arange(0, len(c.time) - 1, 10)
    a, b = c.odometry[at[:-1]], c.odometry[at[1:]]
    rate = np.hypot(*(b - a)[:, :2].T) * np.abs(b - a)[:, 2] / np.maximum(np.diff(c.time[at]), TINY) ** 2
    return float(np.quantile(rate[rate > 0.0], 0.9)) if (rate > 0.0).sum() >= FEWEST else 0.0


GRAVITY = 9.81  # m/s²: wheels slip sideways at less, whatever they drive on


def _over_noise(c: Case, s: Samples) -> float:
    """How many times the stated noise the ranges of landmarks change otherwise than the odometry predicts."""
    a, b = s.pairs
    if len(a) < FEWEST or c.along is None:
        return 1.0
    pose, _ = c.along
    total = np.cumsum(c.spread[:, 0])
    seen = transform_points(inverse(between(pose[a], pose[b])), c.points(a, pose[a, 2]))
    off = np.abs(np.hypot(*c.points(b, pose[b, 2]).T) - np.hypot(*seen.T))
    sigma = np.sqrt(c.R[a, 0] + c.R[b, 0] + total[c.frame[b]] - total[c.frame[a]])
    return float(np.median(off / np.maximum(sigma, TINY)) / 0.6745)


def fastest(time: Array, turn: Array) -> float:
    """The largest rate [rad/s] of turns (N - 1,) over seconds or steps, without jumps by 2 pi; 0: few are fast."""
    jumps = np.abs(np.abs(turn) - TURN) < 1.0
    if jumps.mean() < 1.0 / TURN:  # between jumps are as many steps, of less than 1 rad, as make a turn
        turn = np.where(jumps, 0.0, turn)
    second = np.floor(time - time[0])
    edges = np.unique(np.concatenate([[0], 1 + np.flatnonzero(second[1:] > second[:-1]), [len(time) - 1]]))
    total = np.concatenate([[0.0], np.cumsum(turn)])
    rate = np.abs(np.diff(total[edges]) / np.maximum(np.diff(time[edges]), 1.0))
    return float(rate.max()) if (rate > FASTEST).sum() > max(2.0, SHARE * np.count_nonzero(rate)) else 0.0


ALONG, ASIDE, PLENTY = 0.8, 0.02, 20
"""Least length of the mean motion relative to the heading in the right unit, least that is missing in a wrong one (of
right angles in degrees 0.027 and more, of simulated paths in the right one 0.004); least steps."""


def heading_unit(of: str, time: Array, pose: Array, flag: str) -> list[Notice]:
    """A question about headings of poses (K, 3) as they are written: they reach beyond a turn, and turn too fast in
    radians, or follow the course in degrees only.
    """
    known = np.isfinite(pose).all(axis=1)
    largest = float(np.abs(pose[known, 2]).max(initial=0.0))
    if largest <= 1.01 * TURN or not (in_degrees(pose) or fastest(time[known], np.diff(pose[known, 2]))):
        return []
    return [notice(Code.HEADING_UNIT, of=of, largest=largest, flags=(flag,))]


def in_degrees(pose: Array) -> bool:
    """Whether headings of poses (K, 3) as they are written reach beyond a turn, and follow the way as degrees only."""
    pose = pose[np.isfinite(pose).all(axis=1)]
    if not np.abs(pose[:, 2]).max(initial=0.0) > 1.01 * TURN:
        return False
    step = np.diff(pose[:, :2], axis=0)
    moves = step.any(axis=1)
    motion, heading = step[moves, 0] + 1j * step[moves, 1], 0.5 * (pose[1:, 2] + pose[:-1, 2])[moves]
    stated, degrees = (
        float(np.abs(np.sum(motion * np.exp(-1j * h))) / np.abs(motion).sum()) if len(motion) >= PLENTY else 0.0
        for h in (heading, DEG * heading)
    )
    return degrees > ALONG and 1.0 - stated > max(ASIDE, 3.0 * (1.0 - degrees))


def _strange(x: Examination) -> list[Explained]:
    """Ids that name other landmarks than those observed: without them, or without those of the map, all agrees."""
    c = x.case
    if c.id is None:
        return []
    if c.names is not None and (strange := float(np.mean(~np.isin(c.id[c.id >= 0], c.names)))) > 0.5:
        for by in c.names[[0, -1]] - [c.id[c.id >= 0].min(), c.id.max()]:
            if any(
                f is not None and f.off < NEAR
                for f in witnesses.observations_and_map(readings.shifted(int(by))(c), x.samples)
            ):
                return _told(Kind.SHIFTED, "ids", NAMES, strange, number=float(by), gain=0.0)
        return _told(Kind.STRANGE, "ids of the map", NAMES, strange, gain=0.0)
    bare = replace(c, id=None)
    plain = Examination(bare, witnesses.samples(bare))
    moves, true, mapped = "observations and odometry", "observations and truth", "observations and map"
    right = any(f is not None and f.off < NEAR for f in x.said[true])  # which tells ids better than a noisy odometry
    # of the map alone its ids are judged by those that agree as the robot moves
    for of, name, k, others in (
        ("ids", moves, 0, plain.said[moves]), ("ids", true, 0, plain.said[true]),
        ("ids of the map", true, 1, plain.said[true]), ("ids of the map", mapped, 0, x.said[moves]),
    ):  # fmt: skip
        stated, fits = ([*fits, None, None][min(k, len(fits))] for fits in (x.said[name], others))
        if stated is None or fits is None or stated.off <= max(LEFT * stated.noise, ALIEN) or (right and name == moves):
            continue
        if fits.off < (max(NEAREST, LEFT * fits.noise) if of == "ids" else NEAR):
            return _told(Kind.STRANGE, of, name, stated.off, fits.off, gain=stated.cost - fits.cost)
    return []


ALIEN, NEAR = 0.5, 0.35  # Ids are of others if the difference is above the first with them, below the second without


def _doubled(x: Examination) -> list[Explained]:
    """Observations that are the same as others of their frame."""
    c = x.case
    rows = np.column_stack([c.frame, c.z, c.id if c.id is not None else 0 * c.frame])
    share = 1.0 - len(np.unique(rows, axis=0)) / len(rows) if len(rows) else 0.0
    if share > TWICE:
        return _told(Kind.DOUBLED, Part.OBSERVATIONS, ROWS, share)
    rows, order = rows[:, 1:], np.lexsort((c.at, *rows[:, 1:].T))
    same = np.flatnonzero((rows[order[1:]] == rows[order[:-1]]).all(axis=1))
    later = np.round(c.at[order[same + 1]] - c.at[order[same]], 3)
    lag, times = np.unique(later[later > LAPSE], return_counts=True)
    if not len(lag) or (share := float(times.max()) / len(rows)) <= TWICE:
        return []
    return _told(Kind.DOUBLED, Part.OBSERVATIONS, ROWS, share, number=float(lag[times.argmax()]))


TWICE, LAPSE = 0.1, 5.0
"""Least share of repeated observations; sensors that measure twice the same have none. Seconds after which a row of the
same numbers is the same one, and no robot that stands still."""


def _headings(x: Examination, *, explained: bool) -> list[Explained]:
    """True headings that never change though odometry turns; or, if nothing is `explained`, change otherwise."""
    c, witness = x.case, witnesses.BY_TRUTH
    if c.truth is None or np.ptp(c.odometry[:, 2]) < 1.0 or len(fits := x.said[witness]) < 2 or fits[1] is None:
        return []
    if np.ptp(np.cos(c.truth[np.isfinite(c.truth).all(axis=1), 2])) <= SAME:
        return _told(Kind.STILL, "truth.theta", witness, fits[1].off)
    i, j = x.samples.spans[0]
    a, b = (np.hypot(*(p[j, :2] - p[i, :2]).T) for p in (c.truth, c.odometry))
    known = np.isfinite(a)
    way = witnesses.fit_of((a - b)[known, None], 0.5 * (a + b)[known], 0.0 * a[known])
    # on straight ways the turns of the odometry are noise, which no true heading has
    if explained or way is None or way.off > NEAR or not LEFT * fits[1].noise < ALIEN < fits[1].off:
        return []
    return _told(Kind.STRANGE, "truth.theta", witness, fits[1].off, way.off, "deg")


SAME = 1e-9  # of the cosine of a heading


def paths_otherwise(
    time: Array, estimate: Array, truth: Array, raw: Sequence[Array | None]
) -> tuple[int, Explained] | None:
    """The reading of one of two paths (n, 3) at the same stamps under which their motions agree, and which path it is;
    None: they agree, or no reading explains it. `raw`: headings of the paths to judge, not wrapped.
    """
    plain, numbered, none = list[tuple[int, Explained]](), list[tuple[int, Explained]](), np.zeros(0, np.int64)
    for k, (own, other) in enumerate(((estimate, truth), (truth, estimate))[: len(raw)]):
        u = np.vstack([np.zeros(3), between(other[:-1], other[1:])])
        nothing = np.zeros((0, 2))
        c = Case(time, u, 0.0 * u, other[0], own, time, none, time[:0], nothing, nothing, np.zeros(3), None, None, None)
        x = Examination(c, witnesses.samples(c))
        if all(f is None or f.off <= SLIGHT for fits in x.said.values() for f in fits):
            return None
        # where the paths lie on each other but for a turn, only headings are wrong
        fitted = transform_points(rigid_fit(own[:, :2], other[:, :2]), own[:, :2]) - other[:, :2]
        lie = np.mean(fitted**2) < WELL**2 * np.mean(np.var(other[:, :2], axis=0))
        fast = np.median(np.hypot(*np.diff(other[:, :2], axis=0).T) / np.diff(time)) > SPEED
        wrong = ("deg", "yd", *["km"] * bool(fast))  # a scale of 1.09 is likelier than yards, mm likelier than km
        some = (r for r in readings.READINGS if r.part == Part.TRUTH and r.of != "truth and map")
        singles = [x.judged(r) for r in some if r.unit not in wrong and (r.of == "truth.theta" or not lie)]
        if (headings := raw[k]) is not None and np.std(headings) > TURNS_ABOUT:
            degrees = np.column_stack([own[:, :2], DEG * headings])
            singles.append(x.judged(Reading(Kind.UNIT, "truth.theta", lambda c, d=degrees: replace(c, truth=d), "deg")))  # type: ignore[misc]
        plain += [(k, e) for e in singles if accepted(e) and (e.stated > WELL or e.fits < EXACTLY * e.stated)]
        if all(e.fits > WELL for _, e in plain):
            scaled, turned = x.scaled(Part.TRUTH), x.searched(Kind.TURNED, "truth.theta", readings.heading_off, TURNS)
            best = [scaled, *([turned] if abs(turned.readings[0].number) > MOUNTED else [])]
            numbered += [(k, e) for e in best if accepted(e) and e.stated > WELL]
            exactly = scaled.gain > CLEAR and scaled.stated > SLIGHT and scaled.fits < EXACTLY * scaled.stated
            numbered += [(k, scaled)] * exactly
    found = [*plain, *numbered]
    most = max((e.gain for _, e in found), default=0.0)
    return next(((k, e) for k, e in found if e.gain >= most - max(2.0, CLOSE * most)), None)


TURNS_ABOUT, MOUNTED, WELL, EXACTLY = 0.3, 17.0, 0.15, 0.25
"""rad, least deviation of headings whose unit shows; deg, least turn of headings that is none of their errors; share of
the motions up to which two paths differ by errors alone, unless a reading leaves less than that share of it."""
ORDERS = {"turn-first": 0.5, "drive-first": -0.5}
"""By name: share of a step's turn by which its motion points further than along the arc. A chord in the middle heading,
the third order of the textbooks, differs from the arc by a 24th of the turn's square only."""
FRAMES = (1, 4, 16)  # Frames between compared true poses: over more the order shows through noisy or rare ones
RIGHT_SIZE, UNSEEN, SOME, FAR = 0.3, 10.0, 30, 16.0
"""Largest difference of the fitted share of half a turn from 1 (another cause has another size); least gain without
truth, where pairs of frames show little; fewest differences; squared sigmas beyond which one is of something else."""


def _order(x: Examination) -> list[Explained]:
    """Another order of turning and driving, by the true path, else by observations: differences have its size."""
    c, s = x.case, x.samples
    if c.steps is None or not c.u.any():
        return []
    # turns that are noise move what is seen next, whatever the order
    turn, found = np.where(c.u[:, 2] ** 2 > SURE**2 * c.spread[:, 2], c.u[:, 2] / c.steps, 0.0), list[Explained]()
    others = {
        name: replace(c, u=np.column_stack([witnesses.rotated(share * turn, c.u[:, :2]), c.u[:, 2]]))
        for name, share in ORDERS.items()
    }
    rows: list[tuple[str, Callable[[Case], tuple[Array, ...] | None], float]] = []
    if c.truth is not None:
        rows = [(witnesses.BY_TRUTH, lambda c, k=k: _motions(c, k), CLEAR) for k in FRAMES]  # type: ignore[misc]
    if not any((said := of(c)) is not None and len(said[0]) >= SOME for _, of, _ in rows):
        rows = [("observations and odometry", lambda c: c.along and changes(c, s, c.along, c.spread), UNSEEN)]
    for witness, of, clear in rows:
        as_stated = of(c)
        for name, other in others.items():
            otherwise = of(other)
            if as_stated is None or otherwise is None or len(as_stated[0]) < SOME:
                continue
            size, gain, before, after = _share(as_stated[0], otherwise[0], *as_stated[2:])
            if gain > clear and abs(size - 1.0) < RIGHT_SIZE and (after <= PLAIN * before or c.truth is None):
                found += _told(Kind.ORDER, "omega", witness, before, after, name, gain=gain)
    return sorted(found, key=lambda e: -e.gain)[:1]


def _motions(c: Case, span: int) -> tuple[Array, ...] | None:
    """Differences (n, 2) of true motions over so many frames and of the odometry, sizes (n,) and variances (n, 2)."""
    assert c.truth is not None  # the caller asked
    true, odometry = (between(p[:-span:span], p[span::span]) for p in (c.truth, c.odometry))
    variance = np.diff(np.cumsum(c.spread, axis=0)[::span], axis=0)[: len(true)]
    size = np.hypot(*odometry[:, :2].T)
    variance[:, 1] += variance[:, 2] * size**2 / 3.0
    fine = np.isfinite(true).all(axis=1)
    return (true - odometry)[fine, :2], size[fine], variance[fine, :2]


def _share(off: Array, moved: Array, variance: Array, aside: Array | None = None) -> tuple[float, float, float, float]:
    """Of a reading its share of the change in differences (n, 2), its gain in log-likelihood, and squares left."""
    sigma = np.sqrt(np.maximum(variance, TINY**2))
    off, e = off / sigma, (off - moved) / sigma
    square = np.sum(off**2, axis=1)
    rows = e.any(axis=1) & (square < FAR * max(1.0, float(np.median(square)) / math.log(4.0)))
    off, e = off[rows], e[rows]
    if aside is not None and len(e):
        M, both = (aside / sigma[:, :, None])[rows].reshape(2 * len(e), -1), np.stack([off.ravel(), e.ravel()], axis=1)
        off, e = (both - M @ np.linalg.lstsq(M, both, rcond=None)[0]).T.reshape(2, -1, 2)
    length = np.maximum(np.hypot(*e.T), TINY)
    along = np.sum(e * off, axis=1) / length
    before, after = float(along @ along), float(np.sum((along - length) ** 2))
    if not len(along):
        return math.inf, 0.0, before, after
    size = float(length @ along / (length @ length))
    return size, 0.5 * (before - after) / max(after / len(along), 1.0), before, after


SURE = 3.0  # Sigmas from which on a step's turn is no noise


def explanations(c: Case, *, whole: bool = True) -> list[Explained]:
    """The readings that explain most misfit, equal ones together, if any. `whole`: one half of it may be sound."""
    s = witnesses.samples(c)
    x = Examination(c, s)
    if minutes := _minutes(c):
        return minutes
    if (twice := _doubled(x)) or x.sound:
        return twice or _by_size(x) or (_strange(x) if c.names is not None else []) or _order(x)
    spins = bool(fastest(c.time, c.u[1:, 2]))
    straight = x.judged(Reading(Kind.SCALE, "omega", readings.turning(0.0))).gain
    singles = sorted(x.plain(), key=lambda e: -e.gain)
    if not spins:  # where no turn at all fits as well as another unit of turns, something else is wrong
        turns = [e for e in singles if e.readings[-1].kind == Kind.UNIT and e.readings[-1].of == "omega"]
        singles = [e for e in singles if e not in turns or straight < e.gain - max(2.0, CLOSE * e.gain)]
    found = [e for e in singles if accepted(e)]
    if whole and (not found or found[0].left) and (part := _in_part(c)):
        return part
    if spins:  # between frames a turn in degrees has hidden the way
        found = [e for e in found if "omega" in e.readings[0].of]
    # bearings in the world use no heading of the truth, as if it were wrong
    explained = bool(found) and not (found[0].left and found[0].readings[0].kind == Kind.WORLD)
    other = _headings(x, explained=explained or spins) or ((_by_size(x) or _strange(x)) if not found else [])
    # stamps of another time turn headings otherwise, too, and show other landmarks
    by_number = bool(other) and other[0].readings[0].kind == Kind.STRANGE and other[0].witness != NAMES
    moved = (e for e in x.numbered() if e.readings[-1].kind in (Kind.CLOCK, Kind.TURNED))
    if other and not (by_number and any(map(accepted, moved))):
        return other
    if not found or found[0].left:
        singles = sorted([*singles, *x.numbered()], key=lambda e: -e.gain)
        found = [e for e in singles if accepted(e)]
    near = bool(found) and (found[0].readings[0].kind, found[0].readings[0].of) == (Kind.CLOCK, Part.OBSERVATIONS)
    if not found or found[0].left or near:  # without ids much fits
        far = [e for part in (Part.OBSERVATIONS, Part.TRUTH) if (e := x.far_clock(part)) is not None and accepted(e)]
        found = far if far and (not found or far[0].sharp > found[0].sharp + CLEAR) else found
    seeds = found[:1] or [e for e in singles[:3] if e.gain > CLEAR and _matters(e)]
    seeds = [e for e in seeds if e.readings[0].kind != Kind.SUMMED]  # which is half a frame late
    if not found or found[0].left:
        for e in seeds:
            both = Examination(e.readings[0].change(c), s, e.readings)
            if both.sound and e not in found and e.fits <= PLAIN * e.stated:
                found.append(e)
                break
            for more in (*both.plain(), *both.numbered()):
                wild = any(r.kind == Kind.SCALE and abs(math.log(r.number)) > WILD for r in more.readings)
                if accepted(more) and more.readings[0].of != more.readings[1].of and not wild:
                    found.append(replace(more, gain=e.gain + more.gain))
    if all(e.readings[0].kind == Kind.PLACED for e in found) and (order := _order(x)):  # on a circle both are the same
        return order
    if not found:  # the largest contradiction
        each = [(f.off, n) for n, fits in x.said.items() for f in fits if f is not None and f.off > LEFT**2 * f.noise]
        worst, name = max(each, default=(0.0, ""))
        return _told(Kind.UNKNOWN, Part.ODOMETRY, name, worst, worst) if worst > ALIEN and not by_nearest(c, s) else []
    best = max(found, key=lambda e: e.gain)
    equal = [e for e in found if _as_well(e, best) and len(e.readings) == len(best.readings)]
    scales = [e.readings[-1] for e in equal if e.readings[-1].kind == Kind.SCALE]
    # a number near that of a unit is that unit's
    plain = list({(r.kind, r.of, r.unit): e for e in equal if (r := e.readings[-1]).kind != Kind.SCALE}.values())
    for e in (e for e in singles if e not in plain and e.readings[-1].kind == Kind.UNIT):
        of, size = e.readings[-1].of, readings.SIZES.get(e.readings[-1].unit, math.inf)
        # of two parts alone a large number is known less well; units are ten times another
        off = [(abs(math.log(s.number * size)), 0.16 * abs(math.log(s.number))) for s in scales if of in s.of]
        plain += [e] * any(d < max(0.5 * LARGER, most) for d, most in off)
    plain = [e for e in plain if _as_well(e, max(plain, key=lambda e: e.gain))]
    result = sorted(plain or equal, key=lambda e: -e.sharp)  # a stated noise favours the larger motion
    if c.truth is None and c.id is not None:  # the prior decides
        read = [reduce(lambda case, r: r.change(case), e.readings, c) for e in result]
        fits = [None if y.along is None else witnesses.placed_at(y, s.soon, y.along, drift=True) for y in read]
        result = [e for e, f in zip(result, fits, strict=True) if f is not None and f.off <= POOR] or result
    return result


def _in_part(c: Case) -> list[Explained]:
    """What explains one half of a log whose other half is sound."""
    middle = 0.5 * float(c.time[0] + c.time[-1])
    wrong = []
    for before in (True, False):
        rows = np.flatnonzero((c.at < middle) == before)
        known = None if c.truth is None else np.where(((c.truth_time < middle) == before)[:, None], c.truth, np.nan)
        half = replace(c, frame=c.frame[rows], at=c.at[rows], z=c.z[rows], R=c.R[rows], truth=known,
                       id=None if c.id is None else c.id[rows])  # fmt: skip
        x = Examination(half, witnesses.samples(half))
        if not any(f is not None for fits in x.said.values() for f in fits):
            return []
        if not x.sound:
            wrong.append((half, (float(c.time[0]), middle) if before else (middle, float(c.time[-1]))))
    if len(wrong) != 1:
        return []
    half, span = wrong[0]
    return [replace(e, only=span) for e in explanations(half, whole=False) if e.witness != SIZE and e.stated > NEAREST]


def _as_well(e: Explained, best: Explained) -> bool:
    """Whether a reading explains as much as the best, or has a unit that is too near to be told from its."""
    r, q = e.readings[-1], best.readings[-1]
    ratio = readings.SIZES.get(r.unit, math.inf) / readings.SIZES.get(q.unit, 1.0)
    near = r.of == q.of and abs(math.log(ratio)) < LEFT * max(best.fits, best.noise)
    return near or e.gain >= best.gain - max(2.0, CLOSE * best.gain)


def _placed(log: Log) -> list[tuple[str, IntArray, Array, float]]:
    """Fixes, and a truth without headings: frames (n,), places (n, 2), and their standard deviation [m]."""
    f, pose = log.recorded.fixes, log.truth.pose
    parts = [] if f is None else [("fixes", *f.placed)]
    if pose is not None and not log.truth.has_headings:
        known = np.flatnonzero(np.isfinite(pose[:, 0]))
        parts.append((Part.TRUTH.value, known, pose[known, :2], 1.0))
    return parts


def _mirrored(log: Log) -> list[Explained]:
    """Odometry that turns to the other side than places do: its mirror image fits these, stretch by stretch."""
    path = dead_reckoned(np.zeros(3), log.recorded.increments.mean)[:, :2]
    for part, frames, places, _ in _placed(log):
        if len(frames) < FEWEST * STRETCHES:
            continue
        square = list[list[float]]()
        for some in np.array_split(np.arange(len(frames)), STRETCHES):
            place, own = places[some], path[frames[some]]
            off = [p - place for p in (transform_points(rigid_fit(q, place), q) for q in (own, own * [1.0, -1.0]))]
            square.append([float(np.sum(d**2)) for d in (*off, place - place.mean(axis=0))])
        each = np.array(square)
        stated, fits = np.sqrt(each[:, :2].sum(axis=0) / max(each[:, 2].sum(), TINY)).tolist()
        better = float(np.mean(each[:, 1] < PLAIN**2 * each[:, 0]))
        if stated < SLIGHT or fits > SHARP * min(stated, PLAIN) or better <= 0.5:
            continue
        ticks = log.source.get(ODOMETRY_KIND) == "ticks" and part == "fixes"
        of = "left and right" if ticks else "odometry's mirror" if part == "fixes" else "truth's mirror"
        return _told(Kind.EXCHANGED if ticks else Kind.SIDE, of, f"{part} and odometry", stated, fits)
    return []


STRETCHES, SHARP = 8, 0.33  # Parts of a log, in each of which odometry drifts little; as `PLAIN`, as a bias turns, too


def _by_way(log: Log) -> list[Explained]:
    """Places of fixes, or true ones without headings, that are all farther apart than odometry says, or all nearer."""
    r, kind = log.recorded, str(log.source.get(ODOMETRY_KIND, "velocities"))
    speeds = {} if kind == "ticks" else readings.SPEEDS if kind == "velocities" else readings.METRES
    for of, frame, place, sigma in _placed(log):
        if (share := witnesses.way_share(r.increments, frame, place, sigma)) is None:
            continue
        sizes = {u: 1.0 / k for u, k in readings.METRES.items()} if share > 1.0 else dict(speeds)
        if share < 1.0 and (datum := cast("list[float]", log.source.get("datum"))) and abs(datum[0]) < 0.5 * math.pi:
            sizes["rad"] = min(max(share, DEG), DEG / math.cos(datum[0]))  # more to the east than to the north
        unit = min(sizes, key=lambda u: abs(math.log(share / sizes[u])), default="")
        named = unit if unit and abs(math.log(share / sizes[unit])) < LARGER else ""
        kinds = (Kind.UNIT if named else Kind.SCALE, of if share > 1.0 or named in ("", "rad") else "v")
        off, left = (2.0 * abs(s - 1.0) / (s + 1.0) for s in (share, share / sizes[named] if named else 1.0))
        return _told(*kinds, f"{of} and odometry", off, left, named, share)
    return []


def contradictions(log: Log) -> list[Notice]:
    """A question about parts of a log that contradict each other, and agree if they are read otherwise."""
    found = explanations(case_of(log)) or _by_way(log) or _mirrored(log)
    # of a laser log the scans tell lengths of the odometry from all lengths
    if not found or (found[0].witness == SIZE and log.recorded.scans is not None):
        return []
    best = found[0]
    together = len(best.readings) > 1
    readings = best.readings if together else tuple(e.readings[0] for e in found)
    readings = tuple(_of_rows(r, log) for r in readings)
    readings += _held(readings[0], log) if len(readings) == 1 else ()
    placed = any(r.of == "place of the sensor" for r in readings)
    # a flag mends all of a log, and the sensor's place has its turn, too
    each = [() if best.only or (placed and r.of == "sensor") else flags_of(r, log) for r in readings]
    values = dict[str, list[str]]()  # of each flag, of all readings that hold together
    for name, _, value in (f.partition(" ") for fs in each[: len(readings) if together else 1] for f in fs):
        values.setdefault(name, []).extend([value] * bool(value))
    kinds, of, units, numbers = zip(*((r.kind, r.of, r.unit, r.number) for r in readings), strict=True)
    flags = tuple(" ".join([name, ",".join(v)]) if v else name for name, v in values.items())
    others = () if together else tuple(" ".join(f) for f in each[1:])
    return [notice(
        Code.CONTRADICTION, kinds=kinds, of=of, units=units, numbers=numbers, together=together, witness=best.witness,
        gain=best.gain, stated=best.stated, fits=best.fits, flags=flags, others=others, only=best.only,
    )]  # fmt: skip


def _of_rows(r: Reading, log: Log) -> Reading:
    """Velocities that are as many times as large as a row is long [s]: motions of a row."""
    period = float(cast("float", log.source.get(ODOMETRY_PERIOD, math.nan)))
    near = r.kind == Kind.SCALE and r.of == "v and omega" and abs(math.log(r.number / period)) < ROW
    return replace(r, kind=Kind.SUMMED, unit="row", number=period) if near else r


ROW = 0.05  # Largest difference of logarithms


def _held(r: Reading, log: Log) -> tuple[Reading, ...]:
    """Velocities that hold the other way, which explain what a clock does that is off by one of their periods."""
    source, late = log.source, r.number if r.of == Part.ODOMETRY else -r.number if r.of == Part.OBSERVATIONS else 0.0
    way, other, sign = ("backward", "forward", -1.0) if "hold" in source else ("forward", "backward", 1.0)
    period = float(cast("float", source.get(ODOMETRY_PERIOD, math.inf)))
    same = r.kind == Kind.CLOCK and abs(sign * late - period) < 0.3 * period
    held = same and source.get(ODOMETRY_KIND) == "velocities"
    return (Reading(Kind.HOLD, way, lambda c: c, other),) if held else ()

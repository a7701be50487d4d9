"""Pose hypotheses in a known map, each with its own pairings.

Multiple hypothesis tracking (Reid, IEEE TAC 24(6), 1979; of poses: Jensfelt and Kristensen, IEEE TRA 17(5), 2001).
Three states and a given map make it affordable: every compatible pairing is followed until later observations
contradict it. In SLAM each hypothesis would need its own map.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import special

from association.appearance import Looks
from association.expectation import gate_threshold
from data import se2
from data.appearance import Appearance
from data.blocks import coordinates_from, squared_norms
from data.inputs import FrameObservations, Increment, IntArray, LandmarkMap, Prior
from data.motion.systematic import sensor_frame
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated, not_used
from data.result import DISCARD, PoseEstimate
from data.se2 import Array, BoolArray
from data.sensors import MIN_RANGE, RANGE_BEARING, Sensor
from ekf import kernels, updates
from ekf.filter import DEFAULT, FilterDivergedError, FilterOptions
from ekf.pose_updates import Clones, MeasurementModel, absorb, of_closures, of_fixes
from eval.replay.hindsight import constants
from eval.replay.hindsight.noise import learned, log_density, stated

GATE = 0.9999  # gate of a single pairing; wide, because a wrong pairing is outweighed later and a missed one is not
LIMIT = 100  # hypotheses kept
DROP = 15.0  # a hypothesis is dropped if its likelihood is exp(DROP) times smaller than the best one's
MERGE = 0.5  # hypotheses whose means differ by less than this many standard deviations in every state are one, ...
ALIKE = 5.0  # ... if their variances agree within this factor
STRAY = 0.01  # expected number of clutter observations in the view of a frame
BINS = 10  # distances up to the sensor's reach, for each of which the detection probability is learned, ...
FIRST = (1.0, 10.0)  # ... starting at this many detections of this many opportunities
DEPENDENCE = 0.5  # weight of a miss against an independent one: occlusions last for many frames
LIMITS = (0.02, 0.05)  # sigmas of the view's limits: of the range in parts of the reach, and of the bearing in rad
SIGMAS = 2.0  # a landmark is well in view if this many standard deviations are inside the limits, ...
MARGIN = 0.1  # rad, ... and this angle


class Choice(NamedTuple):
    """One decision in a hypothesis's past: row of the log, landmark id or `DISCARD`, and the decision before."""

    row: int
    number: int
    before: "Choice | None"


@dataclass
class Hypothesis:
    """A pose, behind it landmarks of an uncertain map and kept poses of earlier frames (3 + 2l + 3c,), their
    covariance, logarithm of its weight, its past.

    taken, squares: landmarks paired in the newest frame, and squared innovations of these pairings.
    """

    mean: Array
    P: Array
    weight: float
    past: Choice | None = None
    taken: frozenset[int] = frozenset()
    squares: tuple[float, ...] = ()


class Standing(NamedTuple):
    """A frame seen by the leading hypothesis. decisions: (m,) landmark id or `DISCARD`; sure: (m,) weight of all
    hypotheses that agree; nis, dof: of its pairings.
    """

    decisions: IntArray
    sure: Array
    nis: float
    dof: int


class DetectionRates:
    """Detection probability of a landmark in view, learned by distance."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self._seen, self._expected = np.full(BINS, FIRST[0]), np.full(BINS, FIRST[1])

    @property
    def rates(self) -> Array:
        """Detection probabilities (BINS,)."""
        return np.asarray(self._seen / self._expected)

    def within(self, z_hat: Array, HPHt: Array, reach: float) -> tuple[IntArray, IntArray]:
        """Landmarks (k,) of expected measurements (n, 2) and covariances (n, 2, 2) that are well in view, and the bin
        of each; `reach` [m]: as far as can be seen.
        """
        sigma = SIGMAS * np.sqrt(HPHt[:, [0, 1], [0, 1]])
        inside = np.flatnonzero(self.sensor.in_view(z_hat, margin_range=-sigma[:, 0], margin_angle=self._edge(sigma)))
        return inside, np.minimum((self.sensor.polar(z_hat[inside])[:, 0] / reach * BINS).astype(np.int64), BINS - 1)

    def in_view(self, z_hat: Array, HPHt: Array, reach: float) -> tuple[Array, IntArray]:
        """Probability (n,) that landmarks of expected measurements (n, 2) and covariances (n, 2, 2) are in view, as if
        range and bearing were independent, and the bin of each; `reach` [m]: as far as can be seen.
        """
        sensor, (r, bearing) = self.sensor, self.sensor.polar(z_hat).T
        along, across = np.sqrt(HPHt[:, [0, 1], [0, 1]]).T
        if sensor.kind != RANGE_BEARING:
            along = np.maximum(along, across)
            across = along / np.maximum(r, MIN_RANGE)
        seen = special.ndtr((sensor.max_range - r) / np.maximum(along, LIMITS[0] * reach))
        half = 0.5 * (sensor.max_angle - sensor.min_angle)
        if half < math.pi:
            off = np.abs(se2.wrap_angle(bearing - 0.5 * (sensor.min_angle + sensor.max_angle)))
            across = np.maximum(across, LIMITS[1])
            seen *= special.ndtr((half - off) / across) - special.ndtr((-half - off) / across)
        return seen, np.minimum((r / reach * BINS).astype(np.int64), BINS - 1)

    def _edge(self, sigma: Array) -> Array | float:
        """Margin (n,) [rad] inside the limits of the view; 0 without limits."""
        if self.sensor.max_angle - self.sensor.min_angle >= 2.0 * math.pi:
            return 0.0
        return -(sigma[:, 1] if self.sensor.kind == RANGE_BEARING else sigma.max(axis=1)) - MARGIN

    def learn(self, part: IntArray, taken: BoolArray, share: float | Array) -> None:
        """Landmarks (k,) in bins `part`, in view, were detected or not; share: the hypothesis', times P(in view)."""
        np.add.at(self._expected, part, share)
        np.add.at(self._seen, part[taken], np.broadcast_to(share, part.shape)[taken])


class Hypotheses:
    """A bank of localizers that begins with one and branches at every ambiguous observation."""

    def __init__(self, prior: Prior, sensor: Sensor, known: LandmarkMap, options: FilterOptions = DEFAULT) -> None:
        """Start at the prior; `options` of the updates."""
        self.sensor, self.map, self._looks = sensor, known, Looks.of_map(known)
        self._how, self._extrinsic = (updates.UpdateRule(math.inf, *options.rule(), kernels.NEWEST), sensor.extrinsic)
        self._xy = np.array(known.xy)
        # as far as the map reaches, where the sensor has no limit
        self._reach = min(sensor.max_range, max(float(np.hypot(*np.ptp(known.xy, axis=0))), 1.0))
        self._stray, self._detection = math.log(STRAY / view_area(sensor, self._reach)), DetectionRates(sensor)
        self._at = np.full(len(self._xy), -1, np.int64)  # offset of each landmark in all states; -1: it is no state
        self._size = 3  # of pose and landmarks
        self._frame, self._clones = sensor_frame(None, sensor, prior), Clones()
        self._gate = gate_threshold(GATE)
        self.noise = stated()
        self.members = [Hypothesis(prior.mean.copy(), prior.covariance.copy(), 0.0)]

    def predict(self, increment: Increment) -> None:
        """Move all by an increment; the pose before it stays in the state if a later closure names its frame."""
        clones = self._clones
        over = clones.over()
        kept = [i for i, frame in enumerate(clones.frames) if frame not in over]
        if len(kept) < len(clones.frames) or clones.wanted:
            poses = np.array([*(self._size + 3 * i for i in kept), *([0] if clones.wanted else [])], np.int64)
            states = np.concatenate([np.arange(self._size), (poses[:, None] + np.arange(3)).ravel()])
            for h in self.members:
                h.mean, h.P = h.mean[states], h.P[np.ix_(states, states)]
            clones.frames[:] = [*(clones.frames[i] for i in kept), *([clones.now] if clones.wanted else [])]
        clones.now += 1
        motion, M = (np.array(each) for each in increment)  # read-only arrays would compile the kernels once more
        for h in self.members:
            kernels.predict(h.mean, h.P, len(h.mean), motion, M, kernels.NEWEST)

    def keep(self, last_use: dict[int, int]) -> None:
        """See `Filter.keep`."""
        self._clones.keep(last_use)

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """Update all with absolute measurements of the pose, which also weigh them; the result is the leader's."""
        return self._absorb(of_fixes(self._frame, fixes, sources), gate)

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """Update all with relative poses, which also weigh them; the result is the leader's."""
        return self._absorb(of_closures(self._frame, closures, self._clones.now), gate)

    def _absorb(self, measured: Sequence[MeasurementModel], gate: float | None) -> PoseUpdated:
        """One after another; one outside a hypothesis's gate is as likely there as at the gate."""
        done = not_used([len(m.rows) for m in measured])
        for i, m in enumerate(measured):
            at = self._clones.at(m, 3, self._size)
            if at is None:
                continue
            rule = self._how._replace(threshold=gate_threshold(gate, len(m.rows)), retraction=updates.ADDITIVE)
            for h in reversed(self.members):
                status, log_det = absorb(h.mean, h.P, len(h.mean), at, m, rule, done, i)
                if status != kernels.OK:
                    raise FilterDivergedError(kernels.FAILURES[status])
                h.weight -= 0.5 * (min(float(done.nis[i]), rule.threshold) + log_det)
        self._keep(self.members)
        return done

    def observe(self, observations: FrameObservations, first: int, appearance: Appearance | None = None) -> Standing:
        """Branch over the observations of a frame, which are the rows of the log from `first` on."""
        alike = None if appearance is None else self._looks.log_ratio(self.map.id, appearance)
        for h in self.members:
            h.taken, h.squares = frozenset(), ()
        m = len(observations.z)
        for i in range(m):
            z, R, looks = observations.z[i : i + 1], observations.R[i : i + 1], None if alike is None else alike[i]
            if self.map.sigma is not None:
                self._join(z, R)
            self._keep([child for h in self.members for child in self._branches(h, z, R, first + i, looks)])
        self._miss()
        share = np.repeat(np.exp([h.weight for h in self.members]), [len(h.squares) for h in self.members])
        self.noise = learned(self.noise, np.array([d2 for h in self.members for d2 in h.squares]), share)
        decisions, sure = self.opinion(m)
        if appearance is not None:
            self._looks.see(np.where(sure >= constants.DECISION_WEIGHT, decisions, DISCARD), appearance)
        return Standing(decisions, sure, sum(self.members[0].squares), 2 * int((decisions >= 0).sum()))

    def opinion(self, newest: int) -> tuple[IntArray, Array]:
        """The leader's decisions (m,) about the `newest` rows, and the weight (m,) of all that agree; 1: all agree."""
        chosen = np.array([_last(h.past, newest) for h in self.members], np.int64).reshape(-1, newest)
        same, share = chosen == chosen[0], np.exp([h.weight for h in self.members])
        return chosen[0], np.where(same.all(axis=0), 1.0, np.minimum(share @ same, np.nextafter(1.0, 0.0)))

    def _miss(self) -> None:
        """Weigh each hypothesis by its missed detections; the rates are learned from all by their weight."""
        rates = self._detection.rates
        for h in self.members:
            seen, part = self._detection.in_view(*self._expect(h), self._reach)
            taken = np.isin(self.map.id, list(h.taken))
            seen[taken] = 1.0
            self._detection.learn(part, taken, math.exp(h.weight) * seen)
            h.weight += DEPENDENCE * float(np.log1p(-seen * rates[part])[~taken].sum())
        normalize(self.members)

    def _expect(self, h: Hypothesis) -> tuple[Array, Array]:
        """Expected measurements (n, 2) of all landmarks and their covariances (n, 2, 2)."""
        n = len(self._xy)
        z_hat, HPHt = np.empty((n, 2)), np.empty((n, 2, 2))
        kernels.expect(self.sensor.kind, self._extrinsic, h.mean, h.P, self._at, self._xy, z_hat, HPHt, kernels.NEWEST)
        if self.map.sigma is not None:
            absent = np.flatnonzero(self._at < 0)
            H = self.sensor.jacobians(h.mean[:3], self._xy[absent])[1]
            HPHt[absent] += (H * self.map.sigma[absent, None, :] ** 2) @ H.transpose(0, 2, 1)
        return z_hat, HPHt

    def _join(self, z: Array, R: Array) -> None:
        """Make uncertain landmarks that may be paired states of all hypotheses; those out of reach leave the state."""
        assert self.map.sigma is not None
        wanted = np.zeros(len(self._at), np.bool_)
        for h in self.members:
            z_hat, HPHt = self._expect(h)
            wanted |= self._inside(z, z_hat, HPHt + R[0])
        away = np.hypot(*(self._xy - self.members[0].mean[:2]).T) > 2.0 * self._reach
        stay = np.flatnonzero((self._at >= 0) & (wanted | ~away))
        new = np.flatnonzero((self._at < 0) & wanted & self.map.sigma.any(axis=1))
        if len(new) or len(stay) < (self._at >= 0).sum():
            kept, size = coordinates_from(self._at[stay]), self._size
            added = np.diag(self.map.sigma[new].ravel() ** 2)
            for h in self.members:
                first, last = np.concatenate([np.arange(3), kept]), np.arange(size, len(h.mean))
                states, a, d = np.concatenate([first, last]), len(first), len(first) + len(added)
                mean, P = np.empty(len(states) + len(added)), np.zeros((len(states) + len(added),) * 2)
                old = np.concatenate([np.arange(a), np.arange(d, len(mean))])
                mean[old], P[np.ix_(old, old)] = h.mean[states], h.P[np.ix_(states, states)]
                mean[a:d], P[a:d, a:d] = self._xy[new].ravel(), added
                h.mean, h.P = mean, P
            self._at[:] = -1
            rows = np.concatenate([stay, new])
            self._at[rows] = 3 + 2 * np.arange(len(rows))
            self._size = 3 + 2 * len(rows)

    def _inside(self, z: Array, z_hat: Array, S: Array) -> BoolArray:
        """Which expected measurements (n, 2) of covariances (n, 2, 2) are in the gate about z (1, 2)."""
        return np.asarray(squared_norms(self.sensor.residual(z, z_hat), S) < self._gate)

    def _branches(self, h: Hypothesis, z: Array, R: Array, row: int, alike: Array | None) -> list[Hypothesis]:
        """The hypothesis with its observation unpaired, and paired with each free landmark in the gate. alike: (L,)
        log-likelihood ratio of its appearance to each landmark's, None: it has none.
        """
        z, R = z.copy(), R.copy()  # as in `predict`
        z_hat, S = self._expect(h)
        S += R[0]
        found = [Hypothesis(h.mean, h.P, h.weight + self._stray, Choice(row, DISCARD, h.past), h.taken, h.squares)]
        for j in np.flatnonzero(self._inside(z, z_hat, S)).tolist():
            number = int(self.map.id[j])
            if number in h.taken:
                continue
            mean, P, stats = h.mean.copy(), h.P.copy(), np.zeros(3)
            seen = kernels.Pairings(self._at[j : j + 1], self._xy[j : j + 1], z, R)
            done = updates.Outcome(np.ones(1, np.bool_), stats, np.empty((1, 2)))
            state = mean, mean, P, len(mean)
            status = updates.update(self.sensor.kind, self._extrinsic, *state, seen, 0, 1, self._how, done)
            if status != kernels.OK:
                raise FilterDivergedError(kernels.FAILURES[status])
            d2_there = float(stats[0])
            log_det = -2.0 * float(stats[1]) - d2_there - 2.0 * math.log(2.0 * math.pi)
            weight = h.weight + log_density(self.noise, d2_there, log_det)
            if alike is not None:
                weight += float(alike[j])
            past, taken = Choice(row, number, h.past), h.taken | {number}
            found.append(Hypothesis(mean, P, weight, past, taken, (*h.squares, d2_there)))
        return found

    def _keep(self, children: list[Hypothesis]) -> None:
        """Keep the best ones, merge those in one place into the likelier; weights sum to one."""
        children.sort(key=lambda h: -h.weight)
        kept: list[Hypothesis] = []
        for child in children:
            if len(kept) == LIMIT or child.weight < children[0].weight - DROP:
                break
            same = next((k for k in kept if one_pose(k.mean, k.P, child.mean, child.P)), None)
            if same is None:  # an unpaired child shares its parent's arrays
                kept.append(replace(child, mean=child.mean.copy(), P=child.P.copy()))
            else:
                same.weight = float(np.logaddexp(same.weight, child.weight))
        normalize(kept)
        self.members = kept

    def estimate(self) -> PoseEstimate:
        """Mean and covariance of the mixture."""
        leader = self.members[0]
        if len(self.members) == 1:
            return PoseEstimate(leader.mean[:3].copy(), leader.P[:3, :3].copy())
        share = np.exp([h.weight for h in self.members])
        away = np.array([se2.pose_error(h.mean[:3], leader.mean[:3]) for h in self.members])
        shift = share @ away
        mean = leader.mean[:3] + shift
        mean[2] = se2.wrap_angle(float(mean[2]))
        spread = away - shift
        P = np.einsum("h,hij->ij", share, np.array([h.P[:3, :3] for h in self.members])) + (spread.T * share) @ spread
        return PoseEstimate(mean, 0.5 * (P + P.T))

    def restart(self, mean: Array, covariance: Array) -> None:
        """One hypothesis at another pose, with the leader's past; earlier poses are no longer known."""
        self._clones.frames.clear()
        self._at[:], self._size = -1, 3
        self.members = [Hypothesis(mean.copy(), covariance.copy(), 0.0, self.members[0].past)]

    def decisions(self, rows: int) -> IntArray:
        """All decisions (rows,) of the leading hypothesis."""
        found = np.full(rows, DISCARD, np.int64)
        node = self.members[0].past
        while node is not None:
            found[node.row] = node.number
            node = node.before
        return found


def normalize(members: list[Hypothesis]) -> None:
    """Sort by weight, likeliest first; weights sum to one."""
    members.sort(key=lambda h: -h.weight)
    total = float(np.logaddexp.reduce([h.weight for h in members]))
    for h in members:
        h.weight -= total


def _last(past: Choice | None, count: int) -> Sequence[int]:
    """The newest `count` decisions, oldest first."""
    found = []
    for _ in range(count):
        assert past is not None
        found.append(past.number)
        past = past.before
    return found[::-1]


def one_pose(mean: Array, P: Array, other: Array, covariance: Array) -> bool:
    """Whether two states, which begin with a pose, are at one pose (see `MERGE`, `ALIKE`)."""
    v, w = P.diagonal()[:3], covariance.diagonal()[:3]
    off = other[:3] - mean[:3]
    off[2] = se2.wrap_angle(float(off[2]))
    return bool(np.all((off * off <= MERGE * MERGE * v) & (v <= ALIKE * w) & (w <= ALIKE * v)))


def view_area(sensor: Sensor, reach: float) -> float:
    """Area of the field of view in units of the measurement (m rad, or m^2)."""
    angle = sensor.max_angle - sensor.min_angle
    return reach * angle if sensor.kind == RANGE_BEARING else 0.5 * reach**2 * angle

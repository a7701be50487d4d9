"""Runs of a team: each estimator once for all robots, one run for each of them (`data.wing.Wing.replays`).

Extended Kalman filters of a team: one of all robots, or one in each robot with an exchange of estimates.

Robot a at p_a observes robot b as it observes a landmark at p_b, z = h(x_a, p_b) + v. In the joint filter all poses
(and the landmarks, in SLAM) are one state, so such an observation corrects all with which it is correlated (Roumeliotis
and Bekey, "Distributed multirobot localization", IEEE T-RA 18(5), 2002). In the others each robot keeps its own x_a,
P_a. blockdiag(P_a / w, P_b / (1 - w)) is no smaller than the joint covariance, for any 0 < w < 1 (Julier and Uhlmann,
ACC 1997); with R independent (Carrillo-Arce, Nerurkar, Gordillo and Roumeliotis, IROS 2013)

    S_w = H_a P_a H_a' / w + H_b P_b H_b' / (1 - w) + R,    K = P_a H_a' S_w^-1 / w,    P_a <- P_a / w - K S_w K',

w of the smallest determinant of P_a. The naive exchange takes w = 1 in both places: what b learned from a before comes
back as if it were new, and P_a shrinks each time.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from association.decide import decide, known_decisions
from association.expectation import Expectation, SingularInnovationError, gate_threshold, statistics
from association.names import METHODS
from association.truncated import truncated_square
from data.blocks import add_to_diagonal, diagonal_blocks, squared_norms, whitened
from data.inputs import Inputs, IntArray, LabelledObservations, LandmarkMap
from data.notice import Code, Notice, notice, stopped
from data.result import DISCARD, NEW, Failure, Innovations, MapState, Run, Trajectory, map_estimate
from data.se2 import Array, BoolArray, wrap_angle
from ekf.kernels import predict
from eval.replay.estimators import dead_reckoning
from eval.replay.recorder import missing_run
from eval.replay.run import crashed
from eval.replay.settings import Setup
from wings.cooperative.team import Team, TeamInputs

WEIGHTS = np.linspace(0.01, 0.99, 99)  # Of covariance intersection; each is conservative, so a grid is enough


@dataclass(frozen=True)
class Gates:
    """How observations are paired."""

    method: str = "known"  # `known`, or a method that decides frame by frame
    gate: float | None = 0.99  # of that method, a chi-square probability; None: none
    threshold: float = np.inf  # largest squared distance of a pairing by label


@dataclass(eq=False)
class Track:
    """What a filter leaves of one robot, of N frames, M observations of landmarks and s of robots.

    pose (N, 3), covariance (N, 3, 3), stats (N, 3): NIS, degrees of freedom, log-likelihood; size (N,) of the state;
    white (M, 2), decisions and created (M,) as of `data.result.Run`; sighted (s,): number of a robot, or `DISCARD`.
    """

    pose: Array
    covariance: Array
    stats: Array
    size: IntArray
    white: Array
    decisions: IntArray
    created: IntArray
    sighted: IntArray
    map: MapState | None = None


def _blank(team: Team, row: int) -> Track:
    n, m = len(team.members[row]), len(team.members[row].observations.frame)
    nothing = np.full(m, DISCARD, np.int64)
    tracks = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.zeros((n, 3)), np.zeros(n, np.int64)
    sighted = np.full(len(team.of(row)), DISCARD, np.int64)
    return Track(*tracks, np.full((m, 2), np.nan), nothing, np.full(m, -1, np.int64), sighted)


class TeamFilter:
    """The filters of all robots: one mean (d,) and covariance (d, d), of blocks without a joint state; poses first."""

    def __init__(self, team: Team, known: LandmarkMap | None, exchange: str, gates: Gates) -> None:
        self.team, self.known, self.exchange, self.gates = team, known, exchange, gates
        n = len(team)
        self.mean, self.P = np.concatenate([m.prior.mean for m in team.members]), np.zeros((3 * n, 3 * n))
        for row, member in enumerate(team.members):
            self.P[self.at(row), self.at(row)] = member.prior.covariance
        self.slot: dict[int, int] = {}  # first component of each landmark, by its label
        self.tracks = [_blank(team, row) for row in range(n)]
        self.begun = np.zeros(n, np.bool_)
        self.own = [team.of(row) for row in range(n)]
        if known is None:
            for row, track in enumerate(self.tracks):
                o, member = team.members[row].observations, team.members[row].without_map()
                seen = LabelledObservations(o.frame, o.z, o.R, team.labels[row])
                inputs = Inputs(member.prior, member.time, member.increments, seen, member.sensor)
                track.decisions, track.created = known_decisions(inputs)

    @staticmethod
    def at(row: int) -> slice:
        """Where the pose of a robot is in the state."""
        return slice(3 * row, 3 * row + 3)

    def run(self) -> list[Track]:
        """All instants; the tracks of all robots. Raises SingularInnovationError if the filter breaks down."""
        s = self.team.encounters
        first = np.searchsorted(s.instant, np.arange(len(self.team.time) + 1))
        for k in range(len(self.team.time)):
            here = [(row, f) for row, f in enumerate(self.team.frame[:, k].tolist()) if f >= 0]
            for row, f in here:
                if f:
                    self.move(row, f)
                self.begun[row] = True
            for row, f in here:
                self.landmarks(row, f)
            for row, f in here if first[k + 1] > first[k] else ():
                seen = first[k] + np.flatnonzero(s.observer[first[k] : first[k + 1]] == row)
                if len(seen):
                    self.robots(row, f, seen)
            if not np.isfinite(self.mean).all():
                raise SingularInnovationError("the state of the team is not finite")
            for row, f in here:
                track, at = self.tracks[row], self.at(row)
                track.pose[f], track.covariance[f] = self.mean[at], self.P[at, at]
                track.size[f] = len(self.mean) if self.exchange == "joint" else 3
        if self.known is None:
            label = np.array(sorted(self.slot), np.int64)
            xy = np.array([self.slot[name] for name in label.tolist()], np.int64).reshape(-1, 1) + np.arange(2)
            every = MapState(label, self.mean[xy], self.P[xy[:, :, None], xy[:, None, :]])
            for row, track in enumerate(self.tracks):
                track.map = own_map(self.team, row, track, every)
        return self.tracks

    def move(self, row: int, frame: int) -> None:
        """Predict a robot into a frame."""
        inputs, at = self.team.members[row], self.at(row)
        step, before = inputs.increment(frame), self.mean[at].copy()
        own = np.array(self.P[at, at], order="C")
        predict(self.mean[at], own, 3, np.array(step.mean), np.array(step.covariance), np.empty(0))
        if self.exchange == "joint":
            shift = self.mean[at][:2] - before[:2]
            rows = self.P[at].copy()
            rows[0] -= shift[1] * rows[2]
            rows[1] += shift[0] * rows[2]
            self.P[at], self.P[:, at] = rows, rows.T
        self.P[at, at] = own

    def landmarks(self, row: int, frame: int) -> None:
        """Update a robot with its observations of landmarks in a frame, and begin new ones."""
        inputs, track = self.team.members[row], self.tracks[row]
        rows = np.arange(inputs.start[frame], inputs.start[frame + 1])
        if not len(rows):
            return
        label, z, R = self.team.labels[row][rows], inputs.observations.z[rows], inputs.observations.R[rows]
        if self.known is None:
            told = track.decisions[rows] != DISCARD
            old = told & np.array([name in self.slot for name in label.tolist()])
            places = [self.slot[name] for name in label[old].tolist()]
            xy = np.array([self.mean[a : a + 2] for a in places])
            fresh = told & ~old
        else:
            old, xy = self._paired(row, rows, label, z, R)
            places, fresh = [], np.zeros(len(rows), np.bool_)
        if old.any():
            z_hat, Hx, Hl = inputs.sensor.linearize(self.mean[self.at(row)], xy)
            H = np.zeros((2 * len(z_hat), len(self.mean)))
            H[:, self.at(row)] = Hx.reshape(-1, 3)
            for i, a in enumerate(places):
                H[2 * i : 2 * i + 2, a : a + 2] = Hl[i]
            nu, seen = inputs.sensor.residual(z[old], z_hat), rows[old]
            S = H @ self.P @ H.T
            add_to_diagonal(S, R[old])
            # the first sight by this robot of a landmark that another one began is new to it, and not gated
            passed = (squared_norms(nu, diagonal_blocks(S)) <= self.gates.threshold) | (track.decisions[seen] == NEW)
            if self.gates.method != "known":
                passed[:] = True
            track.decisions[seen[~passed]] = DISCARD
            two = np.repeat(passed, 2)
            if passed.any():
                track.white[seen[passed]] = whitened(nu[passed], diagonal_blocks(S[two][:, two]))
                self.correct(H[two], nu[passed].ravel(), S[two][:, two], track, frame)
        for i in np.flatnonzero(fresh).tolist():
            self._begin(row, z[i], R[i], int(label[i]))

    def _paired(self, row: int, rows: IntArray, label: IntArray, z: Array, R: Array) -> tuple[BoolArray, Array]:
        """Which observations (m,) are paired in a known map, and where (k, 2); decisions are kept."""
        known, track, inputs = self.known, self.tracks[row], self.team.members[row]
        assert known is not None
        if self.gates.method == "known":
            decisions = np.where(np.isin(label, known.id), label, DISCARD)
        else:
            at = self.at(row)
            z_hat, Hx, _ = inputs.sensor.linearize(self.mean[at], known.xy)
            H = Hx.reshape(-1, 3)
            full = H @ self.P[at, at] @ H.T
            expected = Expectation.from_arrays(z, z_hat, full, R, inputs.sensor.residual, number=known.id)
            decisions = decide(self.gates.method, expected, self.gates.gate, None, known_map=True).decisions
        track.decisions[rows] = decisions
        return decisions >= 0, known.positions(decisions[decisions >= 0])

    def _begin(self, row: int, z: Array, R: Array, label: int) -> None:
        at, d = self.at(row), len(self.mean)
        xy, Gx, Gz = (each[0] for each in self.team.members[row].sensor.inverse(self.mean[at], z[None]))
        across = Gx @ self.P[at]
        self.P = np.block([[self.P, across.T], [across, across[:, at] @ Gx.T + Gz @ R @ Gz.T]])
        self.mean, self.slot[label] = np.append(self.mean, xy), d

    def robots(self, row: int, frame: int, seen: IntArray) -> None:
        """Update with a robot's observations (k,) of other robots in a frame."""
        team, s, at, track = self.team, self.team.encounters, self.at(row), self.tracks[row]
        others = np.flatnonzero(self.begun & (np.arange(len(team)) != row) & (team.frame[:, s.instant[seen[0]]] >= 0))
        which = np.searchsorted(self.own[row], seen)
        if not len(others):
            return
        sensor, places = team.members[row].sensor, self.mean[: 3 * len(team)].reshape(-1, 3)[others, :2]
        z_hat, Hx, Hl = sensor.linearize(self.mean[at], places)
        H = np.zeros((2 * len(others), len(self.mean)))
        H[:, at] = Hx.reshape(-1, 3)
        for i, b in enumerate(others.tolist()):
            H[2 * i : 2 * i + 2, 3 * b : 3 * b + 2] = Hl[i]
        # of unknown correlation S is at most that of w = 1/2
        full = (2.0 if self.exchange == "intersection" else 1.0) * (H @ self.P @ H.T)
        number = np.array([team.number[b] for b in others.tolist()])
        z, R = s.z[seen], s.R[seen]
        expected = Expectation.from_arrays(z, z_hat, full, R, sensor.residual, number=number)
        if self.gates.method == "known":
            decisions = np.where(np.isin(s.label[seen], number), s.label[seen], DISCARD)
            rows, chosen = expected.paired(decisions)
            decisions[rows[(expected.individual_distances()[rows, chosen] > self.gates.threshold)]] = DISCARD
        else:
            decisions = decide(self.gates.method, expected, self.gates.gate, None, known_map=True).decisions
        track.sighted[which] = decisions
        rows, chosen = expected.paired(decisions)
        if not len(rows):
            return
        nu, S = expected.joint_innovation(rows, chosen)
        if self.exchange == "joint":
            self.correct(H.reshape(-1, 2, len(self.mean))[chosen].reshape(len(nu), -1), nu, S, track, frame)
            return
        track.stats[frame] += statistics(nu, S)
        for i, j in zip(rows.tolist(), chosen.tolist(), strict=True):
            self._exchange(row, int(others[j]), z[i], R[i])

    def _exchange(self, a: int, b: int, z: Array, R: Array) -> None:
        """Both robots update their own estimates with one observation, from the other's estimate before."""
        at_a, at_b = self.at(a), self.at(b)
        sensor = self.team.members[a].sensor
        z_hat, Hx, Hl = (each[0] for each in sensor.linearize(self.mean[at_a], self.mean[at_b][None, :2]))
        Hb = np.column_stack([Hl, np.zeros(2)])
        nu, both = sensor.residual(z, z_hat), []
        for own, other, H, G in ((at_a, at_b, Hx, Hb), (at_b, at_a, Hb, Hx)):
            P, Q = self.P[own, own], G @ self.P[other, other] @ G.T
            both.append((own, *(intersected if self.exchange == "intersection" else independent)(P, H, Q, R)))
        for own, K, P in both:
            self.mean[own] += K @ nu
            self.mean[own.stop - 1] = wrap_angle(self.mean[own.stop - 1])
            self.P[own, own] = P

    def correct(self, H: Array, nu: Array, S: Array, track: Track, frame: int) -> None:
        """Update the state with an innovation nu (2k,) of covariance S (2k, 2k) and Jacobian H (2k, d)."""
        track.stats[frame] += statistics(nu, S)
        PHt = self.P @ H.T
        K = np.linalg.solve(S, PHt.T).T
        self.mean += K @ nu
        headings = slice(2, 3 * len(self.team), 3)
        self.mean[headings] = wrap_angle(self.mean[headings])
        P = self.P - K @ PHt.T
        self.P = 0.5 * (P + P.T)


def own_map(team: Team, row: int, track: Track, every: MapState) -> MapState:
    """The landmarks that a robot observed, by its own numbers, of a map by label, ascending."""
    mine = np.flatnonzero((track.created >= 0) & np.isin(team.labels[row], every.number))
    mine = mine[np.argsort(track.created[mine])]
    at = np.searchsorted(every.number, team.labels[row][mine])
    return MapState(track.created[mine], every.xy[at], every.covariance[at])


def independent(P: Array, H: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """Gain (3, 2) and covariance (3, 3) of an estimate P, observed by H x + noise Q + R that is independent of it."""
    S = H @ P @ H.T + Q + R
    K = np.asarray(np.linalg.solve(S, H @ P).T, np.float64)
    return K, P - K @ S @ K.T


def intersected(P: Array, H: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """The same where Q (2, 2) is of an estimate whose correlation with P (3, 3) is unknown, and R independent.

    log det of the result is that of P, minus d log w, plus log det N - log det S, with N the noise, enlarged, and S the
    innovation's covariance. Where no weight of `WEIGHTS` gains anything, the estimate stays.
    """
    w = WEIGHTS[:, None, None]
    N = Q / (1.0 - w) + R
    S = H @ P @ H.T / w + N
    gain = np.log(np.linalg.det(N)) - np.log(np.linalg.det(S)) - len(P) * np.log(WEIGHTS)
    best = int(np.argmin(gain))
    if not gain[best] < 0.0:
        return np.zeros((len(P), len(R))), P
    return independent(P / WEIGHTS[best], H, Q / (1.0 - WEIGHTS[best]), R)


FILTER, SMOOTHER = "ekf", "batch"
ESTIMATORS = {"joint": (FILTER, SMOOTHER), "naive": (FILTER,), "intersection": (FILTER,)}
"""Of each exchange; dead reckoning, too, which needs none."""


@dataclass(frozen=True, eq=False)
class TeamRun(Run):
    """The run of one robot of a team."""

    # (s,) number of the robot that each of its encounters was paired with, or `DISCARD`
    sighted: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    exchange: str = "joint"  # of the team


def lack(name: str, task: str, association: str, exchange: str) -> str:
    """Why an estimator cannot work on a team; empty: it can."""
    if name == "dead-reckoning":
        return ""
    if name not in ESTIMATORS[exchange]:
        return f"robots that exchange {exchange} have {' and '.join(ESTIMATORS[exchange])}, and {name} only alone"
    if association != "known" and association not in METHODS:
        return f"association {association}: of a team, known, {', '.join(METHODS)}"
    if task == "slam" and (association != "known" or exchange != "joint"):
        return "SLAM of a team needs labels and the joint exchange"
    return ""


def team_runs(
    inputs: Inputs, task: str, estimators: Sequence[str], association: str, setup: Setup,
    judge: Callable[[Sequence[Run], Inputs], list[Run]],
) -> list[Run] | None:  # fmt: skip
    """The runs of one robot; None of inputs without a team, or of a robot that is alone."""
    if not isinstance(inputs, TeamInputs) or inputs.team is None or inputs.exchange == "alone":
        return None
    if association == "known" and not isinstance(inputs.observations, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
    team = inputs.team
    gates = Gates(association, setup.gate, gate_threshold(setup.settled(team.sensed).label_gate))
    runs = list[Run]()
    for name in estimators:
        why = lack(name, task, association, inputs.exchange)
        if why:
            runs.append(missing_run(name, association, task, inputs, Failure("incomplete", 0, stopped(why))))
        elif name == "dead-reckoning":
            runs.append(dead_reckoning(inputs, task))
        else:
            found = _all(team, name, task, inputs.exchange, gates)
            if isinstance(found, Failure):
                runs.append(missing_run(name, association, task, inputs, found))
            else:
                runs.append(_part(found[inputs.robot], len(inputs), len(inputs.observations.frame)))
    return judge(runs, inputs)


@lru_cache(maxsize=8)
def _filtered(team: Team, task: str, exchange: str, gates: Gates) -> tuple[TeamFilter, float]:
    """A filter that ran, and its seconds; the smoother begins there."""
    begin, known = time.perf_counter(), team.members[0].map
    filter_ = TeamFilter(team, None if task == "slam" or known is None else known.exact, exchange, gates)
    filter_.run()
    return filter_, time.perf_counter() - begin


@lru_cache(maxsize=8)
def _all(team: Team, name: str, task: str, exchange: str, gates: Gates) -> tuple[TeamRun, ...] | Failure:
    """The runs of all robots, or why there are none."""
    try:
        return _runs(team, name, task, exchange, gates)
    except Exception as fault:  # noqa: BLE001 - `crashed` raises again what concerns the log
        return crashed(fault, 0)


def _runs(team: Team, name: str, task: str, exchange: str, gates: Gates) -> tuple[TeamRun, ...]:
    filter_, seconds = _filtered(team, task, exchange, gates)
    tracks, finals, states, total, steps = filter_.tracks, None, [t.map for t in filter_.tracks], None, None
    if name == SMOOTHER:
        from wings.cooperative.smoother import smooth_team  # gtsam

        begin = time.perf_counter()
        names = team.labels if task == "slam" else [t.decisions for t in tracks]
        landmark = [np.where(t.decisions != DISCARD, n, DISCARD) for t, n in zip(tracks, names, strict=True)]
        places = {label: filter_.mean[at : at + 2] for label, at in filter_.slot.items()}
        known, sighted = filter_.known, [t.sighted for t in tracks]
        found = smooth_team(team, known, landmark, sighted, [t.pose for t in tracks], places)
        finals, total, steps = found.paths, (found.cost, found.dof), (found.iterations, found.last_step)
        if found.map is not None:
            states = [own_map(team, row, t, found.map) for row, t in enumerate(tracks)]
        seconds = time.perf_counter() - begin
    mean, variance = truncated_square(gates.threshold if gates.method == "known" else gate_threshold(gates.gate))
    notes: tuple[Notice, ...] = ()
    if name == FILTER and (known := team.members[0].map) is not None and known.sigma is not None and task != "slam":
        effect = sum(m.map_effect for m in team.members)
        notes = (notice(Code.MAP_AS_EXACT, sigma=float(known.sigma.max()), effect=effect),)
    runs = []
    for row, t in enumerate(tracks):
        frame, state = team.members[row].observations.frame, states[row]
        runs.append(
            TeamRun(
                name, gates.method, task,
                None if finals else Trajectory(t.pose, t.covariance), finals[row] if finals else None,
                None if state is None else map_estimate(state, frame, t.decisions, t.created),
                t.decisions, t.decisions, t.created,
                None if finals else Innovations(t.stats[:, 0], t.stats[:, 1].astype(np.int64), t.stats[:, 2], t.white),
                total or (float(t.stats[:, 0].sum()), int(t.stats[:, 1].sum())),
                None if finals else t.size, seconds / len(tracks), notes=notes, gated=(mean / 2, variance / 2),
                iterations=steps[0] if steps else None, last_step_sigma=steps[1] if steps else None,
                sighted=t.sighted, exchange=exchange,
            )
        )  # fmt: skip
    return tuple(runs)


def _part(run: TeamRun, frames: int, observations: int) -> TeamRun:
    """The run of the first frames, of a log that was cut."""
    if len(run.trajectory(run.phases[0]).pose) == frames:
        return run
    o, first = run.innovations, slice(frames)
    if o is not None:
        o = Innovations(o.nis[:frames], o.dof[:frames], o.log_likelihood[:frames], o.white[:observations])
    return replace(
        run, online=run.online and run.online.only(first), final=run.final and run.final.only(first), innovations=o,
        state_size=None if run.state_size is None else run.state_size[:frames],
        decisions=run.decisions[:observations], final_decisions=run.final_decisions[:observations],
        created=run.created[:observations],
    )  # fmt: skip

"""iSAM2 frame by frame, with the interface of the filters: localization in a known map, and SLAM.

A frame without used observations costs no update: its pose is composed from the increments and joins the graph with the
next observation. So every frame is a variable, with the same estimate. Observations in the graph can be removed: by
landmark in SLAM, by frame where the landmarks are known.

Candidates are expected with their joint covariance.
"""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam import symbolIndex
from gtsam.symbol_shorthand import L, X

from association.candidates import SIGMAS, Places, UncertaintyBounds, in_view, may_be_in_view, view_radius
from association.expectation import Expectation
from data.blocks import block_diagonal, coordinates, diagonal_blocks
from data.inputs import FrameObservations, Increment, IntArray, LandmarkMap, Prior, Systematic
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated, fixes_of
from data.result import NEW, Finished, MapState, PoseEstimate, Updated, map_with
from data.se2 import Array, BoolArray, pose_error, world_from_body, worlds_from_bodies
from data.sensors import Sensor
from graph.engine import Engine, forked
from graph.factors import Factor, ObservationFactors, is_exact, known_landmark_factors, landmark_factors, name_of, pose2
from graph.open_end import OpenEnd, pinned_landmark_factors
from graph.optimum import optimize
from graph.pose_factors import PoseFactor, closure_factors, closures_of, fix_factors, in_turn
from graph.problem import LandmarkPrior, Problem, is_uncertain, landmark_priors, refuse
from graph.systematic import Errors, errors_of
from graph.walls import WallObservation, as_vectors, line_factors, wall_factors


def form(
    sensor: Sensor, pose: Array, covariance: Array, number: IntArray, xy: Array, observations: FrameObservations,
    at: Array | None = None, inside: Callable[[Array], Array] | None = None,
) -> Expectation:  # fmt: skip
    """Expectation over landmarks `number` (n,) at xy (n, 2) from `pose` (3,), linearized there or `at` (3,).

    `inside` maps a robot's pose into the frame of the arguments; None: identity. `covariance`, world frame: (3 + 2n, 3
    + 2n) of pose and landmarks, or (3, 3) of the pose where they are known.
    """
    n, m = len(number), len(observations.z)
    z_hat, Hx, Hl = sensor.linearize(pose if at is None else at, xy)
    if at is not None:
        z_hat = z_hat + Hx @ pose_error(pose, at)
    known = len(covariance) == 3
    blocks = Hx @ covariance[:3, :3] @ Hx.transpose(0, 2, 1)
    if not known:
        Pxl = covariance[:3, 3:].reshape(3, n, 2).transpose(1, 0, 2)
        Pll = diagonal_blocks(covariance[3:, 3:])
        cross = Hx @ Pxl @ Hl.transpose(0, 2, 1)
        blocks = blocks + cross + cross.transpose(0, 2, 1) + Hl @ Pll @ Hl.transpose(0, 2, 1)
    zeros = np.zeros(n + m, np.int64)

    def joint(indices: IntArray) -> Array:
        chosen = np.asarray(indices, np.int64)
        k = len(chosen)
        H = np.zeros((k, 2, 3 if known else 3 + 2 * k))
        H[:, :, :3] = Hx[chosen]
        of = np.arange(3)
        if not known:
            for q in range(2):
                H[np.arange(k), :, 3 + 2 * np.arange(k) + q] = Hl[chosen, :, q]
            of = np.concatenate([of, 3 + coordinates(chosen)])
        rows = H.reshape(2 * k, H.shape[2])
        S: Array = rows @ covariance[np.ix_(of, of)] @ rows.T
        return 0.5 * (S + S.T)

    def elsewhere(at: Array) -> Expectation:
        return form(sensor, pose, covariance, number, xy, observations, at if inside is None else inside(at), inside)

    return Expectation(
        number, z_hat, blocks, zeros[:n], observations.z, observations.R, zeros[:m], sensor.residual, joint, elsewhere,
        len(sensor.measures),
    )  # fmt: skip


class Observed:
    """All observations in the graph, in the order of frames, and the engine's handles on their factors."""

    def __init__(self, sensor: Sensor, known: LandmarkMap | None, errors: Errors | None = None) -> None:
        """`errors`: on which a known map depends in this graph."""
        self.sensor, self.map = sensor, known
        self.observations: list[ObservationFactors] = []
        self._handles: dict[int, list[int]] = {}
        self._errors = errors if known is not None and errors is not None and errors.frame.range_at >= 0 else None
        self._plain: dict[int, ObservationFactors] = {}
        self._copies = 0
        self._joined = set[int]()
        self._numbers: IntArray | None = None

    @property
    def numbers(self) -> IntArray:
        """Landmark numbers in the map of SLAM, ascending."""
        if self._numbers is None:
            self._numbers = np.array(sorted(self._handles) if self.map is None else [], np.int64)
        return self._numbers

    def missing(self, numbers: IntArray) -> list[int]:
        """Numbers that are absent from the map."""
        if self.map is not None:
            return [int(n) for n in np.setdiff1d(numbers, self.map.id)]
        return [n for n in numbers.tolist() if n not in self._handles]

    def name(self, key: int) -> str:
        """Name of a variable; the copies of known landmarks are numbered by observation."""
        return next((f"landmark {s.number}" for s in self.observations if key in s.own_variables), name_of(key))

    def factors_of(
        self, seen: FrameObservations, frames: IntArray, number: IntArray, end: OpenEnd, engine: Engine,
        joining: gtsam.Values,
    ) -> Sequence[ObservationFactors]:  # fmt: skip
        """Factors of observations (m) of landmarks (m,) from frames (m,), of which the newest may be `joining`."""
        row, walls = self._copies, not self.sensor.sees_points
        self._copies += len(number)
        if not walls and (self.map is None or self.map.sigma is not None):
            return landmark_factors(self.sensor, *seen, frames, number)
        if self.map is None or self.map.sigma is not None:
            pose = np.array([engine.pose(X(k), joining) for k in frames.tolist()]).reshape(-1, 3)
            there = [n for n in dict.fromkeys(number.tolist()) if n in self._handles]
            old = dict(zip(there, engine.points(there), strict=True))
            return wall_factors(self.sensor, seen, frames, number, pose, old, row)
        at = self.map.positions(number)
        if walls:
            return line_factors(self.sensor, *seen, frames, number, end.prior.mean[:2], known=at)
        plain = known_landmark_factors(self.sensor, *seen, frames, number, at, row)
        if self._errors is None:
            return plain
        self._plain.update(enumerate(plain, row))
        return pinned_landmark_factors(self._errors, self.sensor, seen, frames, number, at, row, end.b)

    @property
    def joined(self) -> IntArray:
        """Landmarks of an uncertain map that are variables, by id, ascending."""
        return np.array(sorted(self._joined), np.int64)

    def join(self, number: IntArray, values: gtsam.Values) -> list[LandmarkPrior]:
        """Priors of an uncertain map's landmarks (m,) that are no variables yet; their start values go to `values`."""
        if not is_uncertain(self.map):
            return []
        new = np.array([n for n in dict.fromkeys(number.tolist()) if n not in self._joined], np.int64)
        priors = landmark_priors(self.map, new)
        self._joined.update(p.number for p in priors)
        for p in priors:
            values.insert(L(p.number), p.xy)
        return priors

    def start(self, seen: FrameObservations, number: IntArray, pose: Array, values: gtsam.Values) -> None:
        """Add start values of new points, observed from a pose (3,); walls have their own."""
        for n in dict.fromkeys(self.missing(number) if self.sensor.sees_points else []):
            i = int(np.flatnonzero(number == n)[0])
            values.insert(L(n), self.sensor.inverse(pose, seen.z[i : i + 1])[0][0])

    def renumbered(self, other: dict[int, int], engine: Engine) -> list[ObservationFactors]:
        """The observations (SLAM) of some landmarks, assigned to the others of `other`."""
        moved = [s for s in self.observations if s.number in other]
        _, opposite = self.sensor.difference(engine.points([*other]), engine.points([*other.values()]))
        turned = {n for n, o in zip(other, opposite, strict=True) if o}
        return [s.renumbered(other[s.number], opposite=s.number in turned) for s in moved]

    def replace(self, frames: IntArray, seen: FrameObservations, number: IntArray) -> None:
        """Replace the observed points of SLAM, for `problem` alone; by ascending frame, number negative for none."""
        take = np.flatnonzero(number >= 0)
        found = FrameObservations(seen.z[take], seen.R[take])
        self.observations = landmark_factors(self.sensor, *found, frames[take], number[take])

    def problem(self, end: OpenEnd, values: gtsam.Values) -> Problem:
        """The whole run as a problem, with known landmarks at their positions; `values` are converted to it."""
        if self.sensor.sees_points:
            plain = [self._plain.get(symbolIndex(s.key), s) if s.key is not None else s for s in self.observations]
            problem = Problem(end.prior, end.motion, plain, self.map is not None and self.map.sigma is None)
            return replace(problem, priors=landmark_priors(self.map, problem.numbers))
        about = end.prior.mean[:2]
        if self.map is not None:
            return Problem(end.prior, end.motion, self.observations, known_map=True, about=about)
        problem = Problem(end.prior, end.motion, self._lines(about), known_map=False, about=about)
        as_vectors(values, problem.numbers, about)
        return problem

    def _lines(self, about: Array) -> list[ObservationFactors]:
        """Walls of SLAM as factors of a problem with distances from a point (2,)."""
        walls = [s for s in self.observations if isinstance(s, WallObservation)]
        if not walls:
            return []
        z, R = np.array([s.z for s in walls]), np.array([s.R for s in walls])
        frame, number = np.array([[s.frame, s.number] for s in walls]).T
        return line_factors(self.sensor, z, R, frame, number, about)

    def own_variables(self, frames: range, numbers: Sequence[int] | None = None) -> list[int]:
        """Variables of single observations from some frames (of some landmarks only)."""
        first, end = (bisect_left(self.observations, f, key=lambda s: s.frame) for f in (frames.start, frames.stop))
        of = self.observations[first:end]
        return [key for s in of if numbers is None or s.number in numbers for key in s.own_variables]

    def forget(self, oldest: int, alive: Callable[[int], bool]) -> None:
        """Remove observations from frames before `oldest`, which left the graph; `alive` tests a handle."""
        first = bisect_left(self.observations, oldest, key=lambda s: s.frame)
        removed, self.observations = self.observations[:first], self.observations[first:]
        for s in removed:
            if s.key is not None:
                self._plain.pop(symbolIndex(s.key), None)
        if self.map is not None:
            for frame in {s.frame for s in removed}:
                self._handles.pop(frame, None)
            return
        for number in {s.number for s in removed}:
            if number in self._handles:
                self._handles[number] = [h for h in self._handles[number] if alive(h)]

    def add(self, seen: Sequence[ObservationFactors], values: gtsam.Values, *, late: bool = False) -> list[Factor]:
        """Add observations, their own variables to `values`; their factors. `late`: they may be of earlier frames."""
        self.observations += seen
        if late:
            self.observations.sort(key=lambda s: s.frame)
        for s in seen:
            for key, start in s.start_values:
                values.insert(key, start)
        return [f for s in seen for f in s.factors]

    def hold(self, seen: Sequence[ObservationFactors], handles: Sequence[int]) -> None:
        """Store the engine's handles on the factors of `add`, in their order."""
        begin, count = 0, len(self._handles)
        for s in seen:
            end = begin + len(s.factors)
            self._handles.setdefault(s.number if self.map is None else s.frame, []).extend(handles[begin:end])
            begin = end
        if len(self._handles) != count:
            self._numbers = None

    def withdraw(self, which: Sequence[int]) -> list[int]:
        """Remove the observations of some landmarks, or from some frames of a known map; handles on their factors."""
        removed, self._numbers = set(which), None
        self.observations = [s for s in self.observations if (s.number if self.map is None else s.frame) not in removed]
        return [h for n in which for h in self._handles.pop(n, [])]


THRESHOLD = 0.05  # m, rad. Relinearize variables that moved further than this, ...
SKIP = 10  # ... at every so many updates
SETTLE = 3  # updates after a removal, and default of `refine`
DELICATE = 1e-8  # m^2, rad^2; below this eigenvalue of an increment or the prior QR is used, a fifth slower


class Isam2Smoother:
    """Incremental smoothing and mapping (Kaess et al., IJRR 2012) over the same inputs as the filters.

    Parameters chosen on Victoria Park at 25 frames: the newest pose is within 4 % of a sigma of the batch solution, 0.2
    % in the median, at half the time of relinearizing in every update.
    """

    smooths = True  # it revises its path

    def __init__(
        self, prior: Prior, sensor: Sensor, known: LandmarkMap | None = None, *, threshold: float = THRESHOLD,
        skip: int = SKIP, systematic: Systematic | None = None,
    ) -> None:  # fmt: skip
        """Start at the prior; with a map localize in it, without do SLAM."""
        refuse(systematic, known, sensor)
        self.prior, self.sensor, self.map = prior, sensor, known
        self.threshold, self.skip = threshold, skip
        self.frame, self.created = 0, 0
        self._errors = errors = errors_of(systematic, sensor, prior)
        self._end, self.sensor = OpenEnd(prior, errors), errors.frame.sensor(sensor)
        self._motion: int | None = None  # the engine's handle on the present motion, which joined without observations
        self._of_poses = list[PoseFactor]()  # fixes and closures so far
        self._observed = Observed(self.sensor, known, errors)
        self._places, self._drift = Places(np.empty((0, 2)) if known is None else known.xy), UncertaintyBounds()
        self._asked = False  # for candidates of SLAM; with labels nobody asks
        sigma = np.zeros((0, 2)) if known is None or known.sigma is None else known.sigma
        self._margin = float(np.hypot(*sigma.T).max(initial=0.0))  # m, of the search for landmarks of an uncertain map
        self._least = float(sigma.min(initial=np.inf)) ** 2  # m^2, least variance of its priors
        low = np.linalg.eigvalsh(prior.covariance)
        qr = bool(low[0] < DELICATE < low[-1])
        walls = known is None and not sensor.sees_points
        self._engine = Engine(threshold, skip, qr=qr, name=self._observed.name, linear=errors.sizes, walls=walls)

    def __deepcopy__(self, memo: dict[int, object]) -> "Isam2Smoother":
        """An independent copy; shared factors are linearized at the systematic errors that either found last."""
        other = memo[id(self)] = forked(self)
        other._end, other._observed = forked(self._end), forked(self._observed)
        other._observed._handles = {n: list(handles) for n, handles in self._observed._handles.items()}
        other._drift = forked(self._drift)
        other._engine = self._engine.fork(other._observed.name)
        return other

    def look(self, sensor: Sensor) -> None:
        """Expect and use observations of this sensor from now on. ValueError beside systematic errors."""
        if self._end.errors is not None:
            raise ValueError("systematic errors are estimated with one sensor; this log has several")
        self.sensor = self._observed.sensor = sensor

    def predict(self, increment: Increment) -> None:
        """Predict with an increment; the graph grows only with an observation."""
        self.frame, self._motion = self.frame + 1, None
        self._end.move(increment)
        self._drift.move(increment)

    def inflate(self, covariance: Array) -> None:
        """Add an isotropic covariance (3, 3) to the last motion. ValueError after observations of the frame."""
        if self._motion is None:
            self._end.inflate(covariance)
        else:
            self._engine.exchange(self._motion, self._end.inflated(covariance))
            self._read()
        self._drift.move(Increment(np.zeros(3), covariance))

    def estimate(self) -> PoseEstimate:
        """The newest pose with its world-frame covariance (copies)."""
        return self._end.estimate()

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Newest mean (p,) and covariance (p, p) of the systematic errors, or None."""
        return self._end.errors

    @property
    def numbers(self) -> IntArray:
        """Landmark numbers in the map, ascending."""
        return self._observed.numbers

    def expect(self, observations: FrameObservations) -> Expectation:
        """Expectation of the landmarks in view: sensor range and angles, widened by 3 sigma and 5 degrees."""
        pose = self._end.mean
        if self.map is not None:
            radius = view_radius(self.sensor, self._end.P) + 2.0 * SIGMAS * self._margin
            rows = self._places.around(*self._end.reach(radius))
            number, xy = self.map.id[rows], self.map.xy[rows]
            xy, joint = self._of_map(number) if is_uncertain(self.map) else self._end.known(xy)
        else:
            number, xy, self._asked = self.numbers, self._engine.points(self.numbers.tolist()), True
            if self.sensor.sees_points:  # a map of walls is small: all of it
                near = may_be_in_view(self.sensor, pose, xy, *self._drift.sigmas(number, self._end.P))
                number, xy = number[near], xy[near]
            joint = self._joint(number)
        every = form(self.sensor, pose, joint, number, xy, observations)
        keep = in_view(self.sensor, every.z_hat, every.HPHt)
        if self.map is None and self._locates_points:
            self._drift.expect(self.sensor, number, every.z_hat, every.HPHt)
        if len(joint) > len(pose):
            joint = joint[np.ix_(*[np.concatenate([np.ones(3, np.bool_), np.repeat(keep, 2)])] * 2)]
        return form(self.sensor, pose, joint, number[keep], xy[keep], observations, inside=self._end.inside)

    @property
    def _locates_points(self) -> bool:
        return self.sensor.sees_points and self.sensor.locates

    def _of_map(self, number: IntArray) -> tuple[Array, Array]:
        """Places (n, 2) of landmarks of an uncertain map, and joint covariance of the newest pose and them."""
        assert self.map is not None
        assert self.map.sigma is not None
        rows = self.map.rows(number)
        xy = self.map.xy[rows]
        joint = np.diag(np.concatenate([np.zeros(3), self.map.sigma[rows].ravel() ** 2]))
        joint[:3, :3] = self._end.P
        inside = np.isin(number, self._observed.joined)
        if inside.any():
            there = number[inside].tolist()
            xy[inside] = self._engine.points(there)
            at = np.concatenate([np.arange(3), 3 + coordinates(np.flatnonzero(inside))])
            joint[np.ix_(at, at)] = self._end.carried(self._engine.with_landmarks(self._end.keys, there))
        return xy, joint

    def _joint(self, number: IntArray) -> Array:
        """World-frame covariance of the newest pose and landmarks of SLAM."""
        if not len(number):
            return self._end.P
        J = self._engine.with_landmarks(self._end.keys, number.tolist())  # in graph coordinates
        self._know(number, J)
        return self._end.carried(J)

    def _know(self, number: IntArray, J: Array) -> None:
        """Joint covariance J, world frame, of some variables and, last, landmarks (n,) of SLAM."""
        if self.sensor.sees_points:
            self._drift.know(number, np.sqrt(np.diag(J)[-2 * len(number) :].reshape(-1, 2).sum(1)))

    def update(
        self, observations: FrameObservations, decisions: IntArray, *, threshold: float = np.inf,
        at: Array | None = None, innovations: bool = False,
    ) -> Updated:  # fmt: skip
        """Add all pairings below `threshold` and the new landmarks; in localization decisions are ids of the map.

        The newest pose starts at the prediction, or `at` (3,). With neither a threshold nor `innovations`, none are
        formed: NIS and likelihood are NaN, dof 0.
        """
        used, at = decisions >= 0, None if at is None else self._end.inside(at)
        if unknown := self._observed.missing(decisions if used.all() else decisions[used]):
            raise ValueError(f"no landmark has number {unknown[0]}")
        nis, dof, likelihood = np.nan, 0, np.nan
        if (innovations or threshold < np.inf) and used.any():
            nis, dof, likelihood = self._gate(observations, decisions, used, threshold, at)
        created, number = [-1] * len(decisions), decisions.tolist()
        for i, (n, inside) in enumerate(zip(number, used.tolist(), strict=True)):
            if n == NEW and self.map is None:
                created[i] = number[i] = self.created
                self.created += 1
            elif not inside:
                number[i] = -1
        taken = [i for i, n in enumerate(number) if n >= 0]
        if len(taken) < len(number):
            observations = FrameObservations(observations.z[taken], observations.R[taken])
        if taken:
            number = np.array([number[i] for i in taken], np.int64)
            again = at is not None and self._motion is not None  # the pose is in the graph, elsewhere
            if at is not None:
                self._end.place(at, joined=again)
            self._extend(observations, number, again=again)
        return Updated(used, np.array(created, np.int64), nis, dof, likelihood)

    def _gate(
        self, observations: FrameObservations, decisions: IntArray, used: BoolArray, threshold: float, at: Array | None
    ) -> tuple[float, int, float]:
        """Remove pairings with d^2 not below the threshold from `used`; NIS, dof and log-likelihood of the others."""
        rows = np.flatnonzero(used)
        number, which = np.unique(decisions[rows], return_inverse=True)
        if is_uncertain(self.map):
            xy, joint = self._of_map(number)
        elif self.map is not None:
            xy, joint = self._end.known(self.map.positions(number))
        else:
            xy, joint = self._engine.points(number.tolist()), self._joint(number)
        e = form(self.sensor, self._end.mean, joint, number, xy, observations, at)
        nu, R = self.sensor.residual(observations.z[rows], e.z_hat[which]), observations.R[rows]
        keep = np.einsum("mi,mi->m", nu, np.linalg.solve(e.HPHt[which] + R, nu[..., None])[..., 0]) < threshold
        used[rows[~keep]] = False
        return e.innovation_statistics(rows[keep], which[keep])

    def _extend(self, observations: FrameObservations, number: IntArray, *, again: bool = False) -> None:
        """Add the motion since the anchor and observations, read the newest pose; `again`: it is in the graph."""
        (motion, values), self._motion = self._flush(), None
        if again:
            values.insert(X(self.frame), pose2(self._end.mean))
        motion += self._priors(number, values)
        frames = np.full(len(number), self.frame)
        seen = self._observed.factors_of(observations, frames, number, self._end, self._engine, values)
        if self.map is None:
            self._observed.start(observations, number, self._end.mean, values)
            if self._asked and self._locates_points:
                self._drift.see(self.sensor, observations, number, self._end.P)
        self._add(motion, seen, values, again=again)
        self._read()

    def _priors(self, number: IntArray, values: gtsam.Values) -> list[Factor]:
        """See `Observed.join`; QR is used if a prior is delicate."""
        found = self._observed.join(number, values)
        if found and self._least < DELICATE:
            self._engine.use_qr()
        return [p.factor for p in found]

    def _add(
        self, motion: list[Factor], seen: Sequence[ObservationFactors], values: gtsam.Values, *, late: bool = False,
        again: bool = False,
    ) -> None:  # fmt: skip
        """Give factors to the engine; those of a landmark, or of a frame in a known map, can be removed again."""
        add = self._engine.add_from if again else self._engine.add
        self._observed.hold(seen, add([*motion, *self._observed.add(seen, values, late=late)], values)[len(motion) :])

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """Add the fixes of the newest pose that are inside the gate. Raises UsageError beside errors of the sensor."""
        self._errors.refuse_pose_measurements()
        done = in_turn(self._end.mean, self._end.P, fixes_of(fixes, sources), gate)
        used = self._note(fix_factors([self.frame] * len(done.used), fixes, sources), done)
        if used:
            motion, values = self._flush()
            self._join(motion, self._engine.add([*motion, *used], values))
            self._read()
        return done

    def _join(self, motion: list[Factor], handles: list[int]) -> None:
        """Note the handle on the motion's last factor; handles: on its factors (m) and others after them."""
        if motion:
            self._motion = handles[len(motion) - 1]

    def keep(self, last_use: dict[int, int]) -> None:
        """Every frame stays in the graph."""

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """As `fix`, with closures of the newest pose."""
        self._errors.refuse_pose_measurements()
        frames = self._held(np.unique(np.concatenate([closures.frame1, closures.frame2])))
        measured = closures_of(closures, frames)
        factors = closure_factors(closures)
        if all(m is None for m in measured):
            done = in_turn(np.empty(0), np.empty((0, 0)), measured, gate)
            self._note(factors, done)
            return done
        # the poses that they tie at the root of the tree, where their joint covariance is quick
        motion, values = self._flush()
        self._join(motion, self._engine.add(motion, values, [X(k) for k in frames.tolist()]))
        done = in_turn(*self._poses(frames), measured, gate)
        used = self._note(factors, done)
        if used:
            self._engine.add(used, gtsam.Values())
        self._read()
        return done

    def _held(self, frames: IntArray) -> IntArray:
        """Those of some frames (k,) that are in the graph, or join it with the newest pose."""
        return frames

    def _poses(self, frames: IntArray) -> tuple[Array, Array]:
        """Poses of frames (k,) in the graph, stacked, with their joint covariance, world frame."""
        pose = np.array([self._engine.pose(X(k)) for k in frames.tolist()]).reshape(-1, 3)
        P = np.zeros((pose.size, pose.size))
        # of an exactly known pose gtsam's joint marginal has a variance of about 1
        known = int(is_exact(self.prior) and frames[0] == 0)
        P[3 * known :, 3 * known :] = self._engine.covariance([X(k) for k in frames[known:].tolist()])
        T = np.zeros_like(P)
        for i, theta in enumerate(pose[:, 2].tolist()):
            T[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = world_from_body(theta)
        P = T @ P @ T.T
        return pose.ravel(), 0.5 * (P + P.T)

    def _note(self, factors: list[PoseFactor], done: PoseUpdated) -> list[Factor]:
        """Note factors (f) of the newest pose; returns those that are used."""
        self._of_poses += [p if yes else p.left_out() for p, yes in zip(factors, done.used.tolist(), strict=True)]
        return [p.factor for p, yes in zip(factors, done.used.tolist(), strict=True) if yes]

    def amend(self, frames: IntArray, observations: FrameObservations, decisions: IntArray) -> None:
        """New pairings of frames (m,): observations (m), decisions (m,); in SLAM of all, for `finish` alone."""
        if self.map is None:
            self._observed.replace(frames, observations, decisions)
            return
        again, take = np.unique(frames).tolist(), np.flatnonzero(decisions >= 0)
        former = self._observed.withdraw(again)
        if former:
            self._engine.drop(former)
        motion, values = self._flush()
        motion += self._priors(decisions[take], values)
        again_seen = FrameObservations(observations.z[take], observations.R[take])
        seen = self._observed.factors_of(again_seen, frames[take], decisions[take], self._end, self._engine, values)
        self._add(motion, seen, values, late=True)
        self.refine()

    def _flush(self) -> tuple[list[Factor], gtsam.Values]:
        """Factors and start values of the motion since the anchor (and the prior), which joins the graph."""
        values = gtsam.Values()
        factors, pivot = self._end.join_graph(values)
        if pivot < DELICATE:
            self._engine.use_qr()
        return factors, values

    def _read(self) -> None:
        self._end.read(self._engine)

    def hold(self, frame: int) -> None:
        """Nothing to do: every pose is a variable."""

    def release(self, frame: int) -> None:
        """See `hold`."""

    def held(self, frames: IntArray) -> tuple[Array, Array]:
        """Poses (n, 3) of frames, and their joint covariance (3n, 3n), in the world."""
        self._complete()
        once, which = np.unique(frames, return_inverse=True)
        pose = np.array([self._engine.pose(X(k)) for k in once.tolist()])
        B = block_diagonal(worlds_from_bodies(pose[:, 2]))
        joint = B @ self._engine.covariance([X(k) for k in once.tolist()]) @ B.T
        rows = (3 * which[:, None] + np.arange(3)).ravel()
        return pose[which], joint[np.ix_(rows, rows)]

    def initialize(
        self, frames: IntArray, sensors: Sequence[Sensor], observations: FrameObservations, xy: Array
    ) -> tuple[int, float, int, float]:
        """A new landmark at xy (2,) with its observations (m) by sensors (m) from frames (m,); innovations are NaN."""
        number, values, present = self.created, gtsam.Values(), self.sensor
        self.created += 1
        values.insert(L(number), xy)
        found = list[ObservationFactors]()
        for i, sensor in enumerate(sensors):
            row = slice(i, i + 1)
            seen = FrameObservations(observations.z[row], observations.R[row])
            self.look(sensor)
            found += self._observed.factors_of(seen, frames[row], np.array([number]), self._end, self._engine, values)
        self.look(present)
        self._add([], found, values, late=True)
        self.refine()
        return number, np.nan, 0, np.nan

    def remove(self, numbers: IntArray) -> None:
        """Remove landmarks with all their observations."""
        if self.map is not None:
            raise ValueError("a known map is given; landmarks cannot be removed from it")
        removed = np.unique(numbers)
        if self._observed.missing(removed):
            raise ValueError(f"cannot remove {removed.tolist()}: not all are in the map")
        self._engine.drop(self._observed.withdraw(removed.tolist()))
        self.refine()

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Merge landmarks `merged` (k,) into `kept` (k,): their factors are added again with the other landmark."""
        other = self._pairs_to_merge(merged, kept)
        moved = self._observed.renumbered(other, self._engine)
        self._engine.drop(self._observed.withdraw(list(other)))
        self._add([], moved, gtsam.Values(), late=True)
        self.refine()

    def _pairs_to_merge(self, merged: IntArray, kept: IntArray) -> dict[int, int]:
        """Kept landmark by merged one. Raises ValueError if one is unknown, or both merged and kept."""
        if self.map is not None:
            raise ValueError("a known map is given; its landmarks cannot be merged")
        other = dict(zip(merged.tolist(), kept.tolist(), strict=True))
        if self._observed.missing(np.concatenate([merged, kept])) or other.keys() & other.values():
            raise ValueError(f"cannot merge {other}: not all are in the map, or one is both merged and kept")
        return other

    def refine(self, updates: int = SETTLE) -> None:
        """More steps towards the optimum of the data so far: a single update makes only one."""
        for _ in range(updates):
            self._engine.update()
        if self._end.anchor >= 0:
            self._read()

    def landmarks(self) -> MapState:
        """The present map, in SLAM; `finish` gives the final one. A given exact map has no covariance."""
        number = self.numbers if self.map is None else self._observed.joined
        found = MapState(number, np.empty((0, 2)), np.empty((0, 2, 2)))
        if len(number):
            J = self._engine.with_landmarks(self._end.keys, number.tolist())
            if self.map is None:
                self._know(number, J)
            found = self._end.map_of(number, self._engine.points(number.tolist()), J)
        return found if self.map is None else map_with(self.map, found)

    def positions(self, numbers: IntArray) -> Array:
        """Present positions (n, 2) of landmarks (n,) of SLAM."""
        return self._end.points(self._engine.points(numbers.tolist()))

    def _complete(self) -> None:
        """Add the motion since the last observation to the graph."""
        motion, values = self._flush()
        if motion:
            self._add(motion, [], values)
            self._read()

    def finish(self) -> Finished:
        """Final path and map with exact marginals: the optimum of all data, reached from the present estimate."""
        self._complete()
        values = self._engine.values()
        problem = replace(self._observed.problem(self._end, values), pose_factors=self._of_poses)
        present = self.numbers if self.map is None else self._observed.joined
        for n in np.setdiff1d(present, problem.numbers).tolist():
            values.erase(L(n))
        found = optimize(problem, self._end.start(values, problem))
        effort = found.iterations, found.last_step, found.systematic
        state = found.map if self.map is None or found.map is None else map_with(self.map, found.map)
        return Finished(found.trajectory, state, found.total_nis, *effort, found.fixes, found.closures)
